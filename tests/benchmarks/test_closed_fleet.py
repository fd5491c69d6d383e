"""The comparison of a closed fleet with an open one runs, and times all that it names."""

from __future__ import annotations

import pytest
from ports import free_port

from benchmarks import closed_fleet


def test_every_operation_is_timed_in_both_fleets(capsys: pytest.CaptureFixture[str]) -> None:
    few = ["--rounds", "2", "--iterations", "1", "--robots", "2"]
    closed_fleet.main([*few, "--port", str(free_port())])
    head, _, *rows = capsys.readouterr().out.splitlines()
    assert head.startswith("2 robots, 2 rounds, 1 iterations")
    for what in ("open a session", "ask a robot for 3 kB", "stop a robot", "test 2 robots"):
        assert sum(row.startswith(what) and "×" in row for row in rows) == 2
