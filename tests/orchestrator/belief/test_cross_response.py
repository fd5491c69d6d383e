"""What is believed of how one axis answers to another, between and beyond its tones."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.orchestrator.belief.cross_response import CrossModel
from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.sims.coupled_loops import CoupledLoopsSettings, closed_loops

GRID = np.linspace(0.3, 8.0, 60)


def true_z(omega_rad_s: FloatArray, coupling: float) -> ComplexArray:
    settings = CoupledLoopsSettings(
        natural_frequency_rad_s=(4.0, 5.0), damping_ratio=(0.7, 0.6), coupling=(coupling,)
    )
    z: ComplexArray = closed_loops(settings).graph(omega_rad_s)[:, 2, 1]
    return z


@pytest.mark.parametrize("coupling", [0.0, 0.05, 0.15])
def test_its_intervals_hold_the_response_where_nothing_was_measured(coupling: float) -> None:
    tones_rad_s, inside = np.linspace(0.4, 7.6, 9), []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        error = 0.004 * rng.standard_normal((2, 9)) / np.sqrt(2)
        z = true_z(tones_rad_s, coupling) + error[0] + 1j * error[1]
        model = CrossModel(Tones(tones_rad_s, z, np.full(9, 0.004**2)), 8.0)
        samples = model.draw(GRID, 300, rng).real
        low, high = np.quantile(samples, [0.025, 0.975], axis=0)
        truth = true_z(GRID, coupling).real
        inside.append(np.mean((low - 1e-3 <= truth) & (truth <= high + 1e-3)))
    assert np.mean(inside) > 0.9


def test_axes_that_are_not_coupled_are_believed_to_be_so() -> None:
    rng = np.random.default_rng(0)
    error = 0.004 * rng.standard_normal((2, 9)) / np.sqrt(2)
    tones = Tones(np.linspace(0.4, 7.6, 9), error[0] + 1j * error[1], np.full(9, 0.004**2))
    samples = CrossModel(tones, 8.0).draw(GRID, 300, rng)
    assert np.quantile(np.abs(samples), 0.95) < 0.01
