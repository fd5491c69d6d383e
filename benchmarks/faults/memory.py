"""What an orchestrator and an agent hold in memory while they do one test after the other."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import psutil

from benchmarks.faults.figure import Figure
from benchmarks.faults.fuzzing import resident_bytes
from benchmarks.faults.lab import Lab, opened_lab
from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.dispatcher import Dispatcher
from nufleet.orchestrator.conduct.leases import lease_robots
from nufleet.orchestrator.conduct.recipe import recipe_of
from nufleet.orchestrator.conduct.replay import OpenTest, goal_id_of
from nufleet.orchestrator.repository.repository import Repository, open_repository
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.orchestrator.study.outcomes import Failed
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.excitation import Excitation, Tone

GROWTH_MAX_KIB_PER_TEST = 2.0
"""Bound on the growth of a process; the goals that a journal keeps account for less than half."""

WARM_UP = 0.3
LOOKS = 50
TEST = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),), settle_s=0.5)
STUDY = "memory"


def figures(tests: int) -> list[Figure]:
    """Run `tests` tests on one robot; the slopes leave out the first share (`WARM_UP`) of them."""
    with (
        tempfile.TemporaryDirectory() as folder,
        opened_lab(Path(folder)) as lab,
        open_repository(f"{folder}/nufleet.sqlite") as repository,
    ):
        return _measure(lab, repository, tests)


def _measure(lab: Lab, repository: Repository, tests: int) -> list[Figure]:
    lab.describe_section_v({"a": 0.9, "b": 0.95})
    lab.router()
    agent = lab.agent("a", "b")
    fleet = lab.orchestrator("a", "b")
    counted: list[int] = []
    ours: list[int] = []
    theirs: list[int] = []
    descriptions = fleet.describe_all(("a", "b"))
    with lease_robots(repository.leases, fleet, "lab", descriptions) as leases:
        archive = Archive(repository, "lab", leases)
        plan = StudyPlan("a", ("b",), (5.0, 40.0), 1, "x")
        begun = archive.begin(STUDY, "paper", plan, 0, descriptions)
        specs = recipe_of(begun).specs
        dispatcher = Dispatcher(fleet, archive.log(STUDY), specs, on_attempt_failed=_fail)
        resources = _resources(agent.pid)
        for number in range(1, tests + 1):
            _test(dispatcher, number)
            if number == max(1, tests // LOOKS):
                resources = _resources(agent.pid)
            if number % max(1, tests // LOOKS) == 0:
                counted.append(number)
                ours.append(resident_bytes())
                theirs.append(resident_bytes(agent.pid))
        more = _resources(agent.pid) - resources
    return [
        _slope("memory of the orchestrator grows by", counted, ours),
        _slope("memory of the agent grows by", counted, theirs),
        Figure(
            "threads and open files of either that are left behind",
            float(np.max(more)),
            "",
            2.0,
            {"after tests": tests},
        ),
    ]


def _test(dispatcher: Dispatcher, number: int) -> None:
    goal_id = goal_id_of(STUDY, number, "a", 1)
    outcome = dispatcher.run((OpenTest(goal_id, number, "a", 1, TEST, None),))["a"]
    if isinstance(outcome, Failed):
        raise StudyError(f"test {number}: {outcome.reason}")


def _fail(robot: str, attempt: int, reason: str) -> None:
    raise AssertionError(f"{robot}, attempt {attempt}: {reason}")


def _resources(pid: int) -> np.ndarray:
    processes = (psutil.Process(), psutil.Process(pid))
    return np.array([n for p in processes for n in (p.num_threads(), p.num_fds())])


def _slope(name: str, tests: list[int], resident: list[int]) -> Figure:
    skipped = int(WARM_UP * len(tests))
    kib = np.array(resident[skipped:]) / 1024
    slope = float(np.polyfit(tests[skipped:], kib, 1)[0])
    details = {
        "first": f"{resident[0] / 2**20:.1f} MiB",
        "last": f"{resident[-1] / 2**20:.1f} MiB",
        "tests": tests[-1],
    }
    return Figure(name, slope, "KiB/test", GROWTH_MAX_KIB_PER_TEST, details)
