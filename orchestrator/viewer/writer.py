"""Writes a running study to a recording and to live viewers, without ever delaying the study."""

from __future__ import annotations

import logging
import time
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

from nufleet.orchestrator.viewer.events import ViewerEvent
from nufleet.orchestrator.viewer.outlet import Outlet, Sink
from nufleet.orchestrator.viewer.server.claims import claim_recording
from nufleet.orchestrator.viewer.server.ports import GRPC_PORT
from nufleet.orchestrator.viewer.server.server import ViewerServer
from nufleet.shared.errors import NufleetError

OPEN_TIMEOUT_S = 30.0
"""Limit on the time for opening. Importing Rerun and its first log take a second or two, and more
on a busy machine."""

CLOSE_TIMEOUT_S = 10.0
"""Limit on the time for writing out what is left."""

LIVE_CLOSE_S = 2.0
"""Time that live viewers have to take what is left; the recording has the whole timeout."""

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ServeOptions:
    """The addresses that live viewers connect to."""

    grpc_port: int = GRPC_PORT
    """Port for native viewers; 0 for any free one."""
    web_port: int | None = None
    """Port of the web page; 0 for any free one, None for no page."""
    bind_ip: str = "127.0.0.1"
    """Address of the network interface to listen on."""


class RerunWriter:
    """Draws a study's events; a context manager.

    The recording and the live viewers have a thread, a queue and a Rerun stream each: Rerun makes
    the writer wait for a server's slowest viewer (25 s measured with a viewer that was stopped),
    and the recording must not wait for that.
    """

    def __init__(self, run_id: str, *, recording: Path | None, serve: ServeOptions | None) -> None:
        self._run_id = run_id
        self._recording = recording
        self._server: ViewerServer | None = None
        if serve is not None:
            self._server = ViewerServer(
                bind_ip=serve.bind_ip, data_port=serve.grpc_port, web_port=serve.web_port
            )
        self._to_recording: Outlet | None = None
        self._to_viewers: Outlet | None = None
        self._unheard = 0

    @property
    def live_url(self) -> str | None:
        """URL for native viewers, valid once the writer is open; None when nothing is served."""
        return None if self._server is None else self._server.live_url

    @property
    def web_url(self) -> str | None:
        """URL of the page for browsers, valid once the writer is open; None when there is none."""
        return None if self._server is None else self._server.web_url

    @property
    def dropped(self) -> int:
        """Number of events that the recording and the live viewers missed, counted separately."""
        return self._unheard + sum(outlet.dropped for outlet in self._outlets)

    def open(self) -> None:
        """Open the recording and the server, so that any failure comes before a robot moves.

        Raises:
            InvalidInputError: The recording cannot be written there.
            EndpointInUseError: A port is in use, or may not be listened on.
            NufleetError: Rerun did not start.
        """
        with ExitStack() as undo:
            undo.callback(self.close)
            if self._server is not None:
                self._open_server(self._server)
            if self._recording is not None:
                self._open_recording(claim_recording(self._recording))
            deadline = time.monotonic() + OPEN_TIMEOUT_S
            for outlet in self._outlets:
                try:
                    outlet.wait_opened(deadline - time.monotonic())
                except TimeoutError as error:
                    raise NufleetError(f"the viewer's {error}") from error
            undo.pop_all()

    def emit(self, event: ViewerEvent) -> None:
        """Accept an event; returns at once, even when the viewers are slow or gone."""
        outlets = self._outlets
        if not outlets:
            self._unheard += 1
        for outlet in outlets:
            outlet.offer(event)

    def close(self, timeout_s: float = CLOSE_TIMEOUT_S) -> bool:
        """Write out all queued events and close; calling it again has no effect.

        Args:
            timeout_s: Limit on the whole closing. A stream that is still stuck then is abandoned.

        Returns:
            Whether everything was written.
        """
        deadline = time.monotonic() + timeout_s
        for outlet in self._outlets:
            outlet.ask_to_close()
        complete = True
        if self._to_viewers is not None:
            complete &= self._to_viewers.join(min(LIVE_CLOSE_S, timeout_s / 2))
        if self._server is not None:
            # Ending the server also releases a stream that a stuck viewer was holding up.
            self._server.close(timeout_s=max(0.1, min(LIVE_CLOSE_S, timeout_s / 4)))
        for outlet in self._outlets:
            if not outlet.join(deadline - time.monotonic()):
                complete = False
                log.warning(
                    "the viewer's %s is stuck; the events it has not written are lost", outlet.name
                )
                _leave_behind()
        return complete

    def __enter__(self) -> RerunWriter:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _outlets(self) -> tuple[Outlet, ...]:
        return tuple(o for o in (self._to_recording, self._to_viewers) if o is not None)

    def _open_recording(self, path: Path) -> None:
        def open_sink() -> Sink:
            from nufleet.orchestrator.viewer.rerun_sink import RerunSink

            return RerunSink.to_file(self._run_id, path)

        self._to_recording = Outlet("recording", open_sink)
        self._to_recording.start()

    def _open_server(self, server: ViewerServer) -> None:
        server.open()

        def open_sink() -> Sink:
            from nufleet.orchestrator.viewer.rerun_sink import RerunSink

            return RerunSink.to_server(self._run_id, server.live_url, lambda: server.alive)

        self._to_viewers = Outlet("live view", open_sink)
        self._to_viewers.start()


def _leave_behind() -> None:
    """Keep Rerun from waiting for a stuck stream again when the process ends."""
    import rerun

    rerun.unregister_shutdown()
