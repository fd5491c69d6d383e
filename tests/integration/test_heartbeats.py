"""What the heartbeats of a fleet at rest cost, counted: messages and decodes for each state."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

import pytest
from fleet_lab import KEYS, Lab
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot

from nufleet.orchestrator.fleet import heard_states
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.robot_agent.agent import Agent
from nufleet.robot_agent.network import rivals
from nufleet.robot_agent.network.squad import Squad
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.session import Session

ROBOTS = tuple(f"r{k}" for k in range(16))
BEATS = 6
"""States of each robot that are counted."""


def counting(counts: Counter[str], what: str, call: Callable[..., Any]) -> Callable[..., Any]:
    def count(*args: Any, **kwargs: Any) -> Any:
        counts[what] += 1
        return call(*args, **kwargs)

    return count


def counted_at_rest(
    lab: Lab, monkeypatch: pytest.MonkeyPatch, *, together: bool
) -> tuple[Counter[str], int]:
    """Return what is received and decoded while robots on one session rest, and in how many states.

    They, and the orchestrator that watches them, run in this process.
    """
    counts: Counter[str] = Counter()
    with ExitStack() as stack, monkeypatch.context() as patched:
        session = stack.enter_context(lab.session())
        squad = stack.enter_context(Squad(session, KEYS)) if together else None
        for robot in ROBOTS:
            agent = Agent(session, KEYS, robot, PuppetRobot(), realtime=None, squad=squad)
            stack.enter_context(agent)
        for name in ("_on_state", "_on_states"):
            patched.setattr(Fleet, name, counting(counts, "messages", getattr(Fleet, name)))
        patched.setattr(heard_states, "decode", counting(counts, "decodes", heard_states.decode))
        patched.setattr(rivals, "decode", counting(counts, "own decodes", rivals.decode))
        fleet = Fleet(stack.enter_context(lab.session()), KEYS, "watcher")
        fleet.wait_for(ROBOTS, timeout_s=PATIENCE_S)
        watches = [fleet.watch(robot) for robot in ROBOTS]
        wait_until(lambda: all(watch.state is not None for watch in watches))
        heard: Counter[str] = Counter()
        fleet.observe_states(lambda state: heard.update([state.robot]))
        counts.clear()
        wait_until(lambda: min(heard[robot] for robot in ROBOTS) >= BEATS)
        found = counts.copy()
        return found, sum(heard.values())


def test_robots_that_share_a_session_rest_at_a_few_messages_for_all(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    alone, states_alone = counted_at_rest(lab, monkeypatch, together=False)
    together, states_together = counted_at_rest(lab, monkeypatch, together=True)
    # An observer is told after the count, so a message or two may lie between the numbers.
    assert alone["messages"] == pytest.approx(states_alone, abs=len(ROBOTS))
    assert together["messages"] <= 2 * states_together / len(ROBOTS)
    assert together["decodes"] == pytest.approx(states_together, abs=len(ROBOTS))
    assert alone["own decodes"] == together["own decodes"] == 0


def test_an_orchestrator_of_a_closed_fleet_does_not_ask_for_common_messages(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    subscribe = Session.subscribe

    def noted(session: Session, key_expr: str, *args: Any, **kwargs: Any) -> Any:
        asked.append(key_expr)
        return subscribe(session, key_expr, *args, **kwargs)

    monkeypatch.setattr(Session, "subscribe", noted)
    closed = lab.session()
    Fleet(closed, KEYS, "open")
    assert asked == [KEYS.states]
    monkeypatch.setattr(closed, "identity", object())
    Fleet(closed, FleetKeys("closed"), "closed")
    assert asked == [KEYS.states]
