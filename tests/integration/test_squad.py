"""What robots that share a session do together: one stop of the fleet reaches all of them."""

from __future__ import annotations

import queue
from collections.abc import Callable

import pytest
from fleet_lab import KEYS, Lab
from polling import PATIENCE_S

from nufleet.robot_agent.network.squad import Halted, Squad


def test_a_stop_of_the_fleet_halts_all_robots_that_are_there_before_it_does_more_for_any(
    lab: Lab, caplog: pytest.LogCaptureFixture
) -> None:
    told: queue.Queue[str] = queue.Queue()

    def member(name: str) -> Halted:
        def halted(key: str, payload: bytes) -> Callable[[], None]:
            told.put(f"{name} halted: {payload.decode()}")
            return lambda: told.put(f"{name} done")

        return halted

    def broken(key: str, payload: bytes) -> Callable[[], None]:
        raise ValueError("a mistake")

    with lab.session() as session, lab.session() as sender, Squad(session, KEYS) as squad:
        leave = squad.hear_stops("gone", member("gone"))
        squad.hear_stops("broken", broken)
        squad.hear_stops("a", member("a"))
        squad.hear_stops("b", member("b"))
        leave()
        sender.put_urgent(KEYS.stop("orchestrator"), b"smoke")
        found = [told.get(timeout=PATIENCE_S) for _ in range(4)]
    assert found == ["a halted: smoke", "b halted: smoke", "a done", "b done"]
    assert told.empty()
    assert "broken could not be stopped" in caplog.text
