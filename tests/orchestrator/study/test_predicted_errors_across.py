"""Errors predicted for paths of coupled axes, compared with the closed form of the matrices."""

from __future__ import annotations

import numpy as np
import pytest
from loops_on_axes import AXES, Loops, answer, spec_of
from random_loops import BAND, Loop

from nufleet.orchestrator.study.predicted_errors import PredictedRms, predict_rms
from nufleet.orchestrator.study.tone_choice import first_look
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

SHARE = 0.3
"""Share of its own response with which each axis of the target answers to the other."""

ROBOTS: dict[str, Loops] = {
    "target": {"x": Loop(3.0), "y": Loop(3.5)},
    "like-x": {"x": Loop(3.0), "y": Loop(2.2)},
    "like-y": {"x": Loop(4.6), "y": Loop(3.5)},
}
SPEC = spec_of()
PERIOD_S = 40.0
LINES = np.array([4, 9, 15])
LARGE = np.array([0.5, 0.2, 0.1])
OMEGA = 2 * np.pi * LINES / PERIOD_S


def path(lag_rad: float) -> FloatArray:
    """A closed path whose y lags behind its x by a phase."""
    phases = np.outer(np.arange(0.0, PERIOD_S, SPEC.sample_time_s), OMEGA)
    return np.stack([np.sin(phases) @ LARGE, np.sin(phases - lag_rad) @ LARGE], axis=1)


def expected(inverses: tuple[str, str] | None, lag_rad: float, share: float) -> float:
    """The root mean square of (I − Z_T D⁻¹) Y, with the sources of x and y, or of (I − Z_T) Y."""
    z = np.stack([ROBOTS["target"][axis].z(OMEGA) for axis in AXES], axis=1)
    matrix: ComplexArray = z[:, :, None] * np.where(np.eye(2, dtype=bool), 1.0, share)
    if inverses is not None:
        own = [ROBOTS[source][axis].z(OMEGA) for source, axis in zip(inverses, AXES, strict=True)]
        matrix = matrix / np.stack(own, axis=1)[:, None, :]
    moved = np.stack([LARGE, LARGE * np.exp(-1j * lag_rad)], axis=1)
    left = moved - np.einsum("kij,kj->ki", matrix, moved)
    return float(np.sqrt(np.sum(np.abs(left) ** 2) / 2))


def measured(robot: str, share: float) -> list[FrequencyResponse]:
    rng = np.random.default_rng(0)
    tests = [first_look(BAND, SPEC, 44, 0.7, turn) for turn in ((0, 1), (1, 0))]
    loops = ROBOTS[robot]
    return [answer(loops, test.excitation(*AXES), 1e-3, rng, share) for test in tests]


def predicted(lag_rad: float, share: float) -> PredictedRms:
    responses = {robot: measured(robot, share if robot == "target" else 0.0) for robot in ROBOTS}
    return predict_rms(
        "target",
        ("like-x", "like-y"),
        dict.fromkeys(ROBOTS, SPEC),
        responses,
        [path(lag_rad)],
        np.random.default_rng(0),
        omega_max_rad_s=BAND[1],
        axes=AXES,
        by_axis={"x": "like-x", "y": "like-y"},
    )


@pytest.mark.parametrize(
    ("lag_rad", "share"), [(0.0, SHARE), (np.pi / 2, SHARE), (-np.pi / 2, SHARE), (0.0, 0.0)]
)
def test_errors_add_up_over_axes_with_coupling_and_the_phase_between_motions(
    lag_rad: float, share: float
) -> None:
    found = predicted(lag_rad, share)
    assert found.axes == AXES
    close = {"rel": 0.04, "abs": 0.004}
    assert found.without == pytest.approx(expected(None, lag_rad, share), **close)
    for source, error in found.of.items():
        assert error == pytest.approx(expected((source, source), lag_rad, share), **close)
    each = expected(("like-x", "like-y"), lag_rad, share)
    assert found.by_axis == pytest.approx(each, **close)


def test_a_source_that_was_not_tested_on_all_axes_is_left_out() -> None:
    responses = {robot: measured(robot, 0.0) for robot in ("target", "like-x")}
    found = predict_rms(
        "target",
        ("like-x", "like-y"),
        dict.fromkeys(ROBOTS, SPEC),
        responses,
        [path(0.0)],
        np.random.default_rng(0),
        omega_max_rad_s=BAND[1],
        axes=AXES,
        by_axis={"x": "like-x", "y": "like-y"},
    )
    assert set(found.of) == {"like-x"}
    assert found.by_axis is None
