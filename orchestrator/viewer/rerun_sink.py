"""Draws events on a Rerun stream to a file or to the viewers' server. Imports Rerun."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from copy import deepcopy
from functools import partial
from pathlib import Path

import rerun as rr

from nufleet.orchestrator.viewer.events import ViewerEvent
from nufleet.orchestrator.viewer.layout import layout
from nufleet.orchestrator.viewer.scene import Scene
from nufleet.orchestrator.viewer.shown import Shown
from nufleet.shared.arrays import arrow
from nufleet.shared.errors import InvalidInputError, NufleetError

APPLICATION = "nufleet"

CONNECT_S = 10.0
"""Limit on the time that the server may take to answer."""

STUDY = Shown(kinds=["ranking"])
"""Content that a new recording is laid out for, until the first events show otherwise."""

log = logging.getLogger(__name__)


class RerunSink:
    """Draws events on one Rerun stream; calls block for as long as the other end does."""

    def __init__(self, stream: rr.RecordingStream, before_write: Callable[[], None]) -> None:
        self._stream = stream
        self._before_write = before_write
        self._drawing = Scene(stream)
        self._drawing.begin()
        self._laid_out = STUDY

    @staticmethod
    def to_file(run_id: str, path: Path) -> RerunSink:
        """Return a sink that writes to a file; raises InvalidInputError when that fails."""
        stream = _stream(run_id)
        try:
            stream.set_sinks(rr.FileSink(path), default_blueprint=layout(STUDY))
            # Flush before every write: a power failure then costs a quarter of a second of the
            # recording, and a full disk is noticed, since flushing raises.
            sink = RerunSink(stream, stream.flush)
            stream.flush()
        except RuntimeError as error:
            raise InvalidInputError(f"cannot record to {path}: {error}") from error
        return sink

    @staticmethod
    def to_server(run_id: str, url: str, alive: Callable[[], bool]) -> RerunSink:
        """Return a sink that writes to a server.

        Args:
            run_id: Name of the recording.
            url: Address of the server.
            alive: Function that returns whether the server still runs.

        Raises:
            NufleetError: The server does not answer.
        """

        def check() -> None:
            # Rerun itself silently drops all data once the server is gone.
            if not alive():
                raise NufleetError("the server of the viewer has ended")

        stream = _stream(run_id)
        stream.set_sinks(rr.GrpcSink(url), default_blueprint=layout(STUDY))
        sink = RerunSink(stream, check)
        try:
            stream.flush(timeout_sec=CONNECT_S)
        except RuntimeError as error:
            raise NufleetError(f"the server of the viewer does not answer: {error}") from error
        return sink

    def write(self, events: Sequence[ViewerEvent]) -> None:
        """Draw events; raises NufleetError when the file or the server is gone."""
        with _gone():
            self._before_write()
        draws: list[Callable[[], None]] = [partial(self._drawing.draw, event) for event in events]
        _draw_each([*draws, *self._drawing.rest])
        self._lay_out()

    def _lay_out(self) -> None:
        """Send a layout for the present content; the viewer opens the kind that began last."""
        shown = self._drawing.shown
        if shown.kinds and shown != self._laid_out:
            self._laid_out = deepcopy(shown)
            self._stream.send_blueprint(layout(shown))

    def close(self) -> None:
        """Draw the end, flush the stream and disconnect it, which also writes a file's footer."""
        try:
            with _gone():
                self._before_write()
                _draw_each([self._drawing.end])
                self._stream.flush()
        finally:
            self._stream.disconnect()


@contextmanager
def _gone() -> Iterator[None]:
    """Name what Rerun says in a RuntimeError: its file or its server takes nothing more."""
    try:
        yield
    except RuntimeError as error:
        raise NufleetError(f"its disk is full, or its file or server gone ({error})") from error


def _draw_each(draws: Sequence[Callable[[], None]]) -> None:
    for draw in draws:
        try:
            draw()
        except Exception:
            # An event that cannot be drawn must not cost the study the rest of its recording.
            log.exception("the viewer could not draw an event")


def _stream(run_id: str) -> rr.RecordingStream:
    arrow()
    stream = rr.RecordingStream(APPLICATION, recording_id=run_id)
    # Otherwise data logged without a time would get the wall time instead of being static.
    stream.set_log_time_enabled(False)
    return stream
