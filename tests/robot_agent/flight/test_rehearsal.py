"""What is rehearsed on models of a robot is what it then flies."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from robots_that_learn import LaggedRobot, double_integrator

from nufleet.robot_agent.flight.flights import performance_of
from nufleet.robot_agent.flight.forecast import forecast_of
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.rehearsal import Rehearsal, predicted_from, widened
from nufleet.robot_agent.flight.rehearsed_robot import LoopDraw, RehearsedRobot
from nufleet.robot_agent.motion.pace import HaltSwitch
from nufleet.robot_agent.motion.perform import perform
from nufleet.robot_agent.robot import Robot
from nufleet.shared.errors import InvalidInputError, RobotError
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.models.error_belief import ErrorBelief
from nufleet.shared.models.error_response import ErrorBasis
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.wire.messages import ForeseenWay, Outcome
from nufleet.shared.wire.motions import (
    Flight,
    PredictedError,
    RichFlight,
    Tracking,
    TrackingDetails,
)

PATH = travel(np.array([[0.0, 0.0], [0.5, 0.5], [-0.4, 0.2]]), 0.5, 1.0, 0.02)


def flown(robot: Robot, motion: Flight, memory: Memory) -> float:
    """Fly a path or another motion, and return the error that was measured."""
    switch = HaltSwitch()
    performance = performance_of(
        motion,
        robot,
        memory,
        realtime=None,
        switch=switch,
        on_played=lambda samples: None,
        watch=lambda *_: None,
    )
    played = perform(robot, performance, switch, on_resting=lambda: None)
    assert played.outcome is Outcome.COMPLETED, played.reason
    if not isinstance(played.samples.details, TrackingDetails):
        return 0.0
    away = played.samples.response - played.samples.details.desired
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))


def none(states: tuple[str, ...], sample_time_s: float) -> ForeseenWay:
    """The way that learns online and begins with nothing."""
    known = InverseLayout(
        architecture="state", states=states, sample_time_s=sample_time_s, horizon_samples=10
    )
    return ForeseenWay(inverse="zero-prior", layout=known)


@dataclass(frozen=True, eq=False)
class Known:
    """A robot that has flown a path once, which it may fly again while learning from nothing."""

    robot: LaggedRobot
    memory: Memory
    way: ForeseenWay
    rehearsal: Rehearsal
    predicted: PredictedError
    """What two rehearsals show of the way."""

    def of_axes(self, change: Callable[[ErrorBelief], ErrorBelief]) -> PredictedError:
        """Return what two rehearsals show if something else is believed of every axis."""
        model = self.rehearsal.model
        other = replace(model, axes=tuple(change(axis) for axis in model.axes))
        return replace(self.rehearsal, model=other).predicted(self.way, draws=2)


@pytest.fixture(scope="module")
def known() -> Known:
    robot, memory = LaggedRobot(noise_std_m=1e-3), Memory(None)
    flown(robot, Tracking(desired=PATH, inverse="baseline"), memory)
    way = none(robot.state_names, robot.spec.sample_time_s)
    rehearsal = Rehearsal.of(robot.spec, robot.state_names, memory, PATH)
    return Known(robot, memory, way, rehearsal, rehearsal.predicted(way, draws=2))


def test_a_rehearsed_robot_answers_as_its_response_says_sample_by_sample() -> None:
    spec, rng = LaggedRobot().spec, np.random.default_rng(0)
    basis = ErrorBasis(spec.sample_time_s, spec.settling_time_s)
    slow, fast = (np.append(np.exp(-basis.nodes / lag), rest) for lag, rest in ((8, 0.01), (4, 0)))
    draw = LoopDraw(
        basis=basis,
        responses=np.stack([slow, fast], axis=1),
        across=np.zeros((basis.size, 2, 2)),
        unexplained=np.zeros((1, 2)),
        state_gains=np.zeros((2, 1, 2)),
        state_noise_std=np.zeros((2, 1)),
    )
    references = np.cumsum(rng.standard_normal((3000, 2)), axis=0)
    errors = [
        basis.columns(references[:, i], 0.0) @ response for i, response in enumerate((slow, fast))
    ]
    robot = RehearsedRobot(spec, ("position",), draw, rng)
    expected = references - np.stack(errors, axis=1)
    np.testing.assert_allclose(robot.run(references), expected, atol=1e-9)
    robot.rest()
    np.testing.assert_allclose(robot.run(references), expected, atol=1e-9)


def test_the_error_of_learning_online_is_the_one_that_was_rehearsed() -> None:
    robot, memory = LaggedRobot(noise_std_m=1e-3), Memory(None)
    flown(robot, Tracking(desired=PATH, inverse="baseline"), memory)
    way = none(robot.state_names, robot.spec.sample_time_s)
    expected = Rehearsal.of(robot.spec, robot.state_names, memory, PATH).predicted(way)
    measured = flown(robot, way.along(PATH), memory)
    assert expected.low <= measured <= expected.high
    assert expected.high < 1.5 * expected.low
    baseline = Rehearsal.of(robot.spec, robot.state_names, memory, PATH).predicted(
        ForeseenWay(inverse="baseline")
    )
    assert expected.high < baseline.low


def test_states_beside_the_output_are_rehearsed_once_they_were_observed() -> None:
    robot, memory = double_integrator(noise_std_m=1e-3), Memory(None)
    flown(robot, RichFlight(duration_s=30.0, seed=0), memory)
    states = memory.states(robot.spec, robot.state_names)
    # In the paper's model a position moves by (T_s − β) times the speed, with β = T_s / 5.
    np.testing.assert_allclose(states.gains[0, 1], [1.25, 0.0], atol=0.02)
    path = travel(np.array([[0.0], [0.5], [-0.4]]), 0.5, 1.0, robot.spec.sample_time_s)
    way = none(robot.state_names, robot.spec.sample_time_s)
    expected = Rehearsal.of(robot.spec, robot.state_names, memory, path).predicted(way)
    assert expected.low <= flown(robot, way.along(path), memory) <= expected.high


def test_the_same_flight_is_expected_to_have_the_same_error_again(known: Known) -> None:
    assert known.of_axes(lambda axis: axis) == known.predicted


def test_a_rehearsal_moves_nothing_and_teaches_the_robot_nothing(known: Known) -> None:
    samples, seconds = known.robot.samples, dict(known.memory.flown_s)
    known.rehearsal.predicted(known.way, draws=2)
    assert (known.robot.samples, dict(known.memory.flown_s)) == (samples, seconds)


def test_a_robot_that_knows_nothing_of_itself_cannot_rehearse() -> None:
    robot = LaggedRobot()
    with pytest.raises(RobotError, match="no model of itself"):
        Rehearsal.of(robot.spec, robot.state_names, Memory(None), PATH)


def test_a_state_that_was_never_observed_is_named() -> None:
    robot, memory = LaggedRobot(noise_std_m=1e-3), Memory(None)
    flown(robot, Tracking(desired=PATH, inverse="baseline"), memory)
    rehearsal = Rehearsal.of(robot.spec, ("position", "tilt"), memory, PATH)
    with pytest.raises(InvalidInputError, match="tilt"):
        rehearsal.predicted(none(("position", "tilt"), robot.spec.sample_time_s))


def test_an_error_like_that_of_the_likeliest_robot_is_expected_where_drawn_ones_do_worse(
    known: Known,
) -> None:
    doubted = known.of_axes(lambda axis: replace(axis, factor=200 * axis.factor))
    measured = flown(known.robot, known.way.along(PATH), Memory.imported(*known.memory.exported()))
    assert doubted.low <= measured < 0.1 * doubted.rms


def test_an_error_that_may_not_grow_with_the_motion_may_be_smaller_by_what_is_not_known(
    known: Known,
) -> None:
    largest = 0.1 * float(np.std(PATH, axis=0).min())
    held = known.of_axes(lambda axis: replace(axis, bounded=1.0, largest=largest))
    assert held.low < 0.1 * known.predicted.low < held.high


def test_an_error_as_small_as_if_the_model_were_right_is_expected_of_flying_with_it(
    known: Known,
) -> None:
    model = known.rehearsal.model
    axes = tuple(replace(axis, factor=20 * axis.factor) for axis in model.axes)
    doubted = replace(model, axes=axes)
    forecast = forecast_of(doubted, PATH)
    assert forecast is not None
    way = ForeseenWay(inverse="own")
    found = replace(known.rehearsal, model=doubted, forecast=forecast).predicted(way)
    assert (found.rms, found.high) == (forecast.own.rms, forecast.own.high)
    measured = flown(known.robot, way.along(PATH), Memory.imported(*known.memory.exported()))
    assert found.low <= measured < forecast.own.low


def test_what_a_guard_withdraws_in_rehearsals_alone_is_expected_at_most() -> None:
    found = PredictedError(rms=0.005, low=0.003, high=0.012)
    assert widened(found, 0.006, 0.0) == found
    assert widened(found, 0.006, 0.017).high > 0.02
    assert widened(found, 0.006, 0.017).low == found.low
    assert widened(found, 0.006, 0.0, left=0.1).low == pytest.approx(0.1 * found.low)


def test_few_rehearsals_bound_the_next_error_as_often_as_they_say() -> None:
    rng = np.random.default_rng(0)
    inside = []
    for _ in range(4000):
        *few, following = np.exp(0.3 * rng.standard_normal(5))
        found = predicted_from(few)
        inside.append(found.low <= following <= found.high)
    assert np.mean(inside) == pytest.approx(0.9, abs=0.015)


def test_rehearsals_that_all_end_alike_leave_as_much_doubt_as_a_model_does() -> None:
    found = predicted_from([0.02] * 4)
    assert found.rms == pytest.approx(0.02)
    assert (found.high / found.rms, found.rms / found.low) == pytest.approx(
        (1.027, 1.027), abs=1e-3
    )
