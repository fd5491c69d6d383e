"""Predicts, from frequency tests, the tracking error that each source's inverse leaves on paths."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.belief.resting_gain import draw_resting
from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.orchestrator.study.trajectory_spectrum import Spectrum, spectrum_of
from nufleet.orchestrator.study.verdict import error_with_transfer
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.robots.spec import RobotSpec

SAMPLES = 300
GRID_POINTS = 1024


@dataclass(frozen=True)
class PredictedRms:
    """Predicted root mean square errors, averaged over the paths, in the paths' unit."""

    without: float
    """Error of the target's baseline, without any transfer."""
    of: Mapping[str, float]
    """Error of the target with the inverse of each source, by source."""


def predict_rms(
    target: str,
    sources: Sequence[str],
    specs: Mapping[str, RobotSpec],
    responses: Mapping[str, Sequence[FrequencyResponse]],
    paths: Sequence[FloatArray],
    rng: np.random.Generator,
    *,
    omega_max_rad_s: float,
) -> PredictedRms:
    """Return the predicted errors; `nufleet.orchestrator.study.verdict` derives the equations.

    The prediction assumes that the inverse is an exact prefilter, and that all axes respond like
    the tested one. Outside the tested band it relies on the extrapolation of the response model.

    Args:
        target: Name of the robot that is to fly the paths.
        sources: Names of the robots whose inverse models are compared.
        specs: Specs of target and sources, by robot.
        responses: All usable tests of each robot, at least one per robot.
        paths: Positions along each path, shape (samples, axes), at the target's sample time.
        rng: Generator that draws the samples of each response.
        omega_max_rad_s: Upper end of the tested band in rad/s.

    Returns:
        The predicted errors in the paths' unit.
    """
    spectra = [spectrum_of(path, specs[target].sample_time_s) for path in paths]
    omega = np.linspace(0.0, max(float(s.omega_rad_s[-1]) for s in spectra), GRID_POINTS)[1:]
    powers = np.stack([_on_grid(spectrum, omega) for spectrum in spectra])
    z = {}
    for robot in (target, *sources):
        known = RobotKnowledge(robot, specs[robot], omega_max_rad_s)
        for response in responses[robot]:
            known.learn(response, rng, check=False)
        z[robot] = draw_resting(known.model, omega, SAMPLES, rng)

    def mean_rms(errors: FloatArray) -> float:
        # Parseval: the mean square error on a path is Σ_ω |error gain|² power. `errors` has shape
        # (samples, frequencies), `powers` (paths, frequencies); the median is over the samples,
        # because the error that an inverse leaves has no upper bound.
        return float(np.mean(np.median(np.sqrt(errors**2 @ powers.T), axis=0)))

    return PredictedRms(
        without=mean_rms(np.abs(1 - z[target])),
        of={s: mean_rms(np.abs(error_with_transfer(z[s], z[target]))) for s in sources},
    )


def _on_grid(spectrum: Spectrum, omega_rad_s: FloatArray) -> FloatArray:
    """Distribute a spectrum's power onto a grid, as weights of shape (grid,).

    For any function g that is linear between grid points, Σ weight g equals Σ power g.
    """
    places = np.interp(spectrum.omega_rad_s, omega_rad_s, np.arange(len(omega_rad_s)))
    lower = np.minimum(places.astype(np.int64), len(omega_rad_s) - 2)
    above = places - lower
    weights = np.zeros(len(omega_rad_s))
    np.add.at(weights, lower, (1 - above) * spectrum.power)
    np.add.at(weights, lower + 1, above * spectrum.power)
    return weights
