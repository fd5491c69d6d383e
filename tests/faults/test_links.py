"""Links that lose replies, and links that are slow: asked again by id, one motion for each goal."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor

import pytest

from benchmarks.faults import link
from benchmarks.faults.lab import SECTION_V, Lab
from benchmarks.faults.link import Link
from benchmarks.faults.program import PATIENCE_S, wait_until
from benchmarks.faults.study import Story, plan_of, ranking_of, run_study
from nufleet.orchestrator.fleet.goal_runner import GoalRunner
from nufleet.shared.errors import NoReplyError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.messages import GoalRequest, Outcome

SHORT = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),), settle_s=0.5)
LONG = Excitation(axis="x", tones=(Tone(omega_rad_s=1.0),), settle_s=60.0)


@pytest.fixture
def cable(lab: Lab) -> Iterator[Link]:
    """A link to the router over which the orchestrator, or an agent, can be reached."""
    lab.describe_section_v()
    lab.router()
    with link.opened(lab.socket) as cable:
        yield cable
        lab.close()


def test_a_goal_whose_acceptance_is_lost_moves_its_robot_once(lab: Lab, cable: Link) -> None:
    lab.agent("near", realtime=1.0)
    fleet = lab.orchestrator("near", connect=cable.endpoint)
    request = GoalRequest(goal_id="g", owner=fleet.orchestrator_id, motion=LONG)
    with ThreadPoolExecutor(1) as pool:
        cable.hold("down")
        answer = pool.submit(fleet.submit, "near", request)
        wait_until(lambda: len(lab.motions("near")) == 1)
        cable.cut()
        with pytest.raises(NoReplyError, match=r"robot near .* goal g"):
            answer.result(PATIENCE_S)
        cable.let_through()
    # The robot rested when its owner was cut off; asked again by id, it says so.
    fleet.wait_for(("near",), timeout_s=PATIENCE_S)
    result = GoalRunner(fleet).run("near", "g", LONG)
    assert result.outcome is Outcome.ABORTED
    assert len(lab.motions("near")) == 1


def test_a_result_that_is_lost_on_its_way_is_kept_and_asked_for_again(
    lab: Lab, cable: Link
) -> None:
    lab.agent("near")
    fleet = lab.orchestrator("near", connect=cable.endpoint)
    expected = GoalRunner(fleet).run("near", "g", SHORT)
    with ThreadPoolExecutor(1) as pool:
        for _ in range(3):
            cable.hold("down")
            before = cable.passed_bytes("up")
            answer = pool.submit(fleet.result, "near", "g")
            wait_until(lambda: cable.passed_bytes("up") > before)  # noqa: B023
            cable.cut()
            with pytest.raises(NoReplyError, match=r"robot near .* goal g"):
                answer.result(PATIENCE_S)
            cable.let_through()
            again = GoalRunner(fleet).run("near", "g", SHORT)
            assert again.response.tobytes() == expected.response.tobytes()
    assert len(lab.motions("near")) == 1


def test_a_slow_link_changes_no_result(lab: Lab, cable: Link) -> None:
    robots = tuple(SECTION_V)
    lab.agent("target")
    lab.agent("far")
    lab.agent("near", connect=cable.endpoint)
    plan = plan_of(robots, iterations=2)
    fleet = lab.orchestrator(*robots)
    quick = run_study(fleet, plan, "quick", Story())
    cable.delay(0.2)
    story = Story()
    slow = run_study(fleet, plan, "slow", story)
    assert ranking_of(slow) == ranking_of(quick)
    assert story.failed == []
