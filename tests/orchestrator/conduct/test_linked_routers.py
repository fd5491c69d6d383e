"""A round whose robots and orchestrator are at different routers, which a third one links."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path

import pytest
from fleet_lab import Gate
from polling import PATIENCE_S
from round_lab import ROBOTS, TEST, join_lab
from routers_lab import kept_router

from nufleet.orchestrator.conduct.attempts import ATTEMPTS
from nufleet.orchestrator.fleet import goal_pursuit
from nufleet.orchestrator.study.outcomes import Measured


def test_every_robot_is_measured_although_the_router_in_the_middle_restarts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # How soon they find each other again is up to the machine.
    monkeypatch.setattr(goal_pursuit, "RETURN_PATIENCE_S", PATIENCE_S)
    monkeypatch.setattr(goal_pursuit, "REFUSAL_PATIENCE_S", PATIENCE_S)
    monkeypatch.setattr(goal_pursuit, "REFUSALS_PATIENCE_S", PATIENCE_S)
    at = {name: f"unixsock-stream/{tmp_path}/{name}.sock" for name in ("hall", "dock", "desk")}
    with ExitStack() as stack, ThreadPoolExecutor(1) as pool:
        hall = stack.enter_context(ExitStack())
        hall.enter_context(kept_router(at["hall"]))
        for end in ("dock", "desk"):
            stack.enter_context(kept_router(at[end], connect=at["hall"]))
        lab = join_lab(stack, tmp_path, 1.0, at["dock"], at["desk"])
        gate = Gate(lab.robots["r1"], at_sample=5)
        running = pool.submit(lab.run, **dict.fromkeys(ROBOTS, TEST))
        assert gate.reached.wait(PATIENCE_S)
        hall.close()
        hall.enter_context(kept_router(at["hall"]))
        gate.opened.set()
        outcomes = running.result()
    assert {robot for robot, outcome in outcomes.items() if isinstance(outcome, Measured)} == {
        *ROBOTS
    }
    for robot in lab.robots.values():
        assert 1 <= robot.motions <= ATTEMPTS
