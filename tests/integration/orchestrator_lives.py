"""Orchestrators that die when one says: each a process of its own, forked from one that is ready.

Run as a program it reads one life a line from stdin, forks a process that lives it, and answers
with how that ended.
"""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from sqlalchemy import Connection

from nufleet.orchestrator.conduct import leases as held_leases
from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.conductor import Conclusion, conduct
from nufleet.orchestrator.conduct.dispatcher import Dispatcher
from nufleet.orchestrator.conduct.leases import lease_robots
from nufleet.orchestrator.conduct.recipe import make_study, recipe_of
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.errors import UnknownRecordError
from nufleet.orchestrator.repository.records import StudyRecord, StudyStatus
from nufleet.orchestrator.repository.repository import open_repository
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.orchestrator.study.paper_algorithm import PaperStudy
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Quality
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.transport import open_client

PATIENCE_S = 120.0
"""Bounds a hang only; this file is also a program of its own, which the tests start."""

ROBOTS = ("target", "near", "far")
PLAN = StudyPlan("target", ("near", "far"), (5.0, 40.0), 2, "x")
SEED = 3


@dataclass(frozen=True)
class Life:
    """One orchestrator that begins or resumes a study, and may be killed at a commit."""

    study_id: str
    endpoint: str
    database: str
    owner: str
    algorithm: str = "paper"
    killed_at: int | None = None
    before_commit: bool = False


class OrchestratorLives:
    """A process that forks orchestrators; `live` returns once one has ended."""

    def __init__(self) -> None:
        self._process = subprocess.Popen(
            [sys.executable, __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        )

    def __enter__(self) -> OrchestratorLives:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate(timeout=PATIENCE_S)

    def live(self, life: Life) -> bool:
        """Have an orchestrator live; return whether it was killed. Otherwise it must succeed."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps(asdict(life)) + "\n")
        self._process.stdin.flush()
        code = int(self._process.stdout.readline())
        assert code in (0, -signal.SIGKILL), f"{life} ended with {code}"
        return code != 0


def ranking_of(conclusion: Conclusion) -> list[list[object]]:
    """What must be alike to the last bit."""
    ranking = conclusion.report.ranking
    return [[one.robot, one.psi, one.psi_low, one.psi_high, one.tests] for one in ranking]


@contextmanager
def dying(killed_at: int | None, *, before_commit: bool) -> Iterator[None]:
    """Have this process killed when it commits for the nth time, just before or just after."""
    write, commits = Database.write, itertools.count(1)  # what several threads write is one

    @contextmanager
    def counted(database: Database) -> Iterator[Connection]:
        with write(database) as connection:
            yield connection
            last = next(commits) == killed_at  # in one step, since there are several threads
            if last and before_commit:
                os.kill(os.getpid(), signal.SIGKILL)
        if last:
            os.kill(os.getpid(), signal.SIGKILL)

    Database.write = counted  # type: ignore[method-assign]
    try:
        yield
    finally:
        Database.write = write  # type: ignore[method-assign]


class Silent:
    """An observer of a study that says nothing."""

    def asked(self, *_: object) -> None: ...

    def attempt_failed(self, *_: object) -> None: ...

    def told(self, *_: object) -> None: ...


def live(life: Life) -> None:
    """Begin a study, or go on with it, to its end."""
    with (
        open_client(life.endpoint, timeout_s=PATIENCE_S) as session,
        open_repository(life.database) as repository,
        dying(life.killed_at, before_commit=life.before_commit),
    ):
        fleet = Fleet(session, FleetKeys("lab"), life.owner)
        fleet.wait_for(ROBOTS, timeout_s=PATIENCE_S)
        described = fleet.describe_all(ROBOTS)
        with lease_robots(repository.leases, fleet, "lab", described, patient=True) as leases:
            archive = Archive(repository, "lab", leases)
            study = _study(archive, fleet, life)
            if study.status is not StudyStatus.OPEN:
                return
            log = archive.log(study.study_id)
            specs = recipe_of(study).specs
            dispatcher = Dispatcher(fleet, log, specs, on_attempt_failed=Silent().attempt_failed)
            studies = repository.studies
            with archive.conducting(study.study_id, dispatcher.interrupt):
                conclusion = conduct(make_study(study, studies), log, dispatcher, Silent())
            result = {"ranking": ranking_of(conclusion)}
            studies.end(study.study_id, StudyStatus.COMPLETE, "done", result)


def _study(archive: Archive, fleet: Fleet, life: Life) -> StudyRecord:
    try:
        return archive.repository.studies.study(life.study_id)
    except UnknownRecordError:
        robots = fleet.describe_all(ROBOTS)
        return archive.begin(life.study_id, life.algorithm, PLAN, SEED, robots)


def warm_up() -> None:
    """Compile what a study needs, so that every life has it."""
    study = PaperStudy(PLAN, np.random.default_rng(SEED))
    while (question := study.ask()) is not None:
        omega = np.array(question.omega_rad_s)
        z, variance = np.ones(len(omega), dtype=complex), np.full(len(omega), 1e-6)
        response = FrequencyResponse(omega, z, variance, 3, Quality())
        study.tell(dict.fromkeys(ROBOTS, response), {})


def main() -> None:
    # A lease outlives its owner by a moment; none is renewed, so that commits can be counted.
    held_leases.TERM_S, held_leases.RENEW_EVERY_S = 0.2, 60.0
    warm_up()
    for line in sys.stdin:
        child = os.fork()
        if child == 0:
            # What the child prints is no answer.
            os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
            live(Life(**json.loads(line)))
            os._exit(0)
        _, status = os.waitpid(child, 0)
        sys.stdout.write(f"{os.waitstatus_to_exitcode(status)}\n")
        sys.stdout.flush()


if __name__ == "__main__":
    # The tests' own modules are found as pytest finds them.
    sys.path.insert(0, str(Path(__file__).parent))
    main()
