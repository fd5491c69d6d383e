"""Intervals for a distance that cannot be negative."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.orchestrator.gap.chordal_band import chordal_band
from nufleet.shared.arrays import ComplexArray
from nufleet.shared.distance.chordal import chordal_distance


def around(z: complex, deviation: float, count: int, rng: np.random.Generator) -> ComplexArray:
    noise = rng.standard_normal((2, count, 1)) * deviation / np.sqrt(2)
    return np.asarray(z + noise[0] + 1j * noise[1])


@pytest.mark.parametrize("distance", [0.0, 0.01, 0.03, 0.1, 0.5])
def test_the_interval_holds_the_distance_as_often_as_it_says(distance: float) -> None:
    rng = np.random.default_rng([int(1e3 * distance)])
    z_1, z_2 = 0.8 - 0.4j, 0.8 - 0.4j + distance
    truth = float(chordal_distance(np.array([z_1]), np.array([z_2]))[0])
    held = 0
    for _ in range(400):
        # Means are themselves off by what the samples say they may be off.
        seen_1, seen_2 = (complex(around(z, 0.02, 1, rng)[0, 0]) for z in (z_1, z_2))
        low, high = chordal_band(around(seen_1, 0.02, 400, rng), around(seen_2, 0.02, 400, rng))
        held += int(low[0] <= truth <= high[0])
    assert 0.92 <= held / 400 <= 1.0


def test_the_same_robot_twice_may_be_at_distance_zero() -> None:
    rng = np.random.default_rng(0)
    low, high = chordal_band(around(1.0, 0.02, 500, rng), around(1.0, 0.02, 500, rng))
    assert low[0] == 0.0
    assert 0.0 < high[0] < 0.05


def test_bounds_stay_between_zero_and_one_at_the_poles_of_the_sphere() -> None:
    rng = np.random.default_rng(0)
    low, high = chordal_band(around(1e9, 1e8, 500, rng), around(0.0, 1e-9, 500, rng))
    assert 0.99 < low[0] <= high[0] <= 1.0
