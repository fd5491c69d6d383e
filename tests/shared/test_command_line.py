"""How the command line ends when there is no room left."""

from __future__ import annotations

import errno
import os
import signal
from collections.abc import Iterator

import click
import pytest

from shared import command_line


@pytest.fixture(autouse=True)
def _signals_as_they_were() -> Iterator[None]:
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


def end_of(monkeypatch: pytest.MonkeyPatch, error: OSError) -> int | str | None:
    """Run a command that fails; return with what the process would exit."""

    @click.command()
    def fails() -> None:
        raise error

    monkeypatch.setattr(command_line, "command_line", lambda: fails)
    monkeypatch.setattr("sys.argv", ["nufleet"])
    with pytest.raises(SystemExit) as ended:
        command_line.main()
    return ended.value.code


def test_a_full_disk_is_one_line_that_names_the_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "runs/results.json.part")
    assert end_of(monkeypatch, full) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "No space left on device (runs/results.json.part); make room" in line


def test_an_error_of_the_system_that_nobody_foresaw_is_not_hidden(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(BlockingIOError):
        end_of(monkeypatch, OSError(errno.EAGAIN, "try again"))
