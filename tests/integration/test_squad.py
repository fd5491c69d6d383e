"""What robots that share a session do together: one stop of the fleet reaches all of them."""

from __future__ import annotations

import queue

import pytest
from fleet_lab import KEYS, Lab
from polling import PATIENCE_S

from nufleet.robot_agent.network.squad import Squad


def test_a_stop_of_the_fleet_reaches_the_robots_that_are_there_though_one_of_them_fails(
    lab: Lab, caplog: pytest.LogCaptureFixture
) -> None:
    told: queue.Queue[str] = queue.Queue()

    def broken(key: str, payload: bytes) -> None:
        raise ValueError("a mistake")

    with lab.session() as session, lab.session() as sender, Squad(session, KEYS) as squad:
        leave = squad.hear_stops("gone", lambda key, payload: told.put("gone"))
        squad.hear_stops("broken", broken)
        squad.hear_stops("there", lambda key, payload: told.put(f"there: {payload.decode()}"))
        leave()
        sender.put_urgent(KEYS.stop("orchestrator"), b"smoke")
        assert told.get(timeout=PATIENCE_S) == "there: smoke"
    assert told.empty()
    assert "broken could not be stopped" in caplog.text
