"""The control loop with an inverse in front of the robots of Section V."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from robots_that_learn import LIMITS, LaggedRobot, double_integrator

from nufleet.orchestrator.experience.lesson_record import LearningRecord, pooled_pairs
from nufleet.orchestrator.experience.linear_inverse import linear_experience
from nufleet.orchestrator.experience.training import Origin, TrainingData
from nufleet.robot_agent.flight.equipment import guard_for
from nufleet.robot_agent.flight.forecast import forecast_of
from nufleet.robot_agent.flight.guard import Guard
from nufleet.robot_agent.flight.inverse_model import InverseModel, NetworkInverse
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.online_gp import Correction, OnlineGp
from nufleet.robot_agent.flight.own_model import evidence_in
from nufleet.robot_agent.flight.rich_flight import FlightRecord, fly_record
from nufleet.robot_agent.flight.tracking import Learner, track
from nufleet.robot_agent.flight.tracking_record import TrackingRecord
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.layout import Architecture, InverseLayout
from nufleet.shared.paths.references import rich_references
from nufleet.shared.paths.trajectories import travel

PATH = travel(np.array([[0.0], [0.9], [-0.5], [0.6], [0.0]]), 0.8, 1.8, 0.015)

PREVIEW = InverseLayout(
    architecture="preview", states=("position",), sample_time_s=0.02, horizon_samples=4
)


@lru_cache
def flown(alpha: float = 0.85, beta: float = 0.003, noise_std_m: float = 0.0) -> FlightRecord:
    robot = double_integrator(alpha, beta, noise_std_m)
    return fly_record(robot, rich_references(robot.spec, 60.0, np.random.default_rng(0)))


HORIZONS: dict[str, int] = {"state": 20, "preview": 20}
"""In samples: 0.3 s, what the robots of Section V choose."""


def layout_of(architecture: Architecture) -> InverseLayout:
    states = ("position", "velocity") if architecture == "state" else ("position",)
    return InverseLayout(
        architecture=architecture,
        states=states,
        sample_time_s=0.015,
        horizon_samples=HORIZONS[architecture],
    )


def linear(layout: InverseLayout, record: FlightRecord) -> NetworkInverse:
    known = LearningRecord(record.references, record.states, ("position", "velocity"))
    data = TrainingData(*pooled_pairs(layout, known, (0,)))
    origin = Origin("source", "double-integrator", ("x",), "m", 1)
    return NetworkInverse(linear_experience(data, layout, origin))


def learner(layout: InverseLayout, prior: InverseModel | None, window: int = 50) -> Learner:
    return Learner(layout, OnlineGp(layout, (prior,), window=window))


def baseline() -> TrackingRecord:
    return track(double_integrator(), PATH, LIMITS)


@pytest.mark.parametrize("architecture", ["state", "preview"])
def test_its_own_inverse_takes_nine_tenths_of_a_robots_error(architecture: Architecture) -> None:
    layout = layout_of(architecture)
    inverse = linear(layout, flown())
    own = track(double_integrator(), PATH, LIMITS, learner(layout, inverse, window=0))
    assert own.failure is None
    assert own.rms_error < 0.1 * baseline().rms_error


def test_the_preview_of_a_more_similar_source_tracks_better() -> None:
    """Section V: ψ ranks the sources 2, 1, 3."""
    errors = []
    for alpha, beta in [(0.97, 0.004), (1.0, 0.003), (0.9, 0.001)]:
        layout = layout_of("preview")
        inverse = linear(layout, flown(alpha, beta))
        flight = track(double_integrator(), PATH, LIMITS, learner(layout, inverse, window=0))
        errors.append(flight.rms_error)
    assert errors == sorted(errors)
    assert errors[-1] < baseline().rms_error


def test_the_online_process_learns_the_bias_of_a_preview() -> None:
    robot = double_integrator()
    layout = layout_of("preview")
    own = linear(layout, flown())

    def off(inputs: FloatArray) -> FloatArray:
        return own(inputs) + 0.2

    alone = track(robot, PATH, LIMITS, learner(layout, off, window=0))
    online = track(robot, PATH, LIMITS, learner(layout, off))
    assert online.rms_error < 0.8 * alone.rms_error
    assert np.abs(online.mean).max() > 0
    assert np.abs(alone.mean).max() == 0


class Counting(OnlineGp):
    learned = 0

    def learn(self, axis: int, inputs: FloatArray, gamma: float) -> None:
        self.learned += 1
        super().learn(axis, inputs, gamma)


@pytest.mark.parametrize(("spacing_s", "every"), [(0.0, 1), (0.015, 1), (0.12, 8)])
def test_the_online_process_learns_from_pairs_that_are_apart(spacing_s: float, every: int) -> None:
    layout = layout_of("state")
    process = Counting(layout, (None,))
    flight = track(double_integrator(), PATH, LIMITS, Learner(layout, process, spacing_s))
    assert process.learned == (len(flight.desired) - 1) // every


@pytest.mark.parametrize("window", [0, 50])
@pytest.mark.parametrize("gain", [-2.0, -4.0, -8.0, -50.0])
def test_under_the_guard_a_harmful_prior_costs_at_most_a_tenth(gain: float, window: int) -> None:
    """It asks for the opposite of what the preview shows, up to as much as may be asked for."""

    def harmful(inputs: FloatArray) -> FloatArray:
        return np.asarray(gain * inputs[:, -1])

    robot = double_integrator(noise_std_m=0.001)
    record = flown(noise_std_m=0.001)
    known = Memory(None)
    known.learn(evidence_in(robot.spec, record.references, record.states[:, :, 0]))
    forecast = forecast_of(known.own_model(robot.spec).model, PATH)
    assert forecast is not None
    layout = PREVIEW.model_copy(update={"sample_time_s": 0.015, "horizon_samples": 13})
    guard = guard_for(forecast, robot, fallback=False)
    unguarded = track(robot, PATH, LIMITS, learner(layout, harmful, window=0))
    guarded = track(robot, PATH, LIMITS, learner(layout, harmful, window), guard)
    own = track(robot, PATH, LIMITS)
    assert unguarded.rms_error > 1.2 * own.rms_error
    assert guarded.taken_back is not None
    assert guarded.share[-1] == 0.0
    assert guarded.rms_error <= 1.1 * own.rms_error
    # Nothing the model wished after that has acted: the correction only fades.
    away = np.abs(guarded.reference - guarded.desired)[guarded.taken_back.sample :, 0]
    assert (np.diff(away) <= 1e-12).all()


def test_references_are_held_to_their_bounds_and_marked() -> None:
    def wild(inputs: FloatArray) -> FloatArray:
        return np.full(len(inputs), 1e9)

    flight = track(LaggedRobot(), np.repeat(PATH, 2, axis=1) * 0.5, LIMITS, _two_axes(wild))
    assert flight.limited.all()
    away = np.abs(flight.reference - flight.desired)
    assert away.max() == pytest.approx(LIMITS.correction_max)
    steps = np.abs(np.diff(flight.reference - flight.desired, axis=0)) / 0.02
    assert steps.max() == pytest.approx(LIMITS.correction_speed_max)


def _two_axes(prior: InverseModel | None = None) -> Learner:
    return Learner(PREVIEW, OnlineGp(PREVIEW, (prior, prior)))


def test_a_record_says_everything_of_every_sample() -> None:
    desired = 0.5 * np.repeat(PATH, 2, axis=1)
    seen: list[int] = []
    flight = track(
        LaggedRobot(), desired, LIMITS, _two_axes(), watch=lambda k, d, a, c, s: seen.append(k)
    )
    assert seen == list(range(len(desired)))
    for array in (flight.reference, flight.actual, flight.prior, flight.mean, flight.variance):
        assert array.shape == desired.shape
    assert flight.step_time_s.shape == flight.share.shape == flight.limited.shape == (len(desired),)
    assert (flight.step_time_s > 0).all()
    assert flight.deadline_misses == int((flight.step_time_s > 0.02).sum())
    distance = np.linalg.norm(flight.actual - desired, axis=1)
    assert flight.rms_error == pytest.approx(math.sqrt(np.mean(distance**2)))


def test_the_robot_goes_to_a_start_elsewhere_before_the_path_begins() -> None:
    desired = 0.5 * np.repeat(PATH, 2, axis=1) + 0.4
    robot = LaggedRobot()
    flight = track(robot, desired, LIMITS)
    np.testing.assert_allclose(flight.actual[0], desired[0], atol=1e-9)
    np.testing.assert_allclose(flight.actual[3:], desired[:-3], atol=1e-12)
    assert robot.rests == 1


def test_a_robot_that_fails_on_its_way_leaves_a_record_of_what_it_flew() -> None:
    desired = 0.5 * np.repeat(PATH, 2, axis=1)
    settle = 25
    flight = track(LaggedRobot(fails_at=settle + 60), desired, LIMITS, _two_axes())
    assert (flight.failure, len(flight.actual)) == ("it fell over", 60)
    assert flight.rms_error == math.inf


def test_a_sensor_that_goes_blind_ends_the_flight_at_rest() -> None:
    robot = LaggedRobot(blind_at=25 + 60)
    flight = track(robot, 0.5 * np.repeat(PATH, 2, axis=1), LIMITS, _two_axes())
    assert flight.failure == "the sensor returned a value that is not finite at sample 60"
    assert np.isfinite(flight.reference).all()
    assert robot.rests == 1


class Broken(OnlineGp):
    """Its answer is no number from the 60th sample on."""

    asked = 0

    def correct(self, inputs: FloatArray) -> Correction:
        self.asked += 1
        found = super().correct(inputs)
        return replace(found, mean=found.mean * np.nan) if self.asked > 60 else found


def test_a_reference_that_is_not_finite_never_reaches_the_robot() -> None:
    robot = LaggedRobot()
    broken = Learner(PREVIEW, Broken(PREVIEW, (None, None)))
    flight = track(robot, 0.5 * np.repeat(PATH, 2, axis=1), LIMITS, broken)
    assert flight.failure == "the inverse model asked for a value that is not finite at sample 60"
    assert np.isfinite(flight.reference).all()
    assert robot.samples == 25 + 60
    assert robot.rests == 1


def test_a_flight_that_is_stopped_ends_at_rest() -> None:
    robot, left = LaggedRobot(), iter([False] * 10 + [True])
    flight = track(robot, 0.5 * np.repeat(PATH, 2, axis=1), LIMITS, stopped=lambda: next(left))
    assert (flight.failure, len(flight.actual), robot.rests) == ("stopped", 10, 1)


def test_what_breaks_a_limit_is_refused_before_anything_moves() -> None:
    robot = LaggedRobot()
    flat = np.repeat(PATH, 2, axis=1)
    needy = InverseLayout(
        architecture="state",
        states=("position", "velocity"),
        sample_time_s=0.02,
        horizon_samples=5,
    )
    wrong: list[tuple[FloatArray, Learner | None, Guard | None, str]] = [
        (2 * flat, None, None, "outside the workspace"),
        (PATH, None, None, "one column for each of 2 axes"),
        (flat[:1], None, None, "two different points"),
        (np.where(flat == flat[9], np.nan, flat), None, None, "not finite"),
        (0.5 * flat[::4], None, None, "speed"),
        (0.5 * flat, Learner(needy, OnlineGp(needy, (None, None))), None, "needs the states"),
        (
            0.5 * flat,
            None,
            Guard(flat.T[:1] ** 2, 0.0, 0.02, 2.0, flat, correction_speed_max=1.0),
            "baseline does not need one",
        ),
    ]
    for desired, asked, guard, message in wrong:
        with pytest.raises(InvalidInputError, match=message):
            track(robot, desired, LIMITS, asked, guard)
    assert robot.samples == 0
