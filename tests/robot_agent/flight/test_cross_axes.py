"""What one axis does to another counts in what a robot foresees of its flights."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pytest

from nufleet.orchestrator.study.tone_choice import first_look, lowest_look_together
from nufleet.robot_agent.flight.cross_axes import crosses_in, crosses_of
from nufleet.robot_agent.flight.flights import performance_of
from nufleet.robot_agent.flight.learning import learn
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.own_model import OwnModel
from nufleet.robot_agent.flight.rehearsal import Rehearsal
from nufleet.robot_agent.flight.rehearsed_robot import LoopDraw, RehearsedRobot
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.robot_agent.motion.pace import HaltSwitch
from nufleet.robot_agent.motion.perform import perform
from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.error_response import ErrorBasis
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.wire.messages import ForeseenWay, Outcome
from nufleet.shared.wire.motions import PredictedError, Tracking, TrackingDetails
from nufleet.sims.coupled_loops import CoupledLoops, CoupledLoopsSettings

BAND = (0.2, 8.0)
COUPLING = 0.15
CORNERS = {
    "zigzag": [[0.0, 0.0], [0.5, 0.5], [-0.4, 0.2]],
    "across": [[0.0, 0.0], [0.5, -0.5], [-0.5, 0.5]],
    "square": [[0.0, 0.0], [0.5, 0.0], [0.5, 0.5], [0.0, 0.5], [0.0, 0.0]],
}


def robot_of(coupling: float, seed: int = 0) -> CoupledLoops:
    """The target of the fleet `off_centre`, with a payload as far off centre as that."""
    settings = CoupledLoopsSettings(
        natural_frequency_rad_s=(4.0, 4.0),
        damping_ratio=(0.7, 0.7),
        coupling=(coupling,),
        noise_std_m=0.002,
    )
    robot = CoupledLoops("robot", settings, np.random.default_rng(seed))
    robot.connect()
    return robot


def memory_of(robot: CoupledLoops) -> Memory:
    """What the robot remembers of the tests that a ranking over both axes asks for."""
    memory = Memory(None)
    tests = [
        first_look(BAND, robot.spec, 11, 0.7, (0, 1)),
        lowest_look_together(BAND, robot.spec, 0.5, (1, 0), 1),
    ]
    for test in tests:
        assert test is not None
        plan = plan_excitation(test.excitation("x", "y"), robot.spec, "robot")
        order = [("x", "y").index(one.axis) for one in plan.played]
        references = np.zeros((plan.samples, 2))
        references[:, order] = reference_of(plan)
        learn(memory, robot.spec, references, robot.run(references))
        robot.rest()
    return memory


@dataclass(frozen=True, eq=False)
class Known:
    """A robot that knows itself from tests alone."""

    robot: CoupledLoops
    memory: Memory
    model: OwnModel


def known_of(coupling: float, seed: int = 0) -> Known:
    robot = robot_of(coupling, seed)
    memory = memory_of(robot)
    model = memory.own_model(robot.spec).model
    assert model is not None
    return Known(robot, memory, model)


@pytest.fixture(scope="module")
def known() -> Known:
    return known_of(COUPLING)


def path_through(corners: list[list[float]]) -> FloatArray:
    return travel(np.array(corners), 0.5, 1.0, 0.02)


def flown_error(known: Known, path: FloatArray, inverse: Literal["baseline", "own"]) -> float:
    """The error of a flight with the baseline alone, or with the model that tests give."""
    robot, switch = known.robot, HaltSwitch()
    performance = performance_of(
        Tracking(desired=path, inverse=inverse, guarded=False),
        robot,
        Memory.imported(*known.memory.exported()),
        realtime=None,
        switch=switch,
        on_played=lambda samples: None,
        watch=lambda *_: None,
    )
    played = perform(robot, performance, switch, on_resting=lambda: None)
    assert played.outcome is Outcome.COMPLETED, played.reason
    assert isinstance(played.samples.details, TrackingDetails)
    away = played.samples.response - played.samples.details.desired
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))


def foreseen(known: Known, path: FloatArray, inverse: Literal["baseline", "own"]) -> PredictedError:
    robot = known.robot
    rehearsal = Rehearsal.of(robot.spec, robot.state_names, known.memory, path)
    return rehearsal.predicted(ForeseenWay(inverse=inverse))


def test_the_answer_of_an_axis_to_another_is_that_of_the_robot(known: Known) -> None:
    assert {(cross.output, cross.reference) for cross in known.model.crosses} == {(0, 1), (1, 0)}
    omega = np.linspace(0.5, 6.0, 40)
    truth = known.robot.model.graph(omega)[:, 2:]
    largest = float(np.max(np.abs(truth[:, 0, 1])))
    for cross in known.model.crosses:
        found = -cross.belief.basis.response(omega) @ cross.belief.mean
        error = np.abs(found - truth[:, cross.output, cross.reference])
        assert np.max(error) < 0.2 * largest


def test_what_axes_do_to_each_other_is_not_taken_for_noise(known: Known) -> None:
    for axis in known.model.axes:
        assert axis.noise_std == pytest.approx(0.002, rel=0.05)


def root_mean_square(left: FloatArray) -> float:
    return float(np.sqrt(np.mean(np.sum(left**2, axis=1))))


@pytest.mark.parametrize("name", list(CORNERS))
def test_the_error_of_a_flight_is_foreseen_with_what_axes_do_to_each_other(
    known: Known, name: str
) -> None:
    path = path_through(CORNERS[name])
    error = flown_error(known, path, "baseline")
    columns = zip(known.model.axes, path.T, strict=True)
    own = np.stack([axis.error(wanted, wanted[0]) for axis, wanted in columns], axis=1)
    assert root_mean_square(own + known.model.across(path)) == pytest.approx(error, rel=0.01)
    if name != "square":  # one axis after the other moves, and what they do to each other cancels
        assert abs(root_mean_square(own) / error - 1) > 0.01


@pytest.mark.thorough
def test_nine_of_ten_errors_of_coupled_robots_lie_in_their_intervals() -> None:
    held = []
    for seed, coupling in enumerate((COUPLING, -COUPLING, 0.1, 0.2)):
        one = known_of(coupling, seed)
        for corners in CORNERS.values():
            path = path_through(corners)
            for inverse in ("baseline", "own"):
                expected = foreseen(one, path, inverse)
                held.append(expected.low <= flown_error(one, path, inverse) <= expected.high)
    assert sum(held) >= 21  # of 24; at 90 % each, fewer have a chance of 8 %


def test_axes_that_are_not_coupled_are_known_to_do_nothing_to_each_other() -> None:
    assert known_of(0.0, seed=1).model.crosses == ()


def test_what_axes_do_to_each_other_is_kept_and_given_to_another_process(known: Known) -> None:
    again = Memory.imported(*known.memory.exported()).own_model(known.robot.spec).model
    assert again is not None
    assert len(again.crosses) == len(known.model.crosses)
    for before, after in zip(known.model.crosses, again.crosses, strict=True):
        np.testing.assert_allclose(after.belief.mean, before.belief.mean)


def test_a_rehearsed_robot_answers_with_one_axis_to_the_other() -> None:
    spec, rng = robot_of(COUPLING).spec, np.random.default_rng(0)
    basis = ErrorBasis(spec.sample_time_s, spec.settling_time_s)
    own = np.append(np.exp(-basis.nodes / 8), 0.0)
    other = np.append(0.2 * (basis.nodes / 8) * np.exp(-basis.nodes / 8), 0.01)
    across = np.zeros((basis.size, 2, 2))
    across[:, 0, 1] = other
    draw = LoopDraw(
        basis=basis,
        responses=np.stack([own, own], axis=1),
        across=across,
        unexplained=np.zeros((1, 2)),
        state_gains=np.zeros((2, 1, 2)),
        state_noise_std=np.zeros((2, 1)),
    )
    references = np.cumsum(rng.standard_normal((800, 2)), axis=0)
    x, y = (basis.columns(references[:, i], 0.0) for i in range(2))
    expected = references - np.stack([x @ own, y @ own + x @ other], axis=1)
    found = RehearsedRobot(spec, ("position",), draw, rng).run(references)
    np.testing.assert_allclose(found, expected, atol=1e-9)


@pytest.mark.parametrize("seed", [0, 1, 27, 39])
def test_axes_that_do_nothing_to_each_other_are_found_not_to_also_without_noise(seed: int) -> None:
    """What is left is then all rounding, which a belief could take for an answer."""
    rng = np.random.default_rng(seed)
    omega_rad_s, phase = rng.uniform(1, 25, 3), rng.uniform(0, 6, 3)
    time_s = 0.005 * np.arange(800)[:, np.newaxis]
    references = 0.02 * (np.sin(omega_rad_s * time_s + phase) - np.sin(phase))
    outputs = np.zeros_like(references)
    for k in range(len(references) - 1):
        outputs[k + 1] = outputs[k] + 0.7 * (references[k] - outputs[k])
    basis = ErrorBasis(0.005, 0.025)
    crosses, alone = crosses_in(basis, "abc", references, outputs)
    assert crosses_of(basis, "abc", crosses) == ()
    np.testing.assert_allclose(alone, outputs, rtol=0, atol=1e-6)
