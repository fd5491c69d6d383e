"""A robot's model of itself weighs what its motions show, and tells friction from a change."""

from __future__ import annotations

import numpy as np
import pytest
from robots_that_learn import LaggedRobot, double_integrator
from scipy.signal import lfilter

from nufleet.robot_agent.flight.forecast import forecast_of
from nufleet.robot_agent.flight.own_model import AxisRecord, basis_of, evidence_in, settle
from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.error_belief import believe

SPEC = LaggedRobot().spec
TIME_S = np.arange(1000) * SPEC.sample_time_s
HELD_M = 0.01
"""How far off friction holds the axis."""


def waves(size_m: float, seed: int) -> FloatArray:
    """References of the axis x alone, from rest to rest, of a root mean square size."""
    rng = np.random.default_rng(seed)
    tones = [np.sin(rng.uniform(0.5, 5.0) * TIME_S + rng.uniform(0, 6.0)) for _ in range(6)]
    faded = np.sum(tones, axis=0) * np.minimum(1.0, np.minimum(TIME_S, TIME_S[::-1]) / 2.0)
    return np.stack([faded * size_m / np.std(faded), np.zeros_like(faded)], axis=1)


def worn(references: FloatArray) -> FloatArray:
    """The axis x lags by 60 ms, and follows only what pulls it by more than friction holds."""
    late = np.concatenate([np.zeros(3), references[:-3, 0]])
    place, places = 0.0, []
    for wanted in late:
        place = float(np.clip(place, wanted - HELD_M, wanted + HELD_M))
        places.append(place)
    noise = 2e-4 * np.random.default_rng(0).standard_normal(len(places))
    return np.stack([places + noise, np.zeros(len(places))], axis=1)


def record(references: FloatArray, outputs: FloatArray) -> AxisRecord:
    return AxisRecord(new=evidence_in(SPEC, references, outputs)["x"])


def test_a_robot_with_friction_has_not_changed_because_it_moves_more() -> None:
    small, large = waves(0.02, 1), waves(0.4, 2)
    tested = settle({"x": record(small, worn(small))}, SPEC)
    new = evidence_in(SPEC, large, worn(large))["x"]
    flown = settle({"x": tested.records["x"].with_new(new)}, SPEC)
    assert flown.findings == ()
    assert flown.model is not None
    assert flown.model.axes[0].flown_s == pytest.approx(2 * len(TIME_S) * SPEC.sample_time_s)


@pytest.mark.parametrize("size", [1.0, 1.4, 2.0, 4.0, 16.0])
def test_many_tones_at_once_do_not_hide_friction(size: float) -> None:
    """Though most of its distortion falls on other tones, which a linear answer explains as well.

    Whatever the test's size, in multiples of what friction holds the axis by.
    """
    tones = np.sin(np.outer(TIME_S[:600], 0.52 * np.arange(1, 12)) + np.arange(1, 12) ** 2)
    test = np.zeros((600, 2))
    test[:, 0] = tones.sum(axis=1) * np.minimum(1.0, np.minimum(TIME_S[:600], TIME_S[599::-1]))
    test *= size * HELD_M / float(np.std(test[:, 0]))
    path = waves(0.3, 3)
    known = forecast_of(settle({"x": record(test, worn(test))}, SPEC).model, path)
    assert known is not None
    assert known.baseline.low < 1.1 * float(np.std((worn(path) - path)[:, 0]))


def test_a_robot_with_friction_flies_with_its_model_once_it_has_moved_as_far_as_the_path() -> None:
    small, large = waves(0.008, 1), waves(0.4, 2)
    path = waves(0.3, 3)
    error = float(np.std((worn(path) - path)[:, 0]))
    tested = settle({"x": record(small, worn(small))}, SPEC)
    vague = forecast_of(tested.model, path)
    assert vague is not None
    assert not vague.own_helps
    assert vague.baseline.low < 1.1 * error
    new = evidence_in(SPEC, large, worn(large))["x"]
    flown = settle({"x": tested.records["x"].with_new(new)}, SPEC)
    known = forecast_of(flown.model, path)
    assert known is not None
    assert known.own_helps
    assert known.baseline.low < 1.1 * error


@pytest.mark.parametrize("noise_std_m", [0.0, 1e-3])
def test_a_robot_with_one_axis_whose_tests_show_it_linear_knows_its_error(
    noise_std_m: float,
) -> None:
    """No other axis can act on it, and what its tests hide cannot become much on a larger path."""
    robot = double_integrator(noise_std_m=noise_std_m)
    small, path = waves(0.15, 1)[:, :1], waves(0.4, 3)[:, :1]
    new = evidence_in(robot.spec, small, robot.run(small))["x"]
    robot.rest()
    known = forecast_of(settle({"x": AxisRecord(new=new)}, robot.spec).model, path)
    assert known is not None
    assert known.own_helps
    assert known.baseline.high < 1.1 * known.baseline.low
    error = float(np.sqrt(np.mean((robot.run(path) - path) ** 2)))
    assert known.baseline.low < 1.001 * error
    assert error < 1.001 * known.baseline.high


def test_a_robot_that_is_pushed_about_has_not_changed_by_the_next_flight() -> None:
    kept = AxisRecord()
    for seed in range(3):
        wanted = waves(0.4, seed)
        late = np.concatenate([np.zeros((3, 2)), wanted[:-3]])
        late[:, 0] += pushed(seed, 0.01 * (1 + 2 * seed))
        kept = kept.with_new(evidence_in(SPEC, wanted, late)["x"])
        found = settle({"x": kept}, SPEC)
        assert found.findings == ()
        kept = found.records["x"]


def pushed(seed: int, size_m: float) -> FloatArray:
    """A disturbance with a time constant of 1 s."""
    white = np.random.default_rng(seed).standard_normal(len(TIME_S) + 500)
    return np.asarray(size_m * np.sqrt(1 - 0.98**2) * lfilter([1.0], [1.0, -0.98], white)[500:])


def test_what_lasts_is_not_learned_as_an_answer_at_rest() -> None:
    """A robot that slow gusts push about knows how little it knows of its answer to slow motions.

    If gusts counted as noise that is new at each sample, it would be sure of a wrong gain at rest,
    by which it misses the far end of a path.
    """
    missed = []
    for seed in range(12):
        wanted = waves(0.3, seed)
        late = np.concatenate([np.zeros((3, 2)), wanted[:-3]])
        late[:, 0] += pushed(seed, 0.01) + 2e-3 * np.random.default_rng(seed).standard_normal(1000)
        belief = believe(basis_of(SPEC), evidence_in(SPEC, wanted, late)["x"])
        z, variance = belief.response(np.array([0.2]))
        exact = np.exp(-0.2j * 3 * SPEC.sample_time_s)
        missed.append(abs(z[0] - exact) ** 2 / variance[0])
    assert np.mean(missed) < 4.0
