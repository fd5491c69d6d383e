"""Opens a recording or a running study in a window or in a browser."""

from __future__ import annotations

import os
import subprocess
import sys
import webbrowser
from pathlib import Path

from nufleet.orchestrator.viewer.server.claims import claim_port
from nufleet.orchestrator.viewer.server.rerun_program import rerun_environment, rerun_program
from nufleet.orchestrator.viewer.server.server import ViewerServer
from nufleet.shared.errors import InvalidInputError, NufleetError, system_errors_as

LOCALHOST = "127.0.0.1"


def open_native(source: Path | str) -> subprocess.Popen[bytes]:
    """Open a recording, or a running study by its `live_url`, in the viewer's own window.

    The window stays open when this process ends.

    Args:
        source: Path of a recording, or URL of a running study.

    Returns:
        The viewer's process, which ends when its window is closed.

    Raises:
        InvalidInputError: The recording does not exist.
        NufleetError: This machine has no display.
    """
    if sys.platform == "linux" and not _has_display():
        raise NufleetError(
            "there is no display for the viewer's window: show it in a browser with --web, or take "
            "a picture with --screenshot FILE.png"
        )
    return subprocess.Popen(
        [
            *(str(rerun_program()), checked_source(source)),
            # Without a port of its own the window would take the one that serves live studies.
            *("--bind", LOCALHOST, "--port", str(claim_port(LOCALHOST, 0))),
        ],
        stdin=subprocess.DEVNULL,
        env={"RUST_LOG": "error", **rerun_environment()},
        start_new_session=True,
    )


def open_web(
    source: Path | str, *, bind_ip: str = "127.0.0.1", port: int = 0, browse: bool = True
) -> ViewerServer:
    """Show a recording, or a running study by its `live_url`, in a browser.

    Args:
        source: Path of a recording, or URL of a running study.
        bind_ip: Address of the network interface to serve on; the default admits this machine only.
        port: Port of the page; 0 for any free one.
        browse: Whether to open the user's browser as well.

    Returns:
        The server, whose page is available until it is closed.

    Raises:
        InvalidInputError: The recording does not exist.
        EndpointInUseError: The port is in use.
    """
    server = ViewerServer(checked_source(source), bind_ip=bind_ip, web_port=port)
    server.open()
    if browse and server.web_url is not None:
        webbrowser.open(server.web_url)
    return server


def checked_source(source: Path | str) -> str:
    """Return the URL or the absolute path for the viewer to open.

    Raises:
        InvalidInputError: The file does not exist, or is not a Rerun recording.
    """
    if isinstance(source, str) and "://" in source:
        return source
    path = Path(source)
    unread = system_errors_as(InvalidInputError, f"cannot open the recording {path}")
    with unread, path.open("rb") as file:
        if file.read(4) not in (b"RRF2", b"RRIO"):
            raise InvalidInputError(f"{path} is not a Rerun recording")
    return str(path.absolute())


def _has_display() -> bool:
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"))
