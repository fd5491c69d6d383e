"""A forecast is made beside the agent: it delays nothing, and is a failure only when it fails."""

from __future__ import annotations

import errno
import logging
import os
import subprocess
import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest
from child_processes import rehearsals
from learned_things import flown_before
from polling import PATIENCE_S, wait_until
from robots_that_learn import LaggedRobot

from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.forecast_service import LESS_URGENT, ForecastService
from nufleet.robot_agent.planner import Planner
from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.wire.codec import encode
from nufleet.shared.wire.messages import ForecastRequest, ForeseenWay, PathForecast, Refusal
from nufleet.shared.wire.motions import Motion, MotionPlan, Tracking

LONG = travel(np.array([[0.0, 0.0], [0.3, 0.2], [0.0, 0.0]]), 0.01, 1.0, 0.02)
"""A path of more than a minute, which is more than a pipe holds, and takes as long to rehearse."""
LAYOUT = InverseLayout(
    architecture="state", states=("position",), sample_time_s=0.02, horizon_samples=5
)
LEARNS = ForecastRequest(desired=LONG, ways=(ForeseenWay(inverse="zero-prior", layout=LAYOUT),))
BASELINE = ForecastRequest(desired=LONG, ways=(ForeseenWay(inverse="baseline"),))


class Lab:
    """A service of a robot that stands still, and a clock that only a test moves."""

    def __init__(self, memory: Memory, planner: type[Planner] = Planner) -> None:
        robot, self.now_s = LaggedRobot(), 0.0
        planned = planner("a", robot.spec, robot.state_names, memory, None)
        self.goal: str | None = None
        self.service = ForecastService(planned, lambda: self.goal, clock=lambda: self.now_s)

    def found(self, request: ForecastRequest) -> PathForecast:
        answer = self.service.asked(encode(request))
        assert isinstance(answer, PathForecast)
        return answer


@pytest.fixture
def lab() -> Iterator[Lab]:
    """One whose robot knows itself."""
    memory = Memory(None)
    memory.learn(flown_before(LaggedRobot().spec))
    lab = Lab(memory)
    yield lab
    lab.service.close()


def test_it_is_less_urgent_than_normal_processes_from_its_first_instruction(lab: Lab) -> None:
    lab.found(LEARNS)
    (process,) = rehearsals()
    assert process.nice() == LESS_URGENT
    assert os.sched_getscheduler(process.pid) == os.SCHED_BATCH


def test_a_request_is_not_even_read_while_the_robot_moves(lab: Lab) -> None:
    lab.goal = "g1"
    answer = lab.service.asked(b"no message")
    assert isinstance(answer, Refusal)
    assert answer.code == "busy"
    lab.goal = None
    with pytest.raises(MalformedMessageError):
        lab.service.asked(b"no message")


def test_a_forecast_that_is_ended_is_no_failure(lab: Lab, caplog: pytest.LogCaptureFixture) -> None:
    lab.found(LEARNS)
    lab.service.close()
    assert rehearsals() == []
    assert caplog.records == []


def test_a_process_that_dies_is_reported_and_its_ways_are_answered(
    lab: Lab, caplog: pytest.LogCaptureFixture
) -> None:
    lab.found(LEARNS)
    rehearsals()[0].kill()
    wait_until(lambda: None not in lab.found(LEARNS).foreseen)
    (answer,) = lab.found(LEARNS).foreseen
    assert answer is not None
    assert (answer.code, answer.predicted) == ("rehearsal", None)
    assert [record.levelno for record in caplog.records] == [logging.WARNING]


def test_a_process_that_cannot_be_started_is_reported_and_its_ways_are_answered(
    lab: Lab, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))

    monkeypatch.setattr(subprocess, "Popen", full)
    (answer,) = lab.found(LEARNS).foreseen
    assert answer is not None
    assert "could not begin: [Errno 12] Cannot allocate memory" in answer.reason
    assert [record.levelno for record in caplog.records] == [logging.WARNING]


def test_a_forecast_that_took_long_to_begin_still_has_a_requester(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    start = subprocess.Popen

    def start_late(*args: Any, **named: Any) -> subprocess.Popen[bytes]:
        lab.now_s += 60.0
        return start(*args, **named)

    monkeypatch.setattr(subprocess, "Popen", start_late)
    lab.found(LEARNS)
    lab.service.look()
    assert len(rehearsals()) == 1


class SlowPlanner(Planner):
    """Plans until it is allowed to end."""

    begun, allowed = threading.Event(), threading.Event()

    def plan(self, motion: Motion) -> MotionPlan:
        if isinstance(motion, Tracking) and len(motion.desired) == len(LONG):
            self.begun.set()
            assert self.allowed.wait(PATIENCE_S)
        return super().plan(motion)


def test_a_heartbeat_does_not_wait_for_the_plan_of_a_forecast() -> None:
    lab = Lab(Memory(None), SlowPlanner)
    lab.found(BASELINE.model_copy(update={"desired": LONG[:10]}))
    lab.now_s = 60.0  # its requester is gone
    asking = threading.Thread(target=lambda: lab.found(BASELINE))
    asking.start()
    assert SlowPlanner.begun.wait(PATIENCE_S)
    beating = threading.Thread(target=lab.service.look, daemon=True)
    beating.start()
    beating.join(PATIENCE_S / 2)
    waited = beating.is_alive()
    SlowPlanner.allowed.set()
    asking.join()
    assert not waited
