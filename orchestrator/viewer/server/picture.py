"""Takes a picture of a recording, without a display."""

from __future__ import annotations

import os
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING

import numpy as np

from nufleet.orchestrator.viewer.server.claims import claim_port
from nufleet.orchestrator.viewer.server.open import LOCALHOST, checked_source
from nufleet.orchestrator.viewer.server.rerun_program import rerun_environment, rerun_program
from nufleet.shared.errors import InvalidInputError, NufleetError, system_errors_as
from nufleet.shared.interrupts import postponed

if TYPE_CHECKING:
    from rerun.experimental import ViewerClient, ViewerState

TIMEOUT_S = 120.0
"""Time after which the viewer counts as stuck; without a graphics card, on a busy machine, a
picture takes a minute."""

POLL_S = 0.1

NO_GRAPHICS = "No graphics adapter was found"
"""Message of the viewer on a machine without a graphics driver."""


def screenshot(
    recording: Path, png: Path, *, size: tuple[int, int] = (1800, 1100), at_s: float | None = None
) -> tuple[str, ...]:
    """Save a picture of a recording as the viewer shows it.

    Args:
        recording: File of a study's recording.
        png: File to write.
        size: Width and height in pixels.
        at_s: Time on the viewer's clock to show; None for the end of the recording.

    Returns:
        Messages of the viewer about anything that it could not draw; empty when all went well.

    Raises:
        InvalidInputError: The recording cannot be read, or the picture cannot be written.
        NufleetError: No graphics driver is installed, or the viewer failed.
    """
    source = checked_source(recording)
    deadline = time.monotonic() + TIMEOUT_S
    with _headless_viewer(size, deadline) as viewer:
        viewer.open(source)
        state = _when_loaded(viewer, deadline)
        _go_to(viewer, state, at_s)
        picture = _when_still(viewer, deadline)
        problems = tuple(
            f"{view.name}: {report.summary}"
            for view in viewer.get_state().views
            for report in view.reports
        )
    with system_errors_as(InvalidInputError, f"cannot write the picture {png}"):
        png.write_bytes(picture)
    return problems


@contextmanager
def _headless_viewer(size: tuple[int, int], deadline: float) -> Iterator[ViewerClient]:
    from rerun.experimental import ViewerClient

    port = claim_port(LOCALHOST, 0)
    with ExitStack() as stack:
        output = stack.enter_context(tempfile.TemporaryFile())
        with postponed():
            process = subprocess.Popen(
                [
                    *(str(rerun_program()), "--headless", "--bind", LOCALHOST, "--port", str(port)),
                    *("--window-size", f"{size[0]}x{size[1]}"),
                ],
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                # Messages of lower levels would pop up in the picture.
                env={**rerun_environment(), "RUST_LOG": "error"},
            )
            stack.enter_context(process)
            stack.callback(process.kill)
        try:
            _when_listening(port, process, output, deadline)
            yield ViewerClient.connect(f"rerun+http://{LOCALHOST}:{port}/proxy")
        except (ConnectionError, TimeoutError) as error:
            raise _viewer_error(output, str(error)) from error


def _when_listening(
    port: int, process: subprocess.Popen[bytes], output: IO[bytes], deadline: float
) -> None:
    while True:
        if process.poll() is not None:
            raise _viewer_error(output, "it ended immediately")
        try:
            with socket.create_connection((LOCALHOST, port), timeout=1.0):
                return
        except OSError:
            _wait(deadline, "it is not listening")


def _when_loaded(viewer: ViewerClient, deadline: float) -> ViewerState:
    while (state := viewer.get_state()).loading or not (state.recordings and state.views):
        _wait(deadline, "the recording has not been loaded")
    return state


def _go_to(viewer: ViewerClient, state: ViewerState, at_s: float | None) -> None:
    for timeline in state.recordings[0].timelines:
        if timeline.name == "t" and timeline.end is not None:
            time_ns = timeline.end if at_s is None else round(at_s * 1e9)
            viewer.set_time("t", duration=np.timedelta64(time_ns, "ns"), play_state="paused")


def _when_still(viewer: ViewerClient, deadline: float) -> bytes:
    """Return the first picture that equals the one before it.

    Until then views are still loading and moving into place.
    """
    before = _picture(viewer, deadline)
    while True:
        _wait(deadline, "the picture is still changing")
        now = _picture(viewer, deadline)
        if now == before:
            return now
        before = now


def _picture(viewer: ViewerClient, deadline: float) -> bytes:
    """Return a picture; the viewer gives one up that takes a software renderer some seconds."""
    while True:
        try:
            return viewer.take_screenshot()
        except TimeoutError:
            _wait(deadline, "no picture was drawn")


def _wait(deadline: float, complaint: str) -> None:
    if time.monotonic() > deadline:
        raise TimeoutError(f"{complaint} after {TIMEOUT_S:g} s")
    time.sleep(POLL_S)


def _viewer_error(output: IO[bytes], complaint: str) -> NufleetError:
    said = os.pread(output.fileno(), 20_000, 0).decode(errors="replace")
    if NO_GRAPHICS in said:
        return NufleetError(
            "the viewer found no graphics driver; install one that needs no graphics card: "
            "the package mesa-vulkan-drivers on Debian and Ubuntu"
        )
    return NufleetError(f"the viewer failed: {complaint}: {said.strip()[-500:]}")
