"""What the thread that moves a robot makes of drivers that hang, and of stops as it reconnects."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from agent_lives import EXCITATION
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot, puppet_spec

from nufleet.robot_agent.decisions import Decisions
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.journal.unrecorded import Unrecorded
from nufleet.robot_agent.motion import watched_robot
from nufleet.robot_agent.motion.watched_robot import SLOW_CALL_MAX_S, WatchedRobot
from nufleet.robot_agent.motion_worker import MotionWorker
from nufleet.robot_agent.planner import Planner
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared.wire.messages import Done, GoalRequest, GoalResult, Outcome, Refusal


class Clock:
    now_s = 100.0


class Hanging:
    """A worker whose driver stays in one call, on a clock that is set, until it is let go."""

    def __init__(self, clock: Clock, *, simulated: bool = True, idle_s: float = 0.01) -> None:
        self.clock = clock
        self.inside, self.let_go = threading.Event(), threading.Event()
        self.puppet = PuppetRobot(
            puppet_spec(simulated=simulated).model_copy(update={"idle_s": idle_s})
        )
        robot = WatchedRobot(self.puppet, realtime=None)
        memory = Memory(None)
        planner = Planner("a", self.puppet.spec, (), memory, None)
        self.decisions = Decisions("boot", planner, Unrecorded(), threading.Event())
        self.decisions.owner_appeared("o")
        robot.connect()
        self.unfit: str | None = None
        self.clerks = ThreadPoolExecutor(1)
        self.worker = MotionWorker(
            *("a", "boot", robot, memory, self.decisions, Mock(), Mock(), self.clerks),
            realtime=None,
            unfit=lambda: self.unfit,
        )

    def end(self) -> None:
        self.let_go.set()
        self.worker.close()
        self.clerks.shutdown()

    def hang(self) -> None:
        self.inside.set()
        assert self.let_go.wait(PATIENCE_S)

    def begin(self, goal_id: str) -> None:
        _, motion = self.decisions.take(GoalRequest(goal_id=goal_id, owner="o", motion=EXCITATION))
        assert motion is not None
        self.worker.begin(motion)

    def result(self, goal_id: str) -> GoalResult:
        wait_until(lambda: isinstance(self.decisions.result(goal_id), GoalResult))
        result = self.decisions.result(goal_id)
        assert isinstance(result, GoalResult)
        return result

    def look_until_it_hangs(self) -> None:
        assert self.inside.wait(PATIENCE_S)
        for _ in range(int(SLOW_CALL_MAX_S) + 2):
            self.worker.look_after_robot()
            self.clock.now_s += 1.0

    def release(self) -> object:
        return self.worker.reconnect().result(PATIENCE_S)


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(watched_robot, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    return clock


@pytest.fixture
def hanging(clock: Clock) -> Iterator[Hanging]:
    hanging = Hanging(clock)
    yield hanging
    hanging.end()


def test_a_driver_that_hangs_as_its_idle_robot_lands_is_a_fault(hanging: Hanging) -> None:
    hanging.puppet.on_end = hanging.hang
    hanging.begin("one")
    assert hanging.result("one").outcome is Outcome.COMPLETED
    hanging.look_until_it_hangs()
    assert "has not returned from 'end'" in str(hanging.decisions.fault)
    assert isinstance(hanging.release(), Refusal)


def test_a_robot_that_may_not_move_any_more_does_not_stay_in_the_air(clock: Clock) -> None:
    flown, landed = Hanging(clock, idle_s=3600.0), threading.Event()
    flown.puppet.on_end = landed.set
    flown.begin("one")
    assert flown.result("one").outcome is Outcome.COMPLETED
    flown.worker.look_after_robot()
    flown.unfit = "its battery is empty"
    assert not landed.is_set()
    flown.worker.look_after_robot()
    assert landed.wait(PATIENCE_S)
    flown.end()


def test_a_goal_that_waits_behind_a_driver_that_hangs_ends(hanging: Hanging) -> None:
    hanging.puppet.on_end = hanging.hang
    hanging.begin("one")
    assert hanging.result("one").outcome is Outcome.COMPLETED
    assert hanging.inside.wait(PATIENCE_S)
    hanging.begin("two")
    hanging.look_until_it_hangs()
    assert "has not returned from 'end'" in hanging.result("two").reason
    hanging.let_go.set()
    hanging.puppet.on_end = lambda: None
    wait_until(lambda: hanging.release() == Done())
    assert hanging.puppet.begun == 1  # nobody took off for the goal that had been given up
    hanging.begin("three")
    assert hanging.result("three").outcome is Outcome.COMPLETED


def test_a_driver_that_returns_from_a_hanging_begin_moves_nothing_and_may_begin_again(
    hanging: Hanging,
) -> None:
    hanging.puppet.on_begin = hanging.hang
    hanging.begin("one")
    hanging.look_until_it_hangs()
    assert "has not returned from 'begin'" in hanging.result("one").reason
    hanging.let_go.set()
    wait_until(lambda: hanging.release() == Done())
    assert hanging.puppet.samples == 0
    hanging.begin("two")
    assert hanging.result("two").outcome is Outcome.COMPLETED


def stop(hanging: Hanging) -> None:
    hanging.decisions.stop(StopOrder("alice", "smoke"))


def test_a_stop_during_a_reconnection_leaves_a_fault_until_the_next_release(
    hanging: Hanging,
) -> None:
    hanging.decisions.broke("its driver failed")
    hanging.puppet.on_connect = lambda: stop(hanging)
    refused = hanging.release()
    assert isinstance(refused, Refusal)
    assert refused.reason == "it was stopped while it was being reconnected"
    hanging.puppet.on_connect = lambda: None
    assert hanging.decisions.release("bob") is None
    assert hanging.decisions.fault is not None
    assert hanging.release() == Done()
    assert hanging.decisions.fault is None


def test_a_release_from_before_a_stop_connects_no_robot(hanging: Hanging) -> None:
    hanging.decisions.broke("its driver failed")
    stop(hanging)
    hanging.puppet.on_connect = hanging.puppet.on_disconnect = lambda: pytest.fail("it is asked")
    refused = hanging.release()
    hanging.puppet.on_disconnect = lambda: None
    assert isinstance(refused, Refusal)
    assert refused.code == "stopped"
    assert hanging.decisions.fault == "its driver failed"


def test_a_result_counts_the_late_samples_of_its_motion_alone(clock: Clock) -> None:
    real = Hanging(clock, simulated=False)

    def lasts(sample: int) -> float:
        return 0.05 if sample == 3 and real.puppet.motions == 1 else 0.01

    def on_sample(sample: int) -> None:
        clock.now_s += lasts(sample)

    real.puppet.on_sample = on_sample
    for goal_id, late in (("one", 1), ("two", 0)):
        real.begin(goal_id)
        assert real.result(goal_id).late_samples == late
    real.end()
