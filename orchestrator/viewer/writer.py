"""Writes a running study to a recording and to live viewers, without ever holding it up."""

from __future__ import annotations

import logging
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from orchestrator.viewer.endpoint import claim_port, claim_recording
from orchestrator.viewer.events import ViewerEvent
from orchestrator.viewer.outlet import Outlet, Sink
from orchestrator.viewer.web_page import WebPage, live_url
from shared.errors import NufleetError

GRPC_PORT = 9876
WEB_PORT = 9090

OPEN_TIMEOUT_S = 30.0
"""Importing Rerun and its first log take a second or two; on a busy machine more."""

CLOSE_TIMEOUT_S = 10.0

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ServeOptions:
    """Where live viewers connect to; a port of 0 stands for any free one, None for no web page."""

    grpc_port: int = GRPC_PORT
    web_port: int | None = None
    bind_ip: str = "127.0.0.1"


class RerunWriter:
    """Draws a study's events; a context manager.

    The recording and the live viewers have a thread, a queue and a Rerun stream each: Rerun makes
    whoever logs to a server wait for its slowest viewer (measured: 25 s, for one that is stopped),
    and a recording must not wait for that.
    """

    def __init__(self, run_id: str, *, recording: Path | None, serve: ServeOptions | None) -> None:
        self._run_id = run_id
        self._recording = recording
        self._serve = serve
        self._outlets: list[Outlet] = []
        self._web_page: WebPage | None = None
        self._live_url: str | None = None
        self._lost = 0

    @property
    def live_url(self) -> str | None:
        """What a native viewer connects to: `nufleet view URL`, `rerun --connect URL`."""
        return self._live_url

    @property
    def web_url(self) -> str | None:
        """The page that shows the study in a browser."""
        return None if self._web_page is None else self._web_page.url

    @property
    def dropped(self) -> int:
        """Events that the recording or the live viewers missed, counted for each."""
        return self._lost + sum(outlet.dropped for outlet in self._outlets)

    def open(self) -> None:
        """Make sure that everything can be written and served, before anything moves.

        Raises:
            InvalidInputError: the recording cannot be written there.
            EndpointInUseError: a port is taken, or may not be listened on.
            NufleetError: Rerun did not start.
        """
        with ExitStack() as undo:
            undo.callback(self.close)
            if self._recording is not None:
                self._open_recording(claim_recording(self._recording))
            if self._serve is not None:
                self._open_server(self._serve)
            deadline = time.monotonic() + OPEN_TIMEOUT_S
            for outlet in self._outlets:
                try:
                    outlet.wait_opened(deadline - time.monotonic())
                except TimeoutError as error:
                    raise NufleetError(f"the viewer's {error}") from error
            if self._serve is not None and self._serve.web_port is not None and self._live_url:
                self._web_page = WebPage(
                    self._live_url, bind_ip=self._serve.bind_ip, port=self._serve.web_port
                )
                self._web_page.open()
            undo.pop_all()

    def emit(self, event: ViewerEvent) -> None:
        """Take an event; returns at once, whatever has become of the viewers."""
        if not self._outlets:
            self._lost += 1
        for outlet in self._outlets:
            outlet.offer(event)

    def close(self, timeout_s: float = CLOSE_TIMEOUT_S) -> bool:
        """Write out what is waiting and let go; what is stuck is left behind after `timeout_s`.

        Returns:
            Whether everything was written. Calling it again does nothing more.
        """
        deadline = time.monotonic() + timeout_s
        for outlet in self._outlets:
            outlet.ask_to_close()
        stuck = [o for o in self._outlets if not o.join(deadline - time.monotonic())]
        if self._web_page is not None:
            self._web_page.close()
            self._web_page = None
        for outlet in stuck:
            log.warning("the viewer's %s is stuck; what it had not written is lost", outlet.name)
        if stuck:
            import rerun

            # Otherwise Rerun would wait for the stuck viewer again when the process ends.
            rerun.unregister_shutdown()
        return not stuck

    def __enter__(self) -> RerunWriter:
        self.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _open_recording(self, path: Path) -> None:
        def open_sink() -> Sink:
            from orchestrator.viewer.stream import RerunSink

            return RerunSink.to_file(self._run_id, path)

        self._start(Outlet("recording", open_sink))

    def _open_server(self, serve: ServeOptions) -> None:
        port = claim_port(serve.bind_ip, serve.grpc_port)
        if serve.web_port:
            claim_port(serve.bind_ip, serve.web_port)

        def open_sink() -> Sink:
            from orchestrator.viewer.stream import RerunSink

            return RerunSink.to_viewers(self._run_id, serve.bind_ip, port)

        self._start(Outlet("live server", open_sink))
        self._live_url = live_url(serve.bind_ip, port)

    def _start(self, outlet: Outlet) -> None:
        self._outlets.append(outlet)
        outlet.start()
