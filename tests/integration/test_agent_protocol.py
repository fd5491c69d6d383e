"""An agent and its orchestrators over a real router: work, its early end, and who commands it."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
import pytest
from fleet_lab import (
    KEYS,
    SLOW,
    Gate,
    Lab,
    Orchestrator,
    double_integrator,
    refusal,
    released,
    submitted,
)
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot, puppet_spec

from nufleet.robot_agent.agent import Agent
from nufleet.robot_agent.motion.excitation import reference_of
from nufleet.shared.errors import RefusedError, RobotLostError
from nufleet.shared.frequency_test.excitation import Tone
from nufleet.shared.wire.codec import encode
from nufleet.shared.wire.messages import (
    DescribeRequest,
    GoalAccepted,
    Outcome,
    RobotState,
    RobotStatus,
    Telemetry,
)
from nufleet.shared.wire.transport import open_client

# Work.


def test_a_goal_is_accepted_run_fetched_and_acknowledged(running_fleet: Orchestrator) -> None:
    fleet = running_fleet.fleet
    states: list[float] = []
    fleet.observe_states(lambda state: states.append(state.progress))
    for k, alpha in enumerate((0.85, 1.0, 0.97)):
        accepted = running_fleet.submit(f"r{k}", "run-1.0.r_x.1")
        result = running_fleet.result(f"r{k}", "run-1.0.r_x.1")
        assert result.outcome is Outcome.COMPLETED
        assert result.boot_id == accepted.boot_id == fleet.describe(f"r{k}").boot_id
        assert result.plan == accepted.plan
        reference = reference_of(accepted.plan)
        np.testing.assert_array_equal(result.reference, reference)
        twin = double_integrator(alpha, seed=k)
        twin.connect()
        np.testing.assert_array_equal(result.response, twin.run(reference[:, None])[:, 0])
        assert fleet.result(f"r{k}", "run-1.0.r_x.1").outcome is Outcome.COMPLETED
        fleet.acknowledge(f"r{k}", ("run-1.0.r_x.1",))
        assert refusal(lambda k=k: fleet.result(f"r{k}", "run-1.0.r_x.1")) == "result-gone"  # type: ignore[misc]
        state = running_fleet.state(f"r{k}", lambda s: s.status is RobotStatus.IDLE)
        assert state.progress == 1.0
        assert state.robot_time_s == pytest.approx(accepted.plan.duration_s)
    assert all(0 <= progress <= 1 for progress in states)


def test_progress_and_samples_arrive_while_a_motion_runs(lab: Lab) -> None:
    robot = PuppetRobot(puppet_spec(sample_time_s=0.005))
    lab.agent("a", robot, realtime=10.0)
    orchestrator = lab.orchestrator()
    batches: list[Telemetry] = []
    orchestrator.fleet.observe_telemetry(lambda _robot, batch: batches.append(batch))
    states: list[RobotState] = []
    orchestrator.fleet.observe_states(states.append)
    accepted = orchestrator.submit("a", "g", settle_s=15.0)
    assert accepted.wall_duration_s == pytest.approx(accepted.plan.duration_s / 10.0)
    result = orchestrator.result("a", "g")
    running = [state for state in states if state.status is RobotStatus.RUNNING]
    assert {(state.goal_id, state.last_goal_id) for state in running} == {("g", None)}
    assert any(0 < state.progress < 1 for state in running)
    wait_until(lambda: sum(len(b.reference) for b in batches) == len(result.reference))
    np.testing.assert_array_equal(np.concatenate([b.reference for b in batches]), result.reference)
    np.testing.assert_array_equal(np.concatenate([b.response for b in batches]), result.response)
    assert len(batches) > 2
    assert {batch.goal_id for batch in batches} == {"g"}


def test_the_same_goal_sent_a_hundred_times_moves_the_robot_once(lab: Lab) -> None:
    robot = PuppetRobot()
    gate = Gate(robot)
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    answers: list[GoalAccepted] = []

    def submit(times: int) -> None:
        for _ in range(times):
            answers.append(orchestrator.submit("a", "g"))  # noqa: PERF401

    senders = [threading.Thread(target=submit, args=(15,)) for _ in range(4)]
    for sender in senders:
        sender.start()
    for sender in senders:
        sender.join(PATIENCE_S)
    gate.opened.set()
    result = orchestrator.result("a", "g")
    submit(20)
    orchestrator.fleet.acknowledge("a", ("g",))
    submit(20)
    assert len(answers) == 100
    assert all(answer == answers[0] for answer in answers)
    assert robot.motions == 1
    assert result.outcome is Outcome.COMPLETED
    assert orchestrator.run("a", "g2").outcome is Outcome.COMPLETED
    assert robot.motions == 2


def test_the_same_id_with_another_content_is_refused(lab: Lab) -> None:
    robot = PuppetRobot()
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    orchestrator.run("a", "g")
    assert refusal(lambda: orchestrator.submit("a", "g", axis="y")) == "goal-id-reused"
    assert robot.motions == 1


def test_a_busy_robot_refuses_another_goal_and_says_whose_it_runs(lab: Lab) -> None:
    robot = PuppetRobot()
    gate = Gate(robot)
    lab.agent("a", robot)
    first, second = lab.orchestrator("orchestrator-1"), lab.orchestrator("orchestrator-2")
    first.submit("a", "g1")
    assert gate.reached.wait(PATIENCE_S)
    with pytest.raises(RefusedError, match="running goal g1 of orchestrator-1") as raised:
        second.submit("a", "g2")
    assert raised.value.code == "busy"
    assert refusal(lambda: second.fleet.result("a", "g1")) == "not-finished"
    assert refusal(lambda: second.fleet.result("a", "g2")) == "unknown-goal"
    gate.opened.set()
    first.result("a", "g1")
    assert second.run("a", "g2").outcome is Outcome.COMPLETED


def test_a_goal_outside_the_limits_is_refused_before_anything_moves(lab: Lab) -> None:
    robot = PuppetRobot()
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    for code, excitation in (
        ("amplitude", {"amplitude": 1.01}),
        ("unknown-axis", {"axis": "yaw"}),
        ("omega-out-of-band", {"tones": (Tone(omega_rad_s=60.0),)}),
        ("duration", {"settle_s": 1e6}),
    ):
        assert refusal(lambda e=excitation: orchestrator.submit("a", "g", **e)) == code  # type: ignore[misc]
    assert robot.motions == 0
    assert orchestrator.run("a", "g").outcome is Outcome.COMPLETED


def test_acknowledgements_come_with_the_next_goal(lab: Lab) -> None:
    lab.agent("a", PuppetRobot())
    orchestrator = lab.orchestrator()
    orchestrator.run("a", "g1")
    request = orchestrator.request("g2").model_copy(update={"acknowledges": ("g1",)})
    submitted(orchestrator.fleet, "a", request)
    assert refusal(lambda: orchestrator.fleet.result("a", "g1")) == "result-gone"
    assert orchestrator.result("a", "g2").outcome is Outcome.COMPLETED


# Ending early.


def test_a_cancel_ends_a_motion_in_real_time_at_once_and_at_rest(lab: Lab) -> None:
    robot = PuppetRobot()
    lab.agent("a", robot, realtime=1.0)
    orchestrator = lab.orchestrator()
    for k in range(3):
        orchestrator.submit("a", f"g{k}", **SLOW)
        orchestrator.state("a", lambda s, k=k: s.goal_id == f"g{k}")  # type: ignore[misc]
        wait_until(lambda: not robot.at_rest)
        orchestrator.fleet.cancel("a", f"g{k}")
        played = robot.samples
        result = orchestrator.result("a", f"g{k}")
        # The answer may come while one sample is being played, and no other is played after it.
        assert robot.samples <= played + 1
        assert robot.at_rest
        assert (result.outcome, result.reason) == (Outcome.CANCELLED, "cancelled")
        assert len(result.response) < result.plan.samples
    assert refusal(lambda: orchestrator.fleet.cancel("a", "g0")) == "goal-ended"


def test_a_goal_that_was_cancelled_before_it_came_moves_nothing_when_it_does(lab: Lab) -> None:
    robot = PuppetRobot()
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    for _ in range(2):
        orchestrator.fleet.cancel("a", "g1")
    assert refusal(lambda: orchestrator.submit("a", "g1")) == "cancelled"
    assert refusal(lambda: orchestrator.fleet.result("a", "g1")) == "result-gone"
    assert orchestrator.run("a", "g2").outcome is Outcome.COMPLETED
    assert robot.motions == 1


def test_a_stop_is_latched_until_a_release(lab: Lab) -> None:
    robot = PuppetRobot()
    lab.agent("a", robot, realtime=1.0)
    orchestrator = lab.orchestrator()
    fleet = orchestrator.fleet
    orchestrator.submit("a", "g1", **SLOW)
    wait_until(lambda: not robot.at_rest)
    fleet.stop("a", "smoke")
    result = orchestrator.result("a", "g1")
    assert result.outcome is Outcome.ABORTED
    assert result.reason == "stopped by orchestrator-1: smoke"
    assert robot.at_rest
    fleet.stop("a", "a second stop")
    state = orchestrator.state("a", lambda s: s.status is RobotStatus.STOPPED)
    assert state.reason == "stopped by orchestrator-1: smoke"
    assert refusal(lambda: orchestrator.submit("a", "g2")) == "stopped"
    assert robot.motions == 1
    released(fleet, "a")
    orchestrator.state("a", lambda s: s.status is RobotStatus.IDLE and s.reason == "")
    orchestrator.submit("a", "g2", **SLOW)
    fleet.cancel("a", "g2")
    assert orchestrator.result("a", "g2").outcome is Outcome.CANCELLED


def test_one_stop_reaches_every_robot_whoever_commands_it(lab: Lab) -> None:
    robots = {name: PuppetRobot() for name in ("a", "b", "c")}
    for name, robot in robots.items():
        lab.agent(name, robot, realtime=1.0)
    owner, bystander = lab.orchestrator("owner"), lab.orchestrator("bystander")
    for name in ("a", "b"):
        owner.submit(name, "g", **SLOW)
    bystander.fleet.stop_everyone("fire")
    for name, robot in robots.items():
        state = bystander.state(name, lambda s: s.status is RobotStatus.STOPPED)
        assert state.reason == "stopped by bystander: fire"
        assert robot.at_rest
    for name in ("a", "b"):
        assert owner.result(name, "g").outcome is Outcome.ABORTED


def test_a_robot_that_comes_to_rest_says_so_and_stays_stoppable(lab: Lab) -> None:
    robot = PuppetRobot()
    at_rest = threading.Event()

    def on_rest() -> None:
        assert at_rest.wait(PATIENCE_S)

    robot.on_rest = on_rest
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    orchestrator.submit("a", "g1")
    state = orchestrator.state("a", lambda s: s.status is RobotStatus.RESTING)
    assert (state.goal_id, state.progress) == ("g1", 1.0)
    assert refusal(lambda: orchestrator.submit("a", "g2")) == "busy"
    orchestrator.fleet.stop("a", "while it rests")
    orchestrator.state("a", lambda s: s.status is RobotStatus.RESTING and "while" in s.reason)
    assert refusal(lambda: orchestrator.fleet.release("a")) == "busy"
    at_rest.set()
    orchestrator.state("a", lambda s: s.status is RobotStatus.STOPPED)
    # All of it had been measured before the stop.
    assert orchestrator.fleet.result("a", "g1").outcome is Outcome.COMPLETED
    released(orchestrator.fleet, "a")
    assert orchestrator.run("a", "g2").outcome is Outcome.COMPLETED


def test_a_stop_is_answered_while_other_requests_wait_and_the_rest_are_turned_away(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, planned = threading.Event(), threading.Event()

    def plan_for_ever(*_: object, **__: object) -> None:
        begun.set()
        assert planned.wait(PATIENCE_S)
        raise RefusedError("too-slow", "planning took too long", "a")

    monkeypatch.setattr("nufleet.robot_agent.planner.plan_excitation", plan_for_ever)
    lab.agent("a", PuppetRobot())
    orchestrator = lab.orchestrator()
    codes: list[str] = []

    def send(call: Callable[[], object]) -> threading.Thread:
        thread = threading.Thread(target=lambda: codes.append(refusal(call)))
        thread.start()
        return thread

    senders = [send(lambda: orchestrator.submit("a", "g"))]
    assert begun.wait(PATIENCE_S)
    senders += [send(lambda: orchestrator.fleet.result("a", "g")) for _ in range(70)]
    wait_until(lambda: codes.count("overloaded") == 6)
    orchestrator.fleet.stop("a", "smoke")
    orchestrator.state("a", lambda s: s.status is RobotStatus.STOPPED)
    planned.set()
    for sender in senders:
        sender.join(PATIENCE_S)
    assert (codes.count("unknown-goal"), codes.count("too-slow")) == (64, 1)


# Owners.


def test_a_motion_ends_when_its_owner_is_gone_and_the_robot_is_free_again(lab: Lab) -> None:
    robot = PuppetRobot()
    lab.agent("a", robot, realtime=1.0)
    owner, other = lab.orchestrator("owner"), lab.orchestrator("other")
    owner.submit("a", "g1", **SLOW)
    wait_until(lambda: not robot.at_rest)
    owner.session.close()
    result = other.result("a", "g1")
    assert robot.at_rest
    assert (result.outcome, result.reason) == (Outcome.ABORTED, "its owner owner is gone")
    other.submit("a", "g2", **SLOW)
    other.fleet.cancel("a", "g2")
    assert other.result("a", "g2").outcome is Outcome.CANCELLED


def test_the_end_of_another_orchestrator_disturbs_nobody(lab: Lab) -> None:
    robot = PuppetRobot()
    gate = Gate(robot, at_sample=100)
    lab.agent("a", robot)
    owner, other = lab.orchestrator("owner"), lab.orchestrator("other")
    owner.submit("a", "g")
    assert gate.reached.wait(PATIENCE_S)
    other.session.close()
    wait_until(
        lambda: (
            owner.session.alive(KEYS.every_orchestrator_alive, timeout_s=PATIENCE_S)
            == [KEYS.orchestrator_alive("owner")]
        )
    )
    gate.opened.set()
    assert owner.result("a", "g").outcome is Outcome.COMPLETED


def test_a_goal_of_an_owner_nobody_could_miss_is_refused(lab: Lab) -> None:
    robot = PuppetRobot()
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    request = orchestrator.request("g").model_copy(update={"owner": "orchestrator-1.ghost"})
    assert refusal(lambda: orchestrator.fleet.submit("a", request)) == "owner-not-alive"
    assert robot.motions == 0
    orchestrator.session.declare_alive(KEYS.orchestrator_alive("orchestrator-1.ghost"))
    assert submitted(orchestrator.fleet, "a", request).goal_id == "g"
    orchestrator.result("a", "g")


def test_an_owner_may_submit_as_soon_as_it_is_there(lab: Lab) -> None:
    lab.agent("a", PuppetRobot())
    for k in range(10):
        newcomer = lab.orchestrator(f"orchestrator-{k}")
        assert newcomer.run("a", f"g{k}").outcome is Outcome.COMPLETED
        newcomer.session.close()


def test_two_agents_under_one_name_are_found_by_whoever_asks(lab: Lab) -> None:
    lab.agent("a", PuppetRobot())
    with open_client(lab.endpoint, timeout_s=PATIENCE_S) as session:
        orchestrator = lab.orchestrator()
        assert orchestrator.fleet.describe("a").robot == "a"
        with Agent(session, KEYS, "a", PuppetRobot(), realtime=None):
            wait_until(lambda: _answers(orchestrator) == 2)
            with pytest.raises(RobotLostError, match="2 agents answer as a"):
                orchestrator.fleet.describe("a")
            with pytest.raises(RobotLostError, match="2 agents answer as a"):
                orchestrator.submit("a", "g")
        assert orchestrator.fleet.describe("a").robot == "a"


def _answers(orchestrator: Orchestrator) -> int:
    key = KEYS.robot("a", "describe")
    replies = orchestrator.session.ask_all(key, encode(DescribeRequest()), timeout_s=PATIENCE_S)
    return len(replies)
