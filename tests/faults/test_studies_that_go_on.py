"""Studies in which things go wrong come to the ranking of the undisturbed one."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import pytest

from benchmarks.faults.lab import SECTION_V, Lab, opened_lab
from benchmarks.faults.logbook import HALF_WAY, MOVES, TOLD_TO_REST
from benchmarks.faults.program import PATIENCE_S, Program, wait_until
from benchmarks.faults.study import Story, plan_of, ranking_of, run_study
from nufleet.orchestrator.fleet import goal_pursuit
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.study.interface import Question

ROBOTS = tuple(SECTION_V)
PLAN = plan_of(ROBOTS, iterations=3)

Ranking = list[tuple[str, float, int]]


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Ranking:
    with opened_lab(tmp_path_factory.mktemp("undisturbed")) as lab:
        fleet, *_ = start(lab)
        return ranking_of(run_study(fleet, PLAN, "undisturbed", Story()))


def start(lab: Lab) -> tuple[Fleet, Program, dict[str, Program]]:
    """A fleet that plays a test of some seconds in half a second and takes a moment to rest."""
    lab.describe_section_v(rest_s=0.2)
    router = lab.router()
    agents = {robot: lab.agent(robot, realtime=20.0) for robot in ROBOTS}
    return lab.orchestrator(*ROBOTS), router, agents


MOMENTS = (MOVES, HALF_WAY, TOLD_TO_REST)
"""When a test dies with its agent; one moment in each round."""


class Killer(Story):
    """A study in which an agent is killed once in each round."""

    def __init__(self, lab: Lab, robot: str) -> None:
        super().__init__()
        self._lab, self._robot = lab, robot

    def asked(self, question: Question) -> None:
        super().asked(question)
        self._lab.kill_at(self._robot, MOMENTS[question.iteration - 1])

    def restart(self, agent: Program) -> None:
        """Start an agent again as often as it is killed."""
        for _ in MOMENTS:
            wait_until(lambda: not agent.running)
            agent.kill()
            agent.start()


@pytest.fixture(autouse=True)
def _patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A busy machine may take long to start a process; no robot is given up for that here."""
    monkeypatch.setattr(goal_pursuit, "RETURN_PATIENCE_S", PATIENCE_S)


def test_kills_at_any_moment_of_a_test_leave_the_ranking_as_it_is(
    lab: Lab, undisturbed: Ranking
) -> None:
    fleet, _, agents = start(lab)
    killer = Killer(lab, "near")
    with ThreadPoolExecutor(1) as pool:
        restarting = pool.submit(killer.restart, agents["near"])
        conclusion = run_study(fleet, PLAN, "killed", killer)
        restarting.result()
    assert ranking_of(conclusion) == undisturbed
    assert [(robot, attempt) for robot, attempt, _ in killer.failed] == [("near", 1)] * 3
    assert all("near" in reason or "ended during it" in reason for *_, reason in killer.failed)
    # One motion for each attempt, and the others' measurements stayed.
    assert len(lab.motions("near")) == 3 + 3
    assert [len(lab.motions(robot)) for robot in ("target", "far")] == [3, 3]


def test_a_router_that_restarts_in_every_round_costs_attempts_and_nothing_else(
    lab: Lab, undisturbed: Ranking
) -> None:
    fleet, router, _ = start(lab)
    story = Story()
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(run_study, fleet, PLAN, "restarts", story)
        for number in range(1, 4):
            wait_until(
                lambda: running.done() or len(lab.motions("target")) >= number  # noqa: B023
            )
            router.kill()
            router.start()
        conclusion = running.result()
    assert ranking_of(conclusion) == undisturbed
    for robot in ROBOTS:
        attempts = 3 + sum(lost == robot for lost, *_ in story.failed)
        assert len(lab.motions(robot)) <= attempts
