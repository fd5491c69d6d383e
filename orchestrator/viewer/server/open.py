"""Opens a recording, or a study that is running: in a window, in a browser, or as a picture."""

from __future__ import annotations

import os
import subprocess
import sys
import webbrowser
from pathlib import Path

from nufleet.orchestrator.viewer.server.claims import claim_port
from nufleet.orchestrator.viewer.server.rerun_program import rerun_environment, rerun_program
from nufleet.orchestrator.viewer.server.server import ViewerServer
from nufleet.shared.errors import InvalidInputError, NufleetError

LOCALHOST = "127.0.0.1"


def open_native(source: Path | str) -> subprocess.Popen[bytes]:
    """Open a recording, or a running study by its `live_url`, in the viewer's own window.

    The window stays when this process ends; wait for the returned process to wait for the window.

    Raises:
        InvalidInputError: there is no such recording.
        NufleetError: there is no display here.
    """
    if sys.platform == "linux" and not _has_display():
        raise NufleetError(
            "there is no display for the viewer's window; show it in a browser or take a picture"
        )
    return subprocess.Popen(
        [
            *(str(rerun_program()), checked_source(source)),
            # A port of its own: left to itself the window takes the one a live study is watched at.
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
        source: a path, or a URL.
        bind_ip: who may see it: this machine only, unless another address is given.
        port: of the page; 0 for any free one.
        browse: open the user's browser, too.

    Returns:
        The server, whose page is there until it is closed.

    Raises:
        InvalidInputError: there is no such recording.
        EndpointInUseError: the port is taken.
    """
    server = ViewerServer(checked_source(source), bind_ip=bind_ip, web_port=port)
    server.open()
    if browse and server.web_url is not None:
        webbrowser.open(server.web_url)
    return server


def checked_source(source: Path | str) -> str:
    """Return what the viewer is to open; raises InvalidInputError for a file that is not there."""
    if isinstance(source, str) and "://" in source:
        return source
    path = Path(source)
    try:
        with path.open("rb") as file:
            if file.read(4) not in (b"RRF2", b"RRIO"):
                raise InvalidInputError(f"{path} is not a Rerun recording")
    except OSError as error:
        raise InvalidInputError(f"cannot open the recording {path}: {error.strerror}") from error
    return str(path.absolute())


def _has_display() -> bool:
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"))
