"""An orchestrator in a process of its own that begins or resumes a study."""

from __future__ import annotations

import argparse
import json
import logging
import os
import sys
from collections.abc import Mapping
from functools import partial
from pathlib import Path

from benchmarks.faults.study import Story, plan_of, ranking_of
from nufleet.orchestrator.conduct import leases as held_leases
from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.conductor import conduct
from nufleet.orchestrator.conduct.dispatcher import Dispatcher
from nufleet.orchestrator.conduct.leases import lease_robots
from nufleet.orchestrator.conduct.recipe import make_study, recipe_of
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.repository.errors import UnknownRecordError
from nufleet.orchestrator.repository.records import StudyRecord, StudyStatus
from nufleet.orchestrator.repository.repository import Repository, open_repository
from nufleet.shared.errors import NufleetError
from nufleet.shared.lifeline import when_stdin_closes
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import Description
from nufleet.shared.wire.transport import open_client

FLEET = "lab"
SEED = 3
TERM_S = 2.0
"""Term of a lease, which a successor waits for after a kill; shorter than the product's own."""

RENEW_EVERY_S = 0.5


def main() -> None:
    """Do what the command line says; exit code 1 for an error that has a name."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("connect", "study", "owner"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--database", type=Path, required=True)
    parser.add_argument("--iterations", type=int, required=True)
    parser.add_argument("--robots", nargs="+", required=True)
    parser.add_argument("--term-s", type=float, default=TERM_S)
    own = parser.parse_args()
    logging.basicConfig(level=logging.INFO)
    when_stdin_closes(partial(os._exit, 0))
    held_leases.TERM_S, held_leases.RENEW_EVERY_S = own.term_s, RENEW_EVERY_S
    robots = tuple(own.robots)
    try:
        with (
            open_client(own.connect, timeout_s=30.0) as session,
            open_repository(str(own.database)) as repository,
        ):
            fleet = Fleet(session, FleetKeys(FLEET), own.owner)
            fleet.wait_for(robots, timeout_s=60.0)
            _run(fleet, repository, own.study, robots, own.iterations)
    except NufleetError as error:
        print(f"error: {type(error).__name__}: {error}", flush=True)
        sys.exit(1)


def _run(
    fleet: Fleet, repository: Repository, study_id: str, robots: tuple[str, ...], iterations: int
) -> None:
    described = fleet.describe_all(robots)
    with lease_robots(repository.leases, fleet, FLEET, described, patient=True) as leases:
        archive = Archive(repository, FLEET, leases)
        study = _study(archive, study_id, described, iterations)
        if study.status is not StudyStatus.OPEN:
            return
        print(f"works on {study_id}", flush=True)
        story = Story()
        log = archive.log(study_id)
        specs = recipe_of(study).specs
        dispatcher = Dispatcher(fleet, log, specs, on_attempt_failed=story.attempt_failed)
        with archive.conducting(study_id, dispatcher.interrupt):
            conclusion = conduct(make_study(study, repository.studies), log, dispatcher, story)
        result = {
            "ranking": [list(row) for row in ranking_of(conclusion)],
            "dropped": dict(conclusion.report.dropped),
        }
        repository.studies.end(
            study_id, StudyStatus.COMPLETE, "done", json.loads(json.dumps(result))
        )


def _study(
    archive: Archive, study_id: str, described: Mapping[str, Description], iterations: int
) -> StudyRecord:
    try:
        return archive.repository.studies.study(study_id)
    except UnknownRecordError:
        plan = plan_of(tuple(described), iterations=iterations)
        return archive.begin(study_id, "paper", plan, SEED, described)


if __name__ == "__main__":
    main()
