"""Studies in which things go wrong come to the ranking of the undisturbed one."""

from __future__ import annotations

import queue
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import pytest

from benchmarks.faults.lab import SECTION_V, Lab, opened_lab
from benchmarks.faults.program import Program, wait_until
from benchmarks.faults.study import Story, plan_of, ranking_of, run_study
from orchestrator.fleet import Fleet
from shared.messages import RobotState, RobotStatus

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


MOMENTS: dict[str, Callable[[RobotState], bool]] = {
    "accepted": lambda s: s.status is RobotStatus.RUNNING,
    "excited": lambda s: s.progress > 0.3,
    "resting": lambda s: s.status is RobotStatus.RESTING,
}
"""When a test dies with its agent; one moment in each round."""


class Killer:
    """Kills an agent at each moment, once, and starts it again."""

    def __init__(self, lab: Lab, agent: Program, robot: str) -> None:
        self._lab, self._agent, self._robot = lab, agent, robot
        self._moments = list(MOMENTS.values())
        self._rounds_killed: set[str] = set()
        self._reached: queue.SimpleQueue[None] = queue.SimpleQueue()

    def observe(self, state: RobotState) -> None:
        if state.robot != self._robot or state.goal_id is None or not self._moments:
            return
        round_id = state.goal_id.rpartition(".")[0]
        if round_id not in self._rounds_killed and self._moments[0](state):
            self._rounds_killed.add(round_id)
            self._moments.pop(0)
            self._reached.put(None)

    def work(self) -> None:
        for repeated in range(len(MOMENTS)):
            self._reached.get(timeout=60.0)
            # It says what it runs a moment before that is on disk; killed then, it knows nothing
            # of it and may take it again.
            wait_until(lambda: len(self._lab.motions(self._robot)) > 2 * repeated)  # noqa: B023
            self._agent.kill()
            self._agent.start()


def test_kills_at_any_moment_of_a_test_leave_the_ranking_as_it_is(
    lab: Lab, undisturbed: Ranking
) -> None:
    fleet, _, agents = start(lab)
    killer = Killer(lab, agents["near"], "near")
    fleet.observe_states(killer.observe)
    story = Story()
    with ThreadPoolExecutor(1) as pool:
        killing = pool.submit(killer.work)
        conclusion = run_study(fleet, PLAN, "killed", story)
        killing.result()
    assert ranking_of(conclusion) == undisturbed
    assert [(robot, attempt) for robot, attempt, _ in story.failed] == [("near", 1)] * 3
    assert all("near" in reason or "ended during it" in reason for *_, reason in story.failed)
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
