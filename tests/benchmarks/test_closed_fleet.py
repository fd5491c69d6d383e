"""The comparison of a closed fleet with an open one runs, and times all that it names."""

from __future__ import annotations

import pytest
from ports import free_port

from benchmarks import closed_fleet


def test_every_operation_is_timed_in_both_fleets(capsys: pytest.CaptureFixture[str]) -> None:
    closed_fleet.main(["--rounds", "2", "--robots", "2", "--port", str(free_port())])
    head, *rows = capsys.readouterr().out.splitlines()
    assert head.startswith("2 robots, 2 rounds")
    for what in ("open a session", "ask a robot for 3 kB", "stop a robot"):
        assert sum(row.startswith(what) and "×" in row for row in rows) == 2
