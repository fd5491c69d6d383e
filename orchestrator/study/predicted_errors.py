"""The tracking error to be expected of every source's inverse on paths, from frequency tests."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

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
    """Root mean square errors, averaged over the paths, in the paths' unit.

    `without` is the target's with its own baseline.
    """

    without: float
    of: Mapping[str, float]


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
    """Return the errors that the responses let expect; see `nufleet.orchestrator.study.verdict`.

    The inverse is taken to be a prefilter that is exact, and the response of the axis that was
    tested to be that of all axes. Where a path moves outside the tested band, the response is what
    the model of it continues to.

    Args:
        target: who is to fly.
        sources: whose inverses.
        specs: of all of them.
        responses: all usable tests of each, at least one.
        paths: each of shape (samples, axes), at the target's sample time.
        rng: draws the samples of what is believed.
        omega_max_rad_s: the upper end of the band that was tested.
    """
    spectra = [spectrum_of(path, specs[target].sample_time_s) for path in paths]
    omega = np.linspace(0.0, max(float(s.omega_rad_s[-1]) for s in spectra), GRID_POINTS)[1:]
    powers = np.stack([_on_grid(spectrum, omega) for spectrum in spectra])
    z = {}
    for robot in (target, *sources):
        known = RobotKnowledge(robot, specs[robot], omega_max_rad_s)
        for response in responses[robot]:
            known.learn(response, rng, check=False)
        z[robot] = known.model.draw(omega, SAMPLES, rng)

    def mean_rms(errors: FloatArray) -> float:
        return float(np.mean(np.median(np.sqrt(errors**2 @ powers.T), axis=0)))

    return PredictedRms(
        without=mean_rms(np.abs(1 - z[target])),
        of={s: mean_rms(np.abs(error_with_transfer(z[s], z[target]))) for s in sources},
    )


def _on_grid(spectrum: Spectrum, omega_rad_s: FloatArray) -> FloatArray:
    """Return weights on a grid: Σ weight g equals Σ power g of any g that is linear in between."""
    places = np.interp(spectrum.omega_rad_s, omega_rad_s, np.arange(len(omega_rad_s)))
    lower = np.minimum(places.astype(np.int64), len(omega_rad_s) - 2)
    above = places - lower
    weights = np.zeros(len(omega_rad_s))
    np.add.at(weights, lower, (1 - above) * spectrum.power)
    np.add.at(weights, lower + 1, above * spectrum.power)
    return weights
