"""Spectra of trajectories."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.orchestrator.study.trajectory_spectrum import Spectrum, spectrum_of
from nufleet.shared.errors import InvalidInputError


@given(periods=st.integers(1, 40), amplitude=st.floats(0.01, 10.0), offset=st.floats(-5, 5))
def test_a_sinusoid_has_half_its_squared_amplitude_at_its_frequency(
    periods: int, amplitude: float, offset: float
) -> None:
    times_s = np.arange(1000) * 0.02
    omega = 2 * np.pi * periods / 20.0
    found = spectrum_of(offset + amplitude * np.cos(omega * times_s), 0.02)
    at = np.argmin(np.abs(found.omega_rad_s - omega))
    assert found.power.sum() == pytest.approx(amplitude**2 / 2, rel=0.02)
    assert found.power[max(at - 1, 0) : at + 2].sum() > 0.95 * found.power.sum()


@given(samples=st.integers(4, 3000), seed=st.integers(0, 99))
def test_a_closed_trajectorys_power_is_its_mean_square(samples: int, seed: int) -> None:
    rng = np.random.default_rng(seed)
    positions = rng.standard_normal((samples, 2))
    positions[-1] = positions[0]
    found = spectrum_of(positions, 0.01)
    power = float(np.var(positions, axis=0).sum())
    if samples % 2 == 0:
        # At the Nyquist frequency of an even number of samples, a line counts twice.
        signs = np.where(np.arange(samples) % 2, -1.0, 1.0)
        power += float(np.sum((signs @ positions / samples) ** 2))
    assert found.power.sum() == pytest.approx(power)
    assert np.all(np.diff(found.omega_rad_s) > 0)


@pytest.mark.parametrize("lines", [range(2, 12), (2, 3, 4, 5, 2600)])
@pytest.mark.parametrize("repeated", [0, 1])
def test_a_closed_drawing_has_the_lines_of_its_laps(lines: Sequence[int], repeated: int) -> None:
    """Neither a ramp nor joined lines blur what is slow, where robots may have resonances."""
    order = np.array(lines)
    angle = 2 * np.pi * np.arange(6000 + repeated) / 6000
    found = spectrum_of(np.sin(np.outer(angle, order)) @ (1 / order), 0.02)
    at = np.searchsorted(found.omega_rad_s, (order[:4] - 0.25) * 2 * np.pi / 120.0)
    np.testing.assert_allclose(found.omega_rad_s[at], order[:4] * 2 * np.pi / 120.0, rtol=1e-3)
    np.testing.assert_allclose(found.power[at], 0.5 / order[:4] ** 2, rtol=0.02)


def test_what_lies_outside_a_band_is_counted_as_motion() -> None:
    spectrum = Spectrum(np.array([1.0, 10.0]), np.array([1.0, 0.01]))
    below, above = spectrum.outside((0.5, 5.0))
    assert below == 0.0
    assert above == pytest.approx(0.5)


@pytest.mark.parametrize(
    "positions",
    [
        np.zeros(100),
        np.linspace(0.0, 1.0, 100),
        np.array([0.0, 1.0, 0.0]),
        np.array([0.0, 1.0, np.nan, 0.0, 1.0]),
        np.zeros((4, 4, 4)),
    ],
    ids=["still", "straight", "short", "not finite", "of a wrong shape"],
)
def test_what_is_no_trajectory_is_refused(positions: np.ndarray) -> None:
    with pytest.raises(InvalidInputError, match="trajectory"):
        spectrum_of(positions, 0.02)
