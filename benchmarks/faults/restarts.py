"""Routers that restart and orchestrators that are killed during studies: what it costs."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from itertools import count
from pathlib import Path

import numpy as np

from benchmarks.faults.figure import Figure
from benchmarks.faults.lab import SECTION_V, Lab, opened_lab
from benchmarks.faults.program import Program, wait_until
from nufleet.orchestrator.repository.records import StudyStatus
from nufleet.orchestrator.repository.repository import Repository, open_repository

ROBOTS = tuple(SECTION_V)
ITERATIONS = 7
REALTIME = 20.0
STUDY_MAX_S = 600.0


def figures(restarts: int) -> list[Figure]:
    """Restart the router during one study, and kill as many orchestrators in other studies."""
    rng = np.random.default_rng(21)
    with (
        tempfile.TemporaryDirectory() as folder,
        opened_lab(Path(folder)) as lab,
        open_repository(f"{folder}/nufleet.sqlite") as repository,
    ):
        lab.describe_section_v()
        router = lab.router()
        for robot in ROBOTS:
            lab.agent(robot, realtime=REALTIME)
        scene = _Scene(lab, repository)
        quiet_s = scene.timed("quiet", _let_it_end)
        routers_s = scene.timed(
            "routers", lambda study: _restart_router(lab, router, study, restarts, rng)
        )
        found = scene.figures("router restarts", restarts, ("routers",), quiet_s, routers_s)
        kills, began_s = 0, time.monotonic()
        names: list[str] = []
        while kills < restarts:
            names.append(f"killed-{len(names)}")
            kills += scene.killed(names[-1], restarts - kills, rng)
        seconds = time.monotonic() - began_s
        return found + scene.figures("orchestrator kills", kills, tuple(names), quiet_s, seconds)


class _Scene:
    """Robots that stay, and the studies of them."""

    def __init__(self, lab: Lab, repository: Repository) -> None:
        self._lab, self._repository = lab, repository
        self._motions: dict[str, int] = {}

    def timed(self, study_id: str, disturb: Callable[[Program], None]) -> float:
        """Run a study with one orchestrator; return the seconds that it took."""
        before, began_s = self._moved(), time.monotonic()
        study = self._start(study_id)
        study.wait_for("works on")
        disturb(study)
        self._end(study_id, before)
        return time.monotonic() - began_s

    def killed(self, study_id: str, most: int, rng: np.random.Generator) -> int:
        """Run a study whose orchestrators are killed at most `most` times; return the number."""
        before = self._moved()
        for kills in count():
            study = self._start(study_id)
            wait_until(
                lambda: "works on" in study.said or not study.running,  # noqa: B023
                timeout_s=STUDY_MAX_S,
            )
            ends_s = time.monotonic() + float(rng.uniform(0.0, 2.0))
            wait_until(
                lambda: time.monotonic() > ends_s or not study.running,  # noqa: B023
                timeout_s=STUDY_MAX_S,
            )
            if not study.running or kills == most:
                _let_it_end(study)
                self._end(study_id, before)
                return kills
            study.kill()
        raise AssertionError("not reached")

    def figures(
        self, what: str, times: int, studies: tuple[str, ...], quiet_s: float, seconds: float
    ) -> list[Figure]:
        """Return the figures of studies that were disturbed `times` times."""
        quiet = self._repository.studies.study("quiet").result
        trials = [t for study in studies for t in self._repository.studies.trials(study)]
        open_trials = sum(not trial.status.ended for trial in trials)
        results = [self._repository.studies.study(study).result for study in studies]
        moved = sum(self._motions[study] for study in studies)
        took = {"studies": len(studies), "attempts": len(trials), "took": f"{seconds:.0f} s"}
        took["undisturbed"] = f"{quiet_s:.0f} s each"
        return [
            Figure(f"goals lost over {times} {what}", float(open_trials), "", 0.0, took),
            Figure(
                f"motions beyond one for each attempt over {times} {what}",
                float(max(0, moved - len(trials))),
                "",
                0.0,
                {"motions": moved},
            ),
            Figure(
                f"studies with another ranking over {times} {what}",
                float(sum(result != quiet for result in results)),
                "",
                0.0,
            ),
        ]

    def _start(self, study_id: str) -> Program:
        database = self._lab.folder / "nufleet.sqlite"
        return self._lab.study(study_id, database, ROBOTS, iterations=ITERATIONS)

    def _end(self, study_id: str, before: int) -> None:
        self._motions[study_id] = self._moved() - before
        status = self._repository.studies.study(study_id).status
        if status is not StudyStatus.COMPLETE:
            raise AssertionError(f"{study_id} ended {status}")

    def _moved(self) -> int:
        return sum(len(self._lab.motions(robot)) for robot in ROBOTS)


def _let_it_end(study: Program) -> None:
    wait_until(lambda: not study.running, timeout_s=STUDY_MAX_S)
    if study.wait() != 0:
        raise AssertionError(study.said[-3000:])


def _restart_router(
    lab: Lab, router: Program, study: Program, restarts: int, rng: np.random.Generator
) -> None:
    """Restart the router while the target moves, each time at another moment of its motion."""
    for _ in range(restarts):
        before = len(lab.motions(ROBOTS[0]))
        wait_until(
            lambda: not study.running or len(lab.motions(ROBOTS[0])) > before,  # noqa: B023
            timeout_s=STUDY_MAX_S,
        )
        if not study.running:
            raise AssertionError("the study ended before all restarts; give it more tests")
        time.sleep(float(rng.uniform(0.0, 0.3)))
        router.kill()
        router.start()
        router.wait_for("router listening on")
    _let_it_end(study)
