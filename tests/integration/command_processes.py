"""`nufleet` as a user runs it: commands that end, and fleets that stay up meanwhile."""

from __future__ import annotations

import os
import signal
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import pytest

from nufleet.shared import command_line

NUFLEET = [sys.executable, "-m", "nufleet"]
PATIENCE_S = 600.0
"""Ends a command that hangs; some learn for half a minute where nothing else runs."""


def nufleet(*arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a command to its end."""
    return subprocess.run(
        [*NUFLEET, *arguments],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


def trial_statuses(database: Path) -> list[str]:
    """How far each trial is; read beside the process that writes them, without a lock."""
    if not database.exists():
        return []
    with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as connection:
        try:
            return [status for (status,) in connection.execute("SELECT status FROM trials")]
        except sqlite3.OperationalError:  # its tables are not made yet
            return []


class Typed:
    """Runs commands in this process, as `nufleet` does, without starting Python again.

    For what is refused: what matters is the exit code and what was said.
    """

    def __init__(self, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> None:
        self._monkeypatch, self._capfd = monkeypatch, capfd

    def __call__(self, *arguments: str, cwd: Path) -> subprocess.CompletedProcess[str]:
        self._capfd.readouterr()
        before = {n: signal.getsignal(n) for n in (signal.SIGTERM, signal.SIGHUP)}
        try:
            with self._monkeypatch.context() as patched:
                patched.chdir(cwd)
                patched.setattr(sys, "argv", ["nufleet", *arguments])
                with pytest.raises(SystemExit) as ended:
                    command_line.main()
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)
        out, said = self._capfd.readouterr()
        assert isinstance(ended.value.code, int)
        return subprocess.CompletedProcess(arguments, ended.value.code, out, said)


def begun(*arguments: str, cwd: Path, state: Path | None = None) -> subprocess.Popen[str]:
    """Begin a command in a process group of its own; `state` is where its agents remember."""
    environment = dict(os.environ) | ({} if state is None else {"NUFLEET_STATE": str(state)})
    return subprocess.Popen(
        [*NUFLEET, *arguments],
        cwd=cwd,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


@contextmanager
def fleet_that_is_up(
    file: Path, endpoint: str, state: Path, *options: str
) -> Iterator[subprocess.Popen[str]]:
    """Keep a fleet up; it ends by Ctrl-C."""
    up = begun("fleet", "up", str(file), "--listen", endpoint, *options, cwd=state, state=state)
    assert up.stderr is not None
    try:
        line = up.stderr.readline()
        assert "are up" in line, line + up.stderr.read()
        yield up
    finally:
        up.send_signal(signal.SIGINT)
        up.communicate(timeout=PATIENCE_S)
