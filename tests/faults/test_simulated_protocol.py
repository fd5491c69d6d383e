"""The protocol under a virtual clock: thousands of schedules of faults, and what must hold in all.

`python -m benchmarks.faults simulate` runs as many as one likes, and shows the shortest story that
breaks an invariant.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator

import pytest

from benchmarks.faults.simulation.network import Weather
from benchmarks.faults.simulation.schedule import Fault, Schedule, drawn
from benchmarks.faults.simulation.simulation import Simulation, shortened, story, violation
from benchmarks.faults.simulation.without import WITHOUT, without
from nufleet.orchestrator.repository.records import TrialStatus

SEEDS_AT_ONCE = 300

FOUND_AT = {
    "1-interrupt": 99,
    "6-late-states": 17,
    "10-repositories": 2475,
    "11-longer": 41,
    "12-clock": 35,
    "16-in-turn": 112,
    "forgone": 1855,
    "frozen": 4797,
    "refused": 21_958,
    "killed": 1,
    "kill-fault": 13,
    "kill-stored": 90,
    "kill-cured": 1,
    "kill-released": 603,
    "frozen-beginning": 504,
    "unready": 2,
    "unready-moving": 2,
    "old-health": 64,
    "halted": 56,
    "landed": 11,
    "starved": 7754,
}
"""The first seed that is known to reveal each missing fix; `simulate --without FIX` finds it."""


@pytest.fixture(autouse=True)
def quietly() -> Iterator[None]:
    """What goes wrong is meant to, thousands of times."""
    logging.disable(logging.CRITICAL)
    yield
    logging.disable(logging.NOTSET)


@pytest.mark.parametrize("first", range(0, 3000, SEEDS_AT_ONCE))
def test_no_schedule_of_faults_breaks_an_invariant(first: int) -> None:
    for seed in range(first, first + SEEDS_AT_ONCE):
        assert violation(drawn(seed)) is None, f"seed {seed}"


@pytest.mark.parametrize("fix", WITHOUT)
def test_every_fix_is_missed_when_it_is_taken_out(fix: str) -> None:
    schedule = drawn(FOUND_AT[fix])
    with without(fix):
        assert violation(schedule) is not None
    assert violation(schedule) is None


def late_heartbeats(seed: int) -> Simulation:
    """A study in which each state of both robots arrives up to 5 s late, at random."""
    late = tuple(Fault(0.1, "late states", robot, 60.0) for robot in (1, 2))
    duration_max_s, idle_s = (7.0, 60.0)[seed % 2], (None, 3.0)[seed // 2 % 2]
    simulation = Simulation(Schedule(seed, 2, duration_max_s, Weather(), idle_s, late))
    simulation.run()
    return simulation


def test_no_robot_is_given_up_in_1000_tests_with_heartbeats_up_to_5_s_late() -> None:
    tests = 0
    for simulation in map(late_heartbeats, range(250)):
        trials = simulation.repository.trials.values()
        assert {(trial.status, trial.intent.attempt) for trial in trials} == {
            (TrialStatus.MEASURED, 1)
        }
        tests += len(trials)
    assert tests == 1000


def test_a_seed_gives_the_same_story_every_time() -> None:
    schedule = drawn(141)
    assert story(schedule) == story(schedule)


def test_a_schedule_that_breaks_an_invariant_is_shortened_to_the_faults_that_matter() -> None:
    with without("11-longer"):
        several = (s for s in map(drawn, range(1000)) if len(s.faults) > 2)
        broken = next(schedule for schedule in several if violation(schedule) is not None)
        short = shortened(broken)
        assert {fault.kind for fault in short.faults} == {"bad sensor"}
        assert set(short.faults) < set(broken.faults)
        assert "VIOLATION" in story(short)[-1]
    assert violation(short) is None
