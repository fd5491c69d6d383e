"""An agent's decisions: over random histories, and with every thread at once."""

from __future__ import annotations

import threading
from collections import Counter

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from polling import PATIENCE_S
from puppet_robot import puppet_spec

from nufleet.robot_agent import planner as planner_module
from nufleet.robot_agent.decisions import Assignment, Decisions
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.journal.unrecorded import Unrecorded
from nufleet.robot_agent.motion.excitation import plan_excitation
from nufleet.robot_agent.planner import Planner
from nufleet.robot_agent.rules.ownership import Commander
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared.errors import RefusedError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.codec import MAX_BODY_BYTES, MAX_MESSAGE_BYTES
from nufleet.shared.wire.messages import (
    GoalAccepted,
    GoalRequest,
    GoalResult,
    Outcome,
    Refusal,
    RobotStatus,
)

OWNERS = ("o-1", "o-2")
EXCITATIONS = tuple(
    Excitation(axis=axis, tones=(Tone(omega_rad_s=20.0),), settle_s=0.0) for axis in ("x", "y")
)


def new_decisions(*, realtime: float | None = None, spec: RobotSpec | None = None) -> Decisions:
    planner = Planner("r", spec or puppet_spec(), (), Memory(None), realtime)
    return Decisions("boot", planner, Unrecorded(), threading.Event())


def goal(goal_id: str, owner: str = "o-1", content: int = 0) -> GoalRequest:
    return GoalRequest(goal_id=goal_id, owner=owner, motion=EXCITATIONS[content])


def taken(decisions: Decisions, request: GoalRequest) -> Assignment:
    answer, motion = decisions.take(request)
    assert isinstance(answer, GoalAccepted)
    assert motion is not None
    return motion


def refused(decisions: Decisions, request: GoalRequest) -> str:
    answer, motion = decisions.take(request)
    assert isinstance(answer, Refusal)
    assert motion is None
    return answer.code


def result_of(motion: Assignment) -> GoalResult:
    outcome, reason = motion.switch.order or (Outcome.COMPLETED, "")
    samples = motion.plan.samples if motion.switch.order is None else 3
    return GoalResult(
        goal_id=motion.goal.goal_id,
        boot_id="boot",
        outcome=outcome,
        reason=reason,
        plan=motion.plan,
        reference=np.zeros(samples),
        response=np.zeros(samples),
    )


class History(RuleBasedStateMachine):
    """Everything that can happen to an agent, in any order, beside a model of what must follow."""

    def __init__(self) -> None:
        super().__init__()
        self.decisions = new_decisions()
        self.alive: set[str] = set()
        self.stopped = self.shutting_down = False
        self.fault: str | None = None
        self.motion: Assignment | None = None
        self.contents: dict[str, int] = {}
        self.ended: dict[str, Outcome] = {}
        self.kept: set[str] = set()
        self.forgone: set[str] = set()
        self.motions: Counter[str] = Counter()

    @rule(owner=st.sampled_from(OWNERS))
    def owner_appears(self, owner: str) -> None:
        self.decisions.owner_appeared(owner)
        self.alive.add(owner)
        assert self.decisions.wait_for_owner(owner, timeout_s=0.0)

    @rule(owner=st.sampled_from(OWNERS))
    def owner_disappears(self, owner: str) -> None:
        self.decisions.owner_lost(owner)
        self.alive.discard(owner)
        assert not self.decisions.wait_for_owner(owner, timeout_s=0.0)
        if self.motion is not None and self.motion.goal.owner == owner:
            assert self.motion.switch.order is not None

    @rule(sender=st.sampled_from(["alice", "bob"]))
    def stop(self, sender: str) -> None:
        self.decisions.stop(StopOrder(sender, "smoke"))
        self.stopped = True
        if self.motion is not None:
            assert self.motion.switch.order is not None

    @rule()
    def release(self) -> None:
        refusal = self.decisions.release("alice")
        if self.motion is not None:
            assert refusal is not None
            assert refusal.code == "busy"
        else:
            assert refusal is None
            self.stopped = False

    @rule(
        goal_id=st.sampled_from(["a", "b", "c", "d"]),
        owner=st.sampled_from(OWNERS),
        content=st.sampled_from([0, 1]),
    )
    def submit(self, goal_id: str, owner: str, content: int) -> None:
        answer, motion = self.decisions.take(goal(goal_id, owner, content))
        expected = self.expected_answer(goal_id, owner, content)
        if expected is None:
            assert isinstance(answer, GoalAccepted)
        else:
            assert isinstance(answer, Refusal)
            assert answer.code == expected
        if expected is None and goal_id not in self.contents:
            assert goal_id not in self.forgone
            assert motion is not None
            assert motion.switch.order is None
            self.motion = motion
            self.contents[goal_id] = content
            self.motions[goal_id] += 1
        else:
            assert motion is None

    def expected_answer(self, goal_id: str, owner: str, content: int) -> str | None:
        if goal_id in self.contents:
            return None if self.contents[goal_id] == content else "goal-id-reused"
        if goal_id in self.forgone:
            return "cancelled"
        if self.shutting_down:
            return "shutting-down"
        if self.fault is not None:
            return "fault"
        if self.stopped:
            return "stopped"
        if owner not in self.alive:
            return "owner-not-alive"
        return None if self.motion is None else "busy"

    @rule(goal_id=st.sampled_from(["a", "b", "c", "d"]))
    def cancel(self, goal_id: str) -> None:
        refusal = self.decisions.cancel(goal_id, Commander("o-1"))
        if goal_id in self.ended:
            assert refusal is not None
            assert refusal.code == "goal-ended"
        else:
            assert refusal is None
        if goal_id not in self.contents:
            self.forgone.add(goal_id)
        elif self.motion is not None and self.motion.goal.goal_id == goal_id:
            assert self.motion.switch.order is not None

    @precondition(lambda self: self.motion is not None)
    @rule(fault=st.sampled_from([None, None, "the brake is stuck"]))
    def motion_ends(self, fault: str | None) -> None:
        assert self.motion is not None
        result = result_of(self.motion)
        self.decisions.resting()
        assert self.decisions.state().status is RobotStatus.RESTING
        self.decisions.ended(result, fault)
        self.motion = None
        self.fault = fault
        self.ended[result.goal_id] = result.outcome
        self.kept.add(result.goal_id)
        assert self.decisions.state().last_goal_id == result.goal_id

    @precondition(lambda self: self.fault is not None)
    @rule(fault=st.sampled_from([None, "no such port"]))
    def robot_is_connected_anew(self, fault: str | None) -> None:
        assert self.decisions.reconnected(fault, stops=self.decisions.stops) == fault
        self.fault = fault

    @rule(goal_ids=st.lists(st.sampled_from(["a", "b", "c", "d"]), max_size=3))
    def acknowledge(self, goal_ids: list[str]) -> None:
        self.decisions.acknowledge(goal_ids, Commander("o-1"))
        self.kept -= set(goal_ids)

    @rule()
    def shut_down(self) -> None:
        self.decisions.shut_down()
        self.shutting_down = True
        if self.motion is not None:
            assert self.motion.switch.order is not None

    @invariant()
    def a_goal_moves_once(self) -> None:
        assert max(self.motions.values(), default=0) <= 1

    @invariant()
    def the_published_state_is_true(self) -> None:
        state = self.decisions.state()
        if self.motion is not None:
            thrown = self.motion.switch.order is not None
            assert state.status is (RobotStatus.RESTING if thrown else RobotStatus.RUNNING)
            assert state.goal_id == self.motion.goal.goal_id
        else:
            assert state.goal_id is None
            if self.fault is not None:
                assert (state.status, state.reason) == (RobotStatus.FAULT, self.fault)
            elif self.stopped:
                assert state.status is RobotStatus.STOPPED
                assert "smoke" in state.reason
            else:
                assert state.status is RobotStatus.IDLE

    @invariant()
    def every_result_is_there_until_it_is_acknowledged(self) -> None:
        for goal_id in "abcd":
            answer = self.decisions.result(goal_id)
            if goal_id in self.kept:
                assert isinstance(answer, GoalResult)
                assert answer.outcome is self.ended[goal_id]
            else:
                assert isinstance(answer, Refusal)
                running = goal_id in self.contents and goal_id not in self.ended
                unknown = goal_id not in self.contents and goal_id not in self.forgone
                assert answer.code == (
                    "unknown-goal" if unknown else "not-finished" if running else "result-gone"
                )


History.TestCase.settings = settings(max_examples=60, stateful_step_count=40, deadline=None)
TestEveryHistory = History.TestCase


# What a history in one thread does not show.


def test_a_stop_between_acceptance_and_the_first_sample_is_not_missed() -> None:
    decisions = new_decisions()
    decisions.owner_appeared("o-1")
    motion = taken(decisions, goal("a"))
    decisions.stop(StopOrder("alice", "smoke"))
    assert motion.switch.order == (Outcome.ABORTED, "stopped by alice: smoke")


def test_a_stop_during_planning_does_not_wait_and_is_not_missed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    decisions = new_decisions()
    decisions.owner_appeared("o-1")
    planned = plan_excitation(EXCITATIONS[0], puppet_spec(), robot="r")

    def plan_slowly(*_: object, **__: object) -> object:
        stopping = threading.Thread(target=decisions.stop, args=(StopOrder("alice", "smoke"),))
        stopping.start()
        stopping.join(5.0)
        assert not stopping.is_alive()
        return planned

    monkeypatch.setattr(planner_module, "plan_excitation", plan_slowly)
    assert refused(decisions, goal("a")) == "stopped"


def test_an_owner_lost_during_planning_is_not_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    decisions = new_decisions()
    decisions.owner_appeared("o-1")
    planned = plan_excitation(EXCITATIONS[0], puppet_spec(), robot="r")

    def plan_slowly(*_: object, **__: object) -> object:
        decisions.owner_lost("o-1")
        return planned

    monkeypatch.setattr(planner_module, "plan_excitation", plan_slowly)
    assert refused(decisions, goal("a")) == "owner-not-alive"


def test_a_goal_waits_for_its_owners_token() -> None:
    decisions = new_decisions()
    threading.Timer(0.05, decisions.owner_appeared, ["o-1"]).start()
    assert decisions.wait_for_owner("o-1", timeout_s=PATIENCE_S)
    assert not decisions.wait_for_owner("o-2", timeout_s=0.01)


def test_a_goal_is_accepted_with_the_same_plan_every_time() -> None:
    decisions = new_decisions()
    decisions.owner_appeared("o-1")
    answers = [decisions.take(goal("a"))[0] for _ in range(5)]
    assert all(answer == answers[0] for answer in answers)


def test_another_owners_identical_goal_is_the_same_goal() -> None:
    decisions = new_decisions()
    decisions.owner_appeared("o-1")
    taken(decisions, goal("a", "o-1"))
    answer, motion = decisions.take(goal("a", "o-2"))
    assert isinstance(answer, GoalAccepted)
    assert motion is None


def test_a_goal_outside_the_limits_is_refused_and_not_remembered() -> None:
    decisions = new_decisions()
    decisions.owner_appeared("o-1")
    too_fast = Excitation(axis="x", tones=(Tone(omega_rad_s=60.0),))
    with pytest.raises(RefusedError):
        decisions.take(GoalRequest(goal_id="a", owner="o-1", motion=too_fast))
    taken(decisions, goal("a"))


def test_a_goal_whose_result_would_not_fit_into_a_message_is_refused(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert 8 * planner_module.MAX_RESULT_NUMBERS + MAX_BODY_BYTES < MAX_MESSAGE_BYTES
    decisions = new_decisions()
    decisions.owner_appeared("o-1")
    samples = plan_excitation(EXCITATIONS[0], puppet_spec(), robot="r").samples
    monkeypatch.setattr(planner_module, "MAX_RESULT_NUMBERS", 2 * samples - 1)
    with pytest.raises(RefusedError, match="samples; at most") as raised:
        decisions.take(goal("a"))
    assert raised.value.code == "duration"
    monkeypatch.setattr(planner_module, "MAX_RESULT_NUMBERS", 2 * samples)
    taken(decisions, goal("a"))


def test_a_goal_may_acknowledge_the_results_before_it() -> None:
    decisions = new_decisions()
    decisions.owner_appeared("o-1")
    decisions.ended(result_of(taken(decisions, goal("a"))), None)
    decisions.ended(result_of(taken(decisions, goal("b"))), None)
    decisions.take(goal("c").model_copy(update={"acknowledges": ("a",)}))
    assert isinstance(decisions.result("a"), Refusal)
    assert isinstance(decisions.result("b"), GoalResult)


@pytest.mark.parametrize(
    ("simulated", "realtime", "share"), [(True, None, 0.0), (True, 4.0, 0.25), (False, 4.0, 1.0)]
)
def test_an_accepted_goal_says_how_long_it_takes_on_the_wall_clock(
    simulated: bool, realtime: float | None, share: float
) -> None:
    decisions = new_decisions(realtime=realtime, spec=puppet_spec(simulated=simulated))
    decisions.owner_appeared("o-1")
    answer, _ = decisions.take(goal("a"))
    assert isinstance(answer, GoalAccepted)
    assert answer.wall_duration_s == pytest.approx(share * answer.plan.duration_s)


@pytest.mark.parametrize("different", [True, False])
def test_goals_from_many_threads_at_once_begin_one_motion(different: bool) -> None:
    for _ in range(20):
        decisions = new_decisions()
        decisions.owner_appeared("o-1")
        begin = threading.Barrier(6)
        motions: list[Assignment | None] = []

        def submit(
            k: int,
            decisions: Decisions = decisions,
            begin: threading.Barrier = begin,
            motions: list[Assignment | None] = motions,
        ) -> None:
            begin.wait(PATIENCE_S)
            motions.append(decisions.take(goal(f"g{k}" if different else "g"))[1])

        threads = [threading.Thread(target=submit, args=(k,)) for k in range(6)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join(PATIENCE_S)
        assert len(motions) == 6
        assert sum(motion is not None for motion in motions) == 1
