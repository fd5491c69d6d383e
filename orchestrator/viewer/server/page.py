"""Passes the web viewer's page on to browsers, with orders not to talk to anybody else."""

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
    """Serve on `bind_ip`:`port`, from a thread, what the web viewer serves on `upstream_port`.

    In the browser Rerun's viewer sends usage statistics and loads fonts, and no setting of its own
    keeps it from that. A content security policy does: the page may connect to where it came from
    and to the data, on `data_port` of any host, and nowhere else.
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
            """Say nothing: requests are of no interest."""

    class Server(ThreadingHTTPServer):
        address_family = socket.AF_INET6 if ":" in bind_ip else socket.AF_INET

    server = Server((bind_ip, port), Handler)
    threading.Thread(target=server.serve_forever, name="page", daemon=True).start()
