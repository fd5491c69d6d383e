"""A web page on this machine for drawing by hand, served until a drawing has been saved."""

from __future__ import annotations

import json
import secrets
import threading
from collections.abc import Callable
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Annotated

import numpy as np
from pydantic import Field, ValidationError

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import EndpointInUseError, InvalidInputError, system_errors_as
from nufleet.shared.paths.shape import resampled, shape_of
from nufleet.shared.paths.trajectories import POINTS_MAX, smoothed
from nufleet.shared.strict import Strict, describe_validation

BODY_BYTES_MAX = 8 * 2**20
SPACING_M = 0.02
SPEED_M_S = 0.6
"""Speed at which the page estimates a duration: the middle one of the paper's (Section VI)."""

_PAGE = Path(__file__).with_name("page.html")
_SECURITY = (
    "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; connect-src 'self'"
)


class Drawn(Strict):
    """The message that the page sends."""

    points: Annotated[tuple[tuple[float, float], ...], Field(min_length=2, max_length=POINTS_MAX)]
    """Points (x, y) in m, in the order in which they were drawn."""


class DrawingPage:
    """Serves the page on the loopback interface; a context manager.

    Its address holds a secret, so that no other page in the same browser can post to it.
    """

    def __init__(
        self,
        port: int,
        extent_m: float,
        save: Callable[[FloatArray], None],
        *,
        workspace_m: float | None = None,
        speed_m_s: float = SPEED_M_S,
    ) -> None:
        """Start to serve.

        Args:
            port: Port to listen on; 0 takes a free one.
            extent_m: Distance from the middle of the paper, the origin, to its edges.
            save: Function that stores the points, shape (n, 2), in m. The page shows the message of
                an InvalidInputError that it raises.
            workspace_m: Largest |x| and |y| that the robots may reach, which the page shows; None
                if no robot is named.
            speed_m_s: Speed at which the page estimates how long the drawing takes, in m/s.

        Raises:
            EndpointInUseError: The port is in use.
        """
        self._path = f"/{secrets.token_urlsafe(16)}"
        self._html = _PAGE.read_text(encoding="utf-8")
        shown = {"EXTENT_M": extent_m, "WORKSPACE_M": workspace_m, "SPEED_M_S": speed_m_s}
        for word, number in shown.items():
            self._html = self._html.replace(word, json.dumps(number))
        self._save = save
        self._lock = threading.Lock()
        self._saved: FloatArray | None = None
        self._ended = threading.Event()
        page = self

        class Handler(BaseHTTPRequestHandler):
            timeout = 30.0

            def do_GET(self) -> None:
                page._get(self)

            def do_POST(self) -> None:
                page._post(self)

            def log_message(self, *_: object) -> None:
                """Log nothing: by default every request is written to stderr."""

        what = f"cannot listen on port {port}"
        with system_errors_as(EndpointInUseError, what, "; choose another --port"):
            self._server = ThreadingHTTPServer(("127.0.0.1", port), Handler)
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(0.05,), name="drawing-page"
        )
        self._thread.start()

    @property
    def url(self) -> str:
        """The page's address."""
        return f"http://127.0.0.1:{self._server.server_address[1]}{self._path}"

    def wait(self, timeout_s: float | None = None) -> FloatArray:
        """Wait for a drawing to be saved.

        Args:
            timeout_s: Limit on the wait; None waits without one.

        Returns:
            Points of the drawing in m, shape (n, 2).

        Raises:
            TimeoutError: No drawing was saved within the limit.
        """
        # Wait in short steps, since Python handles signals only between them.
        if timeout_s is not None:
            self._ended.wait(timeout_s)
        else:
            while not self._ended.wait(0.2):
                pass
        if self._saved is None:
            raise TimeoutError("no drawing was saved")
        return self._saved

    def __enter__(self) -> DrawingPage:
        return self

    def __exit__(self, *_: object) -> None:
        self._server.shutdown()
        self._thread.join()
        self._server.server_close()

    def _get(self, request: BaseHTTPRequestHandler) -> None:
        if request.path != self._path:
            _answer(request, HTTPStatus.NOT_FOUND, "not here: use the address that was printed")
            return
        _answer(request, HTTPStatus.OK, self._html, kind="text/html")

    def _post(self, request: BaseHTTPRequestHandler) -> None:
        if request.path != self._path:
            _answer(request, HTTPStatus.NOT_FOUND, "not here: use the address that was printed")
            return
        length = request.headers.get("Content-Length", "")
        if not length.isdecimal() or int(length) > BODY_BYTES_MAX:
            _answer(request, HTTPStatus.REQUEST_ENTITY_TOO_LARGE, "too much was drawn")
            return
        try:
            drawn = Drawn.model_validate_json(request.rfile.read(int(length)))
            points = _evened(np.array(drawn.points))
            with self._lock:
                if self._saved is not None:
                    _answer(request, HTTPStatus.CONFLICT, "a drawing has already been saved")
                    return
                self._save(points)
                self._saved = points
        except ValidationError as error:
            _answer(request, HTTPStatus.BAD_REQUEST, describe_validation(error))
            return
        except InvalidInputError as error:
            _answer(request, HTTPStatus.BAD_REQUEST, str(error))
            return
        _answer(request, HTTPStatus.OK, f"saved: {shape_of(points).length_m:.2f} m long")
        self._ended.set()


def _evened(points: FloatArray) -> FloatArray:
    """Return a hand-drawn line smoothed and evenly spaced, shape (n, 2), in m.

    Raises:
        InvalidInputError: The points are no path.
    """
    shape_of(points)
    return resampled(smoothed(points)[0], SPACING_M)


def _answer(
    request: BaseHTTPRequestHandler, status: HTTPStatus, text: str, *, kind: str = "text/plain"
) -> None:
    body = text.encode()
    request.send_response(status)
    request.send_header("Content-Type", f"{kind}; charset=utf-8")
    request.send_header("Content-Length", str(len(body)))
    request.send_header("Content-Security-Policy", _SECURITY)
    request.send_header("Cache-Control", "no-store")
    request.end_headers()
    request.wfile.write(body)
