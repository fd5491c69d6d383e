"""Rounds of tests on real agents over a real router: parallel, repeated, interrupted."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest
from fleet_lab import submitted
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot
from round_lab import KEYS, ROBOTS, STUDY, TEST, Lab, agent_of, start_lab

from nufleet.orchestrator.conduct.attempts import ATTEMPTS, Attempts
from nufleet.orchestrator.conduct.dispatcher import Dispatcher
from nufleet.orchestrator.conduct.replay import OpenTest
from nufleet.orchestrator.conduct.trial_log import TrialLog
from nufleet.orchestrator.fleet import goal_loop
from nufleet.orchestrator.fleet.goal_events import Ended
from nufleet.orchestrator.fleet.goal_runner import GoalRunner, Interrupted
from nufleet.orchestrator.repository.errors import RepositoryError, StaleEpochError
from nufleet.orchestrator.repository.records import TrialStatus
from nufleet.orchestrator.study.outcomes import Failed, Measured
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.keys import principal_of
from nufleet.shared.wire.messages import GoalRequest
from nufleet.shared.wire.requests import Replies, Request


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with ExitStack() as stack:
        yield start_lab(stack, tmp_path, realtime=None)


@pytest.fixture
def slow_lab(tmp_path: Path) -> Iterator[Lab]:
    with ExitStack() as stack:
        yield start_lab(stack, tmp_path, realtime=1.0)


def test_a_round_measures_every_robot_once_and_asks_it_for_a_goal_and_a_result(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: set[str] = set()
    waited: list[str] = []
    ask = lab.client.ask

    def noting(key: str, payload: bytes, *, timeout_s: float) -> Replies:
        asked.add(key)  # a set: on a busy machine, one may be asked again
        return ask(key, payload, timeout_s=timeout_s)

    monkeypatch.setattr(lab.client, "ask", noting)
    monkeypatch.setattr(lab.client, "ask_all", lambda key, *_, **__: waited.append(key))
    outcomes = lab.run(r1=TEST, r2=TEST, r3=TEST)
    by = principal_of(lab.fleet.orchestrator_id)
    assert asked == {KEYS.request(r, by, leaf) for r in ROBOTS for leaf in ("goal", "result")}
    assert not waited  # no thread waits for a reply
    assert set(outcomes) == set(ROBOTS)
    for outcome in outcomes.values():
        assert isinstance(outcome, Measured)
        assert outcome.response.z[0] == pytest.approx(1.0, abs=1e-9)
        assert outcome.robot_time_s == pytest.approx(outcome.result.plan.duration_s)
    assert [robot.motions for robot in lab.robots.values()] == [1, 1, 1]
    assert not lab.attempts


def test_what_is_altered_on_its_way_is_asked_for_again_and_moves_its_robot_once(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    altered: set[str] = set()
    ask, answer = lab.client.ask, Request.answer

    def once(key: str, payload: bytes) -> bytes:
        if key in altered:
            return payload
        altered.add(key)
        place = len(payload) // 2
        return payload[:place] + bytes([payload[place] ^ 1]) + payload[place + 1 :]

    def asking(key: str, payload: bytes, *, timeout_s: float) -> Replies:
        payload = once(key, payload) if key.endswith("/goal") else payload
        return ask(key, payload, timeout_s=timeout_s)

    def answering(request: Request, payload: bytes) -> None:
        key = request.key
        answer(request, once(key, payload) if key.endswith("/result") else payload)

    monkeypatch.setattr(lab.client, "ask", asking)
    monkeypatch.setattr(Request, "answer", answering)
    outcomes = lab.run(r1=TEST, r2=TEST)
    by = principal_of(lab.fleet.orchestrator_id)
    assert altered == {
        KEYS.request(r, by, leaf) for r in ("r1", "r2") for leaf in ("goal", "result")
    }
    for outcome in outcomes.values():
        assert isinstance(outcome, Measured)
        assert outcome.response.z[0] == pytest.approx(1.0, abs=1e-9)
    assert [lab.robots[name].motions for name in ("r1", "r2")] == [1, 1]
    assert not lab.attempts


class Held:
    """The replies to one query, which do not arrive before they are let go."""

    def __init__(self, replies: Replies, let_go: threading.Event) -> None:
        self._replies, self._let_go = replies, let_go

    def over(self) -> bool:
        return self._let_go.is_set() and self._replies.over()

    def all(self) -> list[bytes]:
        return self._replies.all()


def test_robots_are_asked_only_as_fast_as_they_answer(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(goal_loop, "ASKING_AT_ONCE", 1)
    monkeypatch.setattr(goal_loop, "SLOW_S", PATIENCE_S)
    open_at_once: list[int] = []
    asked: list[Replies] = []
    ask = lab.client.ask

    def noting(key: str, payload: bytes, *, timeout_s: float) -> Replies:
        open_at_once.append(sum(not replies.over() for replies in asked))
        asked.append(ask(key, payload, timeout_s=timeout_s))
        return asked[-1]

    monkeypatch.setattr(lab.client, "ask", noting)
    outcomes = lab.run(r1=TEST, r2=TEST, r3=TEST)
    assert all(isinstance(outcome, Measured) for outcome in outcomes.values())
    assert max(open_at_once) == 0


def test_a_robot_that_does_not_answer_holds_up_no_other(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(goal_loop, "ASKING_AT_ONCE", 1)
    others_moved, in_time = threading.Event(), []
    ask = lab.client.ask

    def holding(key: str, payload: bytes, *, timeout_s: float) -> Replies | Held:
        replies = ask(key, payload, timeout_s=timeout_s)
        return Held(replies, others_moved) if key.startswith(KEYS.robot("r1", "")) else replies

    monkeypatch.setattr(lab.client, "ask", holding)

    def await_others() -> None:
        for name in ("r2", "r3"):
            moved = lab.fleet.watch(name).wait_until(
                lambda w: w.state is not None and w.state.last_goal_id is not None,
                timeout_s=PATIENCE_S,
            )
            in_time.append(moved)
        others_moved.set()

    waiting = threading.Thread(target=await_others)
    waiting.start()
    outcomes = lab.run(r1=TEST, r2=TEST, r3=TEST)
    waiting.join()
    assert in_time == [True, True]
    assert all(isinstance(outcome, Measured) for outcome in outcomes.values())
    assert [lab.robots[name].motions for name in ("r1", "r2", "r3")] == [1, 1, 1]


def test_a_goal_that_waits_to_be_sent_is_not_sent_after_an_interrupt(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(goal_loop, "ASKING_AT_ONCE", 1)
    monkeypatch.setattr(goal_loop, "SLOW_S", PATIENCE_S)
    let_go = threading.Event()
    asked: list[str] = []
    ask, ask_all = lab.client.ask, lab.client.ask_all
    by = principal_of(lab.fleet.orchestrator_id)
    dispatcher = lab.dispatcher()

    def cancelling(key: str, payload: bytes, *, timeout_s: float) -> list[bytes]:
        let_go.set()
        return ask_all(key, payload, timeout_s=timeout_s)

    def holding(key: str, payload: bytes, *, timeout_s: float) -> Replies | Held:
        asked.append(key)
        replies = ask(key, payload, timeout_s=timeout_s)
        if key != KEYS.request("r1", by, "goal"):
            return replies
        dispatcher.interrupt()
        return Held(replies, let_go)

    monkeypatch.setattr(lab.client, "ask", holding)
    monkeypatch.setattr(lab.client, "ask_all", cancelling)
    with pytest.raises(Interrupted):
        dispatcher.run(lab.open_tests(r1=TEST, r2=TEST, r3=TEST))
    assert KEYS.request("r1", by, "goal") in asked
    assert not {KEYS.request(name, by, "goal") for name in ("r2", "r3")} & set(asked)
    assert [lab.robots[name].motions for name in ("r2", "r3")] == [0, 0]


def test_a_test_whose_end_was_not_stored_is_sent_again_and_moves_its_robot_once(lab: Lab) -> None:
    log = lab.log()

    def fails(*_: object) -> None:
        raise RepositoryError("no room is left")

    log.ended = fails  # type: ignore[method-assign]
    with pytest.raises(RepositoryError, match="no room"):
        Dispatcher(lab.fleet, log, lab.specs, on_attempt_failed=lambda *a: None).run(
            lab.open_tests(r1=TEST)
        )
    assert lab.trials() == [("run-1.1.r1.1", TrialStatus.ACCEPTED)]
    assert isinstance(lab.run(r1=TEST)["r1"], Measured)
    assert lab.trials() == [("run-1.1.r1.1", TrialStatus.MEASURED)]
    assert lab.robots["r1"].motions == 1


def test_robots_of_a_round_move_at_the_same_time(slow_lab: Lab) -> None:
    together = threading.Barrier(len(ROBOTS), timeout=PATIENCE_S)
    for robot in slow_lab.robots.values():
        robot.on_sample = lambda k: together.wait() if k == 5 else None  # type: ignore[assignment, return-value]
    outcomes = slow_lab.run(r1=TEST, r2=TEST, r3=TEST)
    assert all(isinstance(outcome, Measured) for outcome in outcomes.values())


def test_an_unusable_test_is_repeated_with_more_time(lab: Lab) -> None:
    robot = lab.robots["r1"]
    batches: list[int] = []

    def broken_first_time(references: FloatArray) -> FloatArray:
        batches.append(len(references))
        return np.zeros_like(references) if robot.motions == 1 else references.copy()

    robot.measure = broken_first_time
    outcome = lab.run(r1=TEST)["r1"]
    assert isinstance(outcome, Measured)
    assert outcome.attempts == 2
    assert outcome.robot_time_s > outcome.result.plan.duration_s
    ((name, attempt, reason),) = lab.attempts
    assert (name, attempt) == ("r1", 1)
    assert reason


def test_a_robot_that_keeps_failing_is_given_up_with_the_reason(lab: Lab) -> None:
    def broken(references: FloatArray) -> FloatArray:
        raise RobotError("the motor driver reports overheating")

    lab.robots["r2"].measure = broken
    outcomes = lab.run(r1=TEST, r2=TEST, r3=TEST)
    failed = outcomes["r2"]
    assert isinstance(failed, Failed)
    assert "overheating" in failed.reason
    assert failed.attempts <= ATTEMPTS
    assert isinstance(outcomes["r1"], Measured)
    assert isinstance(outcomes["r3"], Measured)


def test_a_refusal_is_not_asked_again(lab: Lab) -> None:
    too_fast = Excitation(axis="x", tones=(Tone(omega_rad_s=49.0),), amplitude=100.0)
    outcome = lab.run(r1=too_fast)["r1"]
    assert isinstance(outcome, Failed)
    assert outcome.attempts == 1
    assert "amplitude" in outcome.reason
    assert lab.robots["r1"].motions == 0


def test_an_interrupted_round_leaves_every_robot_at_rest(slow_lab: Lab) -> None:
    long_test = Excitation(axis="x", tones=(Tone(omega_rad_s=0.5),))
    dispatcher = slow_lab.dispatcher()
    threading.Thread(
        target=lambda: (
            slow_lab.fleet.watch("r1").wait_until(
                lambda w: w.state is not None and w.state.progress > 0, timeout_s=PATIENCE_S
            ),
            dispatcher.interrupt(),
        )
    ).start()
    with pytest.raises(Interrupted):
        dispatcher.run(slow_lab.open_tests(r1=long_test, r2=long_test, r3=long_test))
    for name in ROBOTS:
        watch = slow_lab.fleet.watch(name)
        assert watch.wait_until(
            lambda w: w.state is not None and w.state.goal_id is None, timeout_s=PATIENCE_S
        )
        assert slow_lab.robots[name].at_rest
    # It continues with another attempt: Ctrl-C is not a failure of the robots.
    assert [t.interrupted for t in slow_lab.studies.trials(STUDY)] == [True, True, True]
    following = slow_lab.open_tests(r1=long_test, r2=long_test, r3=long_test)
    assert [(t.attempt, t.failures) for t in following] == [(2, 0)] * 3


def test_a_robot_that_comes_back_after_its_agent_died_is_tested_again(lab: Lab) -> None:
    began = threading.Event()
    agents: list[ExitStack] = []

    def start(robot: PuppetRobot) -> None:
        stack = ExitStack()
        stack.enter_context(agent_of(lab.endpoint, "r9", robot, realtime=1.0))
        agents.append(stack)

    first, second = PuppetRobot(), PuppetRobot()
    first.on_sample = lambda k: began.set()
    start(first)
    lab.fleet.wait_for(("r9",), timeout_s=PATIENCE_S)

    def kill_and_restart() -> None:
        began.wait(PATIENCE_S)
        agents.pop().close()
        start(second)

    replacement = threading.Thread(target=kill_and_restart)
    replacement.start()
    try:
        outcome = lab.run(r9=TEST)["r9"]
        replacement.join()
    finally:
        for stack in agents:
            stack.close()
    assert isinstance(outcome, Measured)
    assert outcome.attempts == 2
    assert (first.motions, second.motions) == (1, 1)


def test_an_intent_is_stored_before_a_robot_moves_and_what_comes_of_it_after(lab: Lab) -> None:
    seen: list[list[tuple[str, TrialStatus]]] = []
    lab.robots["r1"].on_sample = lambda k: seen.append(lab.trials()) if k == 0 else None
    lab.run(r1=TEST)
    ((goal_id, status),) = seen[0]
    assert goal_id == "run-1.1.r1.1"
    assert status in (TrialStatus.INTENDED, TrialStatus.ACCEPTED)
    (trial,) = lab.studies.trials(STUDY)
    assert trial.status is TrialStatus.MEASURED
    assert trial.boot_id == lab.fleet.describe("r1").boot_id
    assert len(lab.studies.result(goal_id).response) == lab.robots["r1"].samples


def test_every_attempt_is_stored_with_what_follows_on_it(lab: Lab) -> None:
    robot = lab.robots["r1"]
    noise = np.random.default_rng(0)

    def measured(reference: FloatArray) -> FloatArray:
        """Follow, or twice nothing but noise."""
        if robot.motions >= 3:
            return reference.copy()
        return np.where(reference == 0, 0.0, noise.normal(0.0, 0.3, reference.shape))

    robot.measure = measured
    lab.run(r1=TEST)
    first, second, third = lab.studies.trials(STUDY)
    assert [t.status for t in (first, second)] == [TrialStatus.FAILED] * 2
    assert third.status is TrialStatus.MEASURED
    assert (first.retry, second.retry) == (second.intent.excitation, third.intent.excitation)
    assert first.response is not None
    assert not first.response.quality.usable


def test_nothing_moves_when_nothing_can_be_stored(lab: Lab) -> None:
    later = TrialLog(lab.studies, STUDY, dict.fromkeys(ROBOTS, 5))
    later.intend(lab.open_tests(r1=TEST))
    with pytest.raises(StaleEpochError):
        lab.run(r1=TEST, r2=TEST)
    assert [robot.motions for robot in lab.robots.values()] == [0, 0, 0]


def test_every_robot_comes_to_rest_when_one_acceptance_cannot_be_stored(slow_lab: Lab) -> None:
    lab, moving = slow_lab, threading.Event()
    lab.robots["r2"].on_sample = lambda k: moving.set()
    log = lab.log()

    def fails(test: OpenTest, accepted: object) -> None:
        if test.robot == "r1":
            assert moving.wait(PATIENCE_S)
            raise RepositoryError("no room is left")

    log.accepted = fails  # type: ignore[method-assign]
    dispatcher = Dispatcher(lab.fleet, log, lab.specs, on_attempt_failed=lambda *a: None)
    long_test = Excitation(axis="x", tones=(Tone(omega_rad_s=0.5),))
    with pytest.raises(RepositoryError, match="no room"):
        dispatcher.run(lab.open_tests(r1=long_test, r2=long_test))
    wait_until(lambda: all(robot.at_rest for robot in lab.robots.values()))


def test_what_a_robot_finished_while_nobody_was_there_is_fetched_not_flown_again(
    lab: Lab,
) -> None:
    tests = lab.open_tests(r1=TEST)
    lab.log().intend(tests)
    done = lab.dispatcher()._goals.run("r1", tests[0].goal_id, TEST)
    lab.next_orchestrator()
    outcome = lab.run(r1=TEST)["r1"]
    assert isinstance(outcome, Measured)
    assert outcome.result.response.tobytes() == done.response.tobytes()
    assert lab.robots["r1"].motions == 1
    assert lab.trials() == [("run-1.1.r1.1", TrialStatus.MEASURED)]


def test_a_motion_that_ended_with_its_orchestrator_is_repeated_and_no_failure(
    slow_lab: Lab,
) -> None:
    lab, moving = slow_lab, threading.Event()
    robot = lab.robots["r1"]
    robot.on_sample = lambda k: moving.set()
    for life in range(ATTEMPTS + 1):
        moving.clear()
        (test,) = lab.open_tests(r1=TEST)
        lab.log().intend([test])
        if test.record is not None:
            # What this orchestrator finds when it begins: the motion of the one before, ended.
            result = GoalRunner(lab.fleet).run("r1", test.goal_id, test.excitation)
            attempts = Attempts(lab.log(), lab.specs)
            settled = attempts.settle(test, Ended(result=result), interrupted=False)
            assert settled.outcome is None
            (test,) = lab.open_tests(r1=TEST)
            lab.log().intend([test])
        request = GoalRequest(
            goal_id=test.goal_id, owner=lab.fleet.orchestrator_id, motion=test.excitation
        )
        lab.log().accepted(test, submitted(lab.fleet, "r1", request))
        assert moving.wait(PATIENCE_S)
        lab.next_orchestrator(f"orchestrator-{life}")
    outcome = lab.run(r1=TEST)["r1"]
    assert isinstance(outcome, Measured)
    assert outcome.attempts == ATTEMPTS + 2
    trials = lab.studies.trials(STUDY)
    assert [t.interrupted for t in trials] == [*[True] * (ATTEMPTS + 1), False]
    assert robot.motions == len(trials)


def test_a_goal_whose_agent_was_replaced_is_lost_and_sent_again_under_a_new_id(lab: Lab) -> None:
    (test,) = lab.open_tests(r1=TEST)
    lab.log().intend([test])
    request = GoalRequest(goal_id=test.goal_id, owner="orchestrator-test", motion=TEST)
    accepted = submitted(lab.fleet, "r1", request)
    lab.log().accepted(test, accepted.model_copy(update={"boot_id": "another"}))
    lab.fleet.watch("r1").wait_until(
        lambda w: w.state is not None and w.state.last_goal_id == test.goal_id,
        timeout_s=PATIENCE_S,
    )
    lab.fleet.acknowledge("r1", (test.goal_id,))
    outcome = lab.run(r1=TEST)["r1"]
    assert isinstance(outcome, Measured)
    first, second = lab.studies.trials(STUDY)
    assert (first.status, first.interrupted) == (TrialStatus.LOST, True)
    assert "restarted" in first.reason
    assert (second.intent.attempt, second.status) == (2, TrialStatus.MEASURED)
