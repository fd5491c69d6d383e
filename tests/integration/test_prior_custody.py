"""A robot has the same prior afterwards as before, no matter what happened in between."""

from __future__ import annotations

import signal
import threading

import numpy as np
import pytest
from fleet_lab import Lab, Orchestrator, assert_never_moved, double_integrator, submitted
from learned_things import experience
from robots_that_learn import LaggedRobot

from nufleet.orchestrator.experience.learning import fly_lessons
from nufleet.orchestrator.experience.prior_custody import install, prior_put_back
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError, RobotError, StudyError
from nufleet.shared.experience.file import digest
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.robots.fleet_file import RobotPolicy
from nufleet.shared.wire.messages import GoalRequest
from nufleet.shared.wire.motions import Tracking, Way

PATH = travel(np.array([[0.0], [0.9], [-0.5], [0.0]]), 0.4, 1.5, 0.015)
OWN, OTHER = experience("source", seed=1), experience("somebody", seed=2)


def prior_of(fleet: Fleet, robot: str) -> str | None:
    prior = fleet.describe(robot).prior
    return None if prior is None else prior.sha256


@pytest.fixture
def orchestrator(lab: Lab) -> Orchestrator:
    lab.agent("target", double_integrator(0.85, 1))
    return lab.orchestrator()


@pytest.fixture
def fleet(orchestrator: Orchestrator) -> Fleet:
    return orchestrator.fleet


@pytest.mark.parametrize("before", [None, OWN], ids=["none", "one"])
@pytest.mark.parametrize("error", [None, RobotError("it fell over"), KeyboardInterrupt()])
def test_a_prior_is_put_back_however_it_ends(
    fleet: Fleet, before: bytes | None, error: BaseException | None
) -> None:
    if before is not None:
        install(fleet, "target", "prior", before)
    description = fleet.describe("target")

    def borrow() -> None:
        with prior_put_back(fleet, Pilot(fleet, "run"), description):
            install(fleet, "target", "prior", OTHER)
            assert prior_of(fleet, "target") == digest(OTHER)
            if error is not None:
                raise error

    if error is None:
        borrow()
    else:
        with pytest.raises(type(error)):
            borrow()
    assert prior_of(fleet, "target") == (None if before is None else digest(before))


def test_ctrl_c_in_flight_brings_the_robot_to_rest_before_its_prior_is_put_back(lab: Lab) -> None:
    unguarded = RobotPolicy(allow_unguarded=True)
    lab.agent("slow", double_integrator(0.85, 1), realtime=1.0, policy=unguarded)
    orchestrator = lab.orchestrator()
    fleet = orchestrator.fleet
    path = np.tile(PATH, (3, 1))
    install(fleet, "slow", "prior", OWN)
    pilot = Pilot(fleet, "run")
    main = threading.main_thread().ident
    assert main is not None

    def press_ctrl_c() -> None:
        # The way to the start takes the first seventh.
        orchestrator.state("slow", lambda s: s.goal_id is not None and s.progress > 0.2)
        signal.pthread_kill(main, signal.SIGINT)

    ctrl_c = threading.Thread(target=press_ctrl_c)

    def fly() -> None:
        with prior_put_back(fleet, pilot, fleet.describe("slow")):
            install(fleet, "slow", "prior", OTHER)
            ctrl_c.start()
            way = Way(inverse="prior", prior_sha256=digest(OTHER), guarded=False)
            pilot.along("slow", way, path, "prior")

    with pytest.raises(KeyboardInterrupt):
        fly()
    ctrl_c.join()
    assert prior_of(fleet, "slow") == digest(OWN)
    state = orchestrator.state("slow", lambda s: s.goal_id is None)
    assert state.last_goal_id is not None
    result = fleet.result("slow", state.last_goal_id)
    assert result.outcome == "cancelled"
    assert 0 < len(result.response) < len(path)


def test_a_robot_that_is_gone_does_not_hide_why_the_flights_ended(
    lab: Lab, caplog: pytest.LogCaptureFixture
) -> None:
    agent = lab.agent("target", double_integrator(0.85, 1))
    fleet = lab.orchestrator().fleet

    def lose() -> None:
        with prior_put_back(fleet, Pilot(fleet, "run"), fleet.describe("target")):
            agent.close()
            raise RobotError("it flew away")

    with pytest.raises(RobotError, match="it flew away"):
        lose()
    assert "the former prior of target could not be restored" in caplog.text


# What goes wrong while a robot learns names the robot.


class StickyRobot(LaggedRobot):
    """It moves only as far as its reference is beyond 0.03 m: steps are too small for it."""

    def step(self, reference: FloatArray) -> FloatArray:
        return super().step(np.sign(reference) * np.maximum(0.0, np.abs(reference) - 0.03))


def test_a_robot_that_does_not_answer_to_steps_is_named_with_what_to_try(lab: Lab) -> None:
    lab.agent("stuck", StickyRobot(noise_std_m=0.001))
    fleet = lab.orchestrator().fleet
    with pytest.raises(StudyError, match=r"robot stuck, axis x: .*nufleet track --target stuck"):
        lessons(fleet, "stuck")


def test_a_robot_that_does_not_track_is_refused_before_it_moves(
    orchestrator: Orchestrator,
) -> None:
    fleet = orchestrator.fleet
    description = fleet.describe("target")
    spec = description.spec.model_copy(update={"tracking": None})
    with pytest.raises(InvalidInputError, match="robot target has no tracking limits"):
        fly_lessons(
            Pilot(fleet, "run"),
            fleet,
            description.model_copy(update={"spec": spec}),
            ("preview",),
            seed=0,
            say=lambda robot, what: None,
        )
    assert_never_moved(orchestrator, "target")


def lessons(fleet: Fleet, robot: str) -> None:
    fly_lessons(
        Pilot(fleet, "run"),
        fleet,
        fleet.describe(robot),
        ("preview",),
        seed=0,
        duration_s=60.0,
        say=lambda robot, what: None,
    )


def test_a_goal_that_another_sent_is_not_cancelled_by_putting_back(
    orchestrator: Orchestrator,
) -> None:
    """Only Ctrl-C ends flights; an error of one robot leaves the others' alone."""
    fleet = orchestrator.fleet
    request = GoalRequest(
        goal_id="theirs",
        owner=fleet.orchestrator_id,
        motion=Tracking(desired=PATH, inverse="baseline"),
    )
    with prior_put_back(fleet, Pilot(fleet, "run"), fleet.describe("target")):
        submitted(fleet, "target", request)
        assert orchestrator.result("target", "theirs").outcome == "completed"
