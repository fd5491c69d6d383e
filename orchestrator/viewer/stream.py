"""A Rerun stream to a file or to viewers, and what is drawn on it. Imports Rerun."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from pathlib import Path

import rerun as rr

from orchestrator.viewer.blueprint import layout
from orchestrator.viewer.drawing import Drawing
from orchestrator.viewer.endpoint import host_in_url, reachable
from orchestrator.viewer.events import ViewerEvent
from shared.errors import EndpointInUseError

APPLICATION = "nufleet"

SERVER_MEMORY = "256MB"
"""A viewer that connects late gets at most so much of the history."""

FLUSH_S = 5.0

log = logging.getLogger(__name__)


class RerunSink:
    """Draws events on one Rerun stream; every call may block for as long as its viewers do."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._drawing = Drawing(stream)

    @staticmethod
    def to_file(run_id: str, path: Path) -> RerunSink:
        """Write to a file."""
        stream = _stream(run_id)
        stream.set_sinks(rr.FileSink(path), default_blueprint=layout())
        return RerunSink._warmed_up(stream)

    @staticmethod
    def to_viewers(run_id: str, bind_ip: str, port: int) -> RerunSink:
        """Serve viewers; raises EndpointInUseError when the port is taken after all."""
        stream = _stream(run_id)
        server = rr.GrpcServerSink(
            bind_ip=bind_ip,
            port=port,
            server_memory_limit=SERVER_MEMORY,
            cors_allow_origin=[f"http://{host_in_url(reachable(bind_ip))}:*"],
        )
        stream.set_sinks(server, default_blueprint=layout())
        try:
            return RerunSink._warmed_up(stream)
        except RuntimeError as error:
            raise EndpointInUseError(
                f"the viewer cannot listen on {bind_ip}:{port}: {error}; choose another port"
            ) from error

    @staticmethod
    def _warmed_up(stream: rr.RecordingStream) -> RerunSink:
        sink = RerunSink(stream)
        sink._drawing.begin()
        stream.flush(timeout_sec=FLUSH_S)
        return sink

    def write(self, events: Sequence[ViewerEvent]) -> None:
        """Draw events and hand them to the file or the server."""
        for event in events:
            try:
                self._drawing.draw(event)
            except Exception:
                # What cannot be drawn must not cost the study the rest of its recording.
                log.exception("cannot draw %s", type(event).__name__)
        self._drawing.end_batch()
        # A recording that is cut off by a power failure misses a quarter of a second.
        self._stream.flush(timeout_sec=FLUSH_S)

    def close(self) -> None:
        """Write the file's footer, or let the viewers go."""
        self._stream.flush(timeout_sec=FLUSH_S)
        self._stream.disconnect()


def _stream(run_id: str) -> rr.RecordingStream:
    stream = rr.RecordingStream(APPLICATION, recording_id=run_id)
    # Otherwise whatever is logged without a time gets the wall time instead of being static.
    stream.set_log_time_enabled(False)
    return stream
