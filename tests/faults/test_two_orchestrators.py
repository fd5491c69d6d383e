"""Two orchestrators that want the same robots: one gets them, the other is told who has them."""

from __future__ import annotations

import re

from benchmarks.faults.lab import SECTION_V, Lab
from benchmarks.faults.program import wait_until
from nufleet.orchestrator.repository.records import StudyStatus
from nufleet.orchestrator.repository.repository import open_repository

ROBOTS = tuple(SECTION_V)


def test_of_two_processes_that_race_for_robots_one_owns_them_and_the_other_says_who(
    lab: Lab,
) -> None:
    lab.describe_section_v()
    lab.router()
    watcher = lab.orchestrator(name="watcher")
    database = lab.folder / "nufleet.sqlite"
    # A lease that no process on a busy machine is too slow to renew.
    rivals = [lab.study(f"s{n}", database, ROBOTS, iterations=2, term_s=60.0) for n in (1, 2)]
    # Both wait for the robots, so that neither is done before the other has begun.
    wait_until(lambda: all(watcher.is_alive(f"orchestrator-{n}") for n in (1, 2)))
    lab.agent(*ROBOTS, realtime=2.0)
    # A patient one waits for an owner that may be dead, and gives up when it sees it renew.
    wait_until(lambda: any(not rival.running for rival in rivals))
    loser, winner = sorted(rivals, key=lambda rival: rival.running)
    assert loser.wait() == 1
    assert winner.wait() == 0
    owner = re.findall(r"LeaseHeldError: .*(orchestrator-\d)", loser.said)
    assert owner, loser.said
    with open_repository(str(database)) as repository:
        (study,) = repository.studies.studies()
        trials = repository.studies.trials(study.study_id)
    assert study.status is StudyStatus.COMPLETE
    assert winner.what == f"{study.study_id} {owner[0].removeprefix('orchestrator-')}"
    assert len({trial.intent.epoch for trial in trials}) == 1
    assert sum(len(lab.motions(robot)) for robot in ROBOTS) == len(trials)
