"""Opening a recording in the viewer's window."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from nufleet.orchestrator.viewer.server.open import open_native
from nufleet.orchestrator.viewer.server.ports import GRPC_PORT
from nufleet.orchestrator.viewer.writer import RerunWriter
from nufleet.shared.errors import InvalidInputError, NufleetError


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    path = tmp_path / "run.rrd"
    with RerunWriter("run-1", recording=path, serve=None):
        pass
    return path


def test_a_window_leaves_the_port_of_a_live_study_free(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[list[str]] = []
    monkeypatch.setenv("DISPLAY", ":0")
    monkeypatch.setattr(subprocess, "Popen", lambda command, **_: started.append(command))
    open_native(recording)
    ((program, source, *options),) = started
    assert Path(program).name == "rerun"
    assert source == str(recording)
    port = int(options[options.index("--port") + 1])
    assert port not in (0, GRPC_PORT)
    assert options[options.index("--bind") + 1] == "127.0.0.1"


def test_without_a_display_a_window_is_refused_with_what_to_do(
    recording: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    with pytest.raises(NufleetError, match="browser with --web, or take a picture"):
        open_native(recording)


def test_a_file_that_is_no_recording_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    other = tmp_path / "run.rrd"
    other.write_bytes(b"something else")
    with pytest.raises(InvalidInputError, match="not a Rerun recording"):
        open_native(other)
