"""What `nufleet view` refuses, and says, before it opens anything."""

from __future__ import annotations

import json
import socket
from pathlib import Path

import pytest
from click.testing import CliRunner

from nufleet.orchestrator.cli.view import view
from nufleet.orchestrator.jobs import view as work
from nufleet.shared.errors import InvalidInputError, NufleetError


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """A folder of two runs, of which the latest left no recording."""
    for name in ("20260101T120000Z-lab", "20260102T120000Z-lab-train"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "config.json").write_text(json.dumps({"kind": "train"}))
    (tmp_path / "20260101T120000Z-lab" / "run.rrd").write_bytes(b"RRF2")
    (tmp_path / "there.png").touch()
    return tmp_path


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("latest",), "20260102T120000Z-lab-train has no recording; `nufleet runs show"),
        (("20260101T120000Z-lab", "--screenshot", "a.jpg"), "its name ends with .png"),
        (("20260101T120000Z-lab", "--screenshot", "{runs}/there.png"), "there.png already exists"),
    ],
)
def test_what_cannot_be_shown_is_refused(
    runs: Path, arguments: tuple[str, ...], words: str
) -> None:
    typed = [argument.format(runs=runs) for argument in arguments]
    error = CliRunner().invoke(view, [*typed, "--runs", str(runs)]).exception
    assert isinstance(error, InvalidInputError)
    assert words in str(error)


def test_without_a_display_it_says_which_options_need_none(
    runs: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(name, raising=False)
    arguments = ["20260101T120000Z-lab", "--runs", str(runs)]
    error = CliRunner().invoke(view, arguments).exception
    assert isinstance(error, NufleetError)
    assert "--web" in str(error)
    assert "--screenshot FILE.png" in str(error)


def test_where_nothing_is_live_it_says_that_it_waits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        monkeypatch.setattr(work, "GRPC_PORT", free.getsockname()[1])
    monkeypatch.setattr(work, "open_native", lambda source: None)
    shown = CliRunner().invoke(view, ["--live"])
    assert shown.exit_code == 0
    assert "no run is live yet: start one with --live" in shown.stderr
