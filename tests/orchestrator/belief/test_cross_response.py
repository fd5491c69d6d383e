"""What is believed of how one axis answers to another, between and beyond its tones."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.orchestrator.belief.cross_response import CrossModel
from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.sims.coupled_loops import CoupledLoopsSettings, closed_loops

GRID = np.linspace(0.3, 8.0, 60)
OMEGA_MAX = 8.0


class Robot:
    """Coupled loops whose responses are known."""

    def __init__(
        self,
        natural_frequency_rad_s: tuple[float, ...],
        damping_ratio: tuple[float, ...],
        coupling: tuple[float, ...],
    ) -> None:
        self.axes = len(damping_ratio)
        settings = CoupledLoopsSettings(
            natural_frequency_rad_s=natural_frequency_rad_s,
            damping_ratio=damping_ratio,
            coupling=coupling,
            axes=("x", "y", "z", "w")[: self.axes],
        )
        self._model = closed_loops(settings)

    def z(self, omega_rad_s: FloatArray, output: int, reference: int) -> ComplexArray:
        """Return the true response of one axis to another."""
        return np.asarray(self._model.graph(omega_rad_s)[:, self.axes + output, reference])

    def tones(self, omega_rad_s: FloatArray, noise: float, rng: np.random.Generator) -> Tones:
        """Return what a test measures of the response of the first axis to the second."""
        error = noise * rng.standard_normal((2, len(omega_rad_s))) / np.sqrt(2)
        z = self.z(omega_rad_s, 0, 1) + error[0] + 1j * error[1]
        return Tones(omega_rad_s, z, np.full(len(omega_rad_s), noise**2))

    def believed(self, tones: Tones) -> CrossModel:
        """Return the belief about that response, with both axes' own responses known."""
        return CrossModel(tones, OMEGA_MAX, lambda w: self.z(w, 0, 0) * self.z(w, 1, 1))


def random_robot(axes: int, rng: np.random.Generator) -> Robot:
    """Return loops with narrow resonances."""
    return Robot(
        tuple(rng.uniform(2.5, 5.0, axes).tolist()),
        tuple(rng.uniform(0.1, 0.3, axes).tolist()),
        tuple(rng.uniform(-0.2, 0.2, axes * (axes - 1) // 2).tolist()),
    )


def regions(samples: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    """Return centre and radius of the 95 % regions of samples, each of shape (frequencies,)."""
    centre = samples.mean(axis=0)
    return centre, np.quantile(np.abs(samples - centre), 0.95, axis=0)


def test_its_regions_hold_the_response_between_few_tones_and_are_narrow() -> None:
    # Without the shape of the axes' own responses, 89 % lie inside radii of 0.2 on average.
    rng = np.random.default_rng(7)
    inside, radii = [], []
    for number in range(45):
        axes = 2 + number % 3
        robot = random_robot(axes, rng)
        first, count = int(rng.integers(axes)), int(rng.integers(3 * axes - 1, 5 * axes))
        tones_rad_s = np.linspace(0.4, 7.7, count)[first::axes]
        samples = robot.believed(robot.tones(tones_rad_s, 0.005, rng)).draw(GRID, 300, rng)
        centre, radius = regions(samples)
        inside.append(np.abs(robot.z(GRID, 0, 1) - centre) <= radius + 2e-4)
        radii.append(radius)
    assert 0.93 <= np.mean(inside) < 0.995
    assert np.mean(radii) < 0.1


@pytest.mark.parametrize("coupling", [0.0, 0.05, 0.15])
def test_its_intervals_hold_the_response_where_nothing_was_measured(coupling: float) -> None:
    robot = Robot((4.0, 5.0), (0.7, 0.6), (coupling,))
    truth, inside = robot.z(GRID, 0, 1).real, []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        tones = robot.tones(np.linspace(0.4, 7.6, 9), 0.004, rng)
        samples = robot.believed(tones).draw(GRID, 300, rng).real
        low, high = np.quantile(samples, [0.025, 0.975], axis=0)
        inside.append(np.mean((low - 1e-3 <= truth) & (truth <= high + 1e-3)))
    assert np.mean(inside) > 0.9


def test_axes_that_are_not_coupled_are_believed_to_be_so() -> None:
    rng, robot = np.random.default_rng(0), Robot((4.0, 5.0), (0.7, 0.6), (0.0,))
    tones = robot.tones(np.linspace(0.4, 7.6, 9), 0.004, rng)
    samples = robot.believed(tones).draw(GRID, 300, rng)
    assert np.quantile(np.abs(samples), 0.95) < 0.01


def test_axes_that_are_coupled_in_another_way_are_believed_to_be_so() -> None:
    # A share of what the moving axis does, which no force between loops gives.
    rng, robot = np.random.default_rng(0), Robot((3.0, 6.0), (0.3, 0.6), (0.0,))
    tones_rad_s = np.linspace(0.4, 7.6, 7)
    measured = Tones(tones_rad_s, 0.3 * robot.z(tones_rad_s, 1, 1), np.full(7, 0.002**2))
    centre, radius = regions(robot.believed(measured).draw(GRID, 300, rng))
    assert np.mean(np.abs(0.3 * robot.z(GRID, 1, 1) - centre) <= radius + 2e-4) > 0.93
    assert np.mean(radius) < 0.1
