"""Serves the web viewer's page to browsers, with a policy that forbids all other connections."""

from __future__ import annotations

import shutil
import socket
import threading
import urllib.error
import urllib.request
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from urllib.parse import urlsplit

from nufleet.orchestrator.viewer.server.claims import host_in_url, reachable

TIMEOUT_S = 30.0
PASSED_ON = ("Content-Type", "Content-Length", "Content-Encoding", "rerun-final-length")


def serve_page(bind_ip: str, port: int, *, upstream_port: int, data_port: int) -> None:
    """Serve the web viewer's page from a thread, as a proxy that adds a security policy.

    In the browser Rerun's viewer sends usage statistics and loads fonts, and none of its settings
    prevents that. A content security policy does: the page may connect to its own origin and to the
    data port of any host, and to nothing else.

    Args:
        bind_ip: Address of the network interface to listen on.
        port: Port to listen on.
        upstream_port: Port on which the web viewer itself listens, at the same address.
        data_port: Port from which the page reads its data.
    """
    policy = (
        f"connect-src 'self' blob: data: http://*:{data_port}; "
        "style-src 'self' 'unsafe-inline'; font-src 'self' data:"
    )

    host = host_in_url(reachable(bind_ip))

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            url = f"http://{host}:{upstream_port}{urlsplit(self.path).path}"
            try:
                with urllib.request.urlopen(url, timeout=TIMEOUT_S) as answer:
                    self.send_response(answer.status)
                    for name in PASSED_ON:
                        if (value := answer.headers[name]) is not None:
                            self.send_header(name, value)
                    self.send_header("Content-Security-Policy", policy)
                    self.end_headers()
                    shutil.copyfileobj(answer, self.wfile)
            except urllib.error.HTTPError as error:
                self.send_error(error.code)
            except urllib.error.URLError:
                self.send_error(HTTPStatus.BAD_GATEWAY)

        def log_message(self, *_: object) -> None:
            """Log nothing: by default every request is written to stderr."""

    class Server(ThreadingHTTPServer):
        address_family = socket.AF_INET6 if ":" in bind_ip else socket.AF_INET

    server = Server((bind_ip, port), Handler)
    threading.Thread(target=server.serve_forever, name="page", daemon=True).start()
