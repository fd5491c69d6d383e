"""Clocks that are an hour apart change nothing: no estimate, no deadline, no state that is late."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.faults.lab import Lab
from benchmarks.faults.program import PATIENCE_S, wait_until
from benchmarks.faults.study import Story, plan_of, ranking_of, run_study
from nufleet.orchestrator.fleet.goal_runner import GoalRunner
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.messages import Outcome

SHORT = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),), settle_s=0.5)


def clock_off_by(hours: int) -> dict[str, str]:
    """The environment of a process whose wall clock is wrong; its monotonic clock is not."""
    found = sorted(Path("/usr/lib").glob("*/faketime/libfaketime.so.1"))
    assert found, "clocks cannot be set apart: install libfaketime (apt-get install libfaketime)"
    return {
        "LD_PRELOAD": str(found[0]),
        "FAKETIME": f"{hours:+d}h",
        "FAKETIME_DONT_FAKE_MONOTONIC": "1",
    }


def test_the_clocks_of_these_tests_are_wrong() -> None:
    said = "import time; print(time.time(), time.monotonic())"
    for hours in (-1, 1):
        environment = {**os.environ, **clock_off_by(hours)}
        before = (time.time(), time.monotonic())
        done = subprocess.run([sys.executable, "-c", said], env=environment, capture_output=True)
        wall_s, monotonic_s = map(float, done.stdout.split())
        assert before[0] - 1.0 < wall_s - 3600 * hours < time.time() + 1.0
        assert before[1] < monotonic_s < time.monotonic()


def test_agents_whose_clocks_are_two_hours_apart_give_the_same_ranking(lab: Lab) -> None:
    robots = ("target", "near")
    lab.describe_section_v({"target": 0.85, "near": 0.9})
    lab.router()
    fleet = lab.orchestrator()
    plan = plan_of(robots, iterations=2)
    agents = [lab.agent(*robots)]
    fleet.wait_for(robots, timeout_s=PATIENCE_S)
    expected = run_study(fleet, plan, "right", Story())
    agents[0].end()
    wait_until(lambda: fleet.robots() == ())
    lab.agent("target", environment=clock_off_by(1))
    lab.agent("near", environment=clock_off_by(-1))
    fleet.wait_for(robots, timeout_s=PATIENCE_S)
    story = Story()
    found = run_study(fleet, plan, "wrong", story)
    assert ranking_of(found) == ranking_of(expected)
    assert story.failed == []


def test_death_and_return_are_noticed_whatever_the_clocks_say(lab: Lab) -> None:
    lab.describe_section_v({"a": 0.9})
    lab.router()
    agent = lab.agent("a", realtime=1.0, environment=clock_off_by(1))
    fleet = lab.orchestrator("a")
    boot_id = lab.wait_for_state(fleet, "a", lambda state: True).boot_id
    agent.kill()
    # Long before the hour that the clocks are apart.
    assert fleet.watch("a").wait_until(lambda w: not w.alive, timeout_s=PATIENCE_S)
    # It comes back from the future into the past.
    behind = lab.agent("a", realtime=20.0, environment=clock_off_by(-1))
    lab.wait_for_state(fleet, "a", lambda state: state.boot_id != boot_id)
    fleet.wait_for(("a",), timeout_s=PATIENCE_S)
    result = GoalRunner(fleet).run("a", "g", SHORT)
    assert result.outcome is Outcome.COMPLETED
    assert behind.running
