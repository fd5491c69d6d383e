"""Predicts, from frequency tests, the tracking error that each source's inverse leaves on paths.

An inverse answers for its own axis. With the inverse of source S on axis j the target's matrix Z_T
leaves e = (I − Z_T D⁻¹) y_d, with D_jj = z_S,jj; without a transfer it leaves (I − Z_T) y_d. The
paths are known, so that their axes' motions count with the phase that they have to each other.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge
from nufleet.orchestrator.belief.resting_gain import draw_resting
from nufleet.orchestrator.study.trajectory_spectrum import cross_power, spectrum_of
from nufleet.orchestrator.study.verdict import GAIN_MIN, error_with_transfer
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.robots.spec import RobotSpec

SAMPLES = 300
GRID_POINTS = 1024

Entries = Mapping[tuple[int, int], ComplexArray]
"""Samples of an error matrix's entries that are not zero, by the columns of the path that they lead
to and from, shape (samples, grid)."""


@dataclass(frozen=True)
class PredictedRms:
    """Predicted root mean square errors, averaged over the paths, in the paths' unit."""

    without: float
    """Error of the target's baseline, without any transfer."""
    of: Mapping[str, float]
    """Error of the target with the inverse of each source that was tested, by source."""
    axes: tuple[str, ...] = ()
    """Axes whose responses were measured; the others are taken to respond like the first."""
    by_axis: float | None = None
    """Error with the inverse of another source on each axis; None where none were named."""


def predict_rms(
    target: str,
    sources: Sequence[str],
    specs: Mapping[str, RobotSpec],
    responses: Mapping[str, Sequence[FrequencyResponse]],
    paths: Sequence[FloatArray],
    rng: np.random.Generator,
    *,
    omega_max_rad_s: float,
    axes: Sequence[str],
    by_axis: Mapping[str, str] | None = None,
) -> PredictedRms:
    """Return the predicted errors; `nufleet.orchestrator.study.verdict` derives the equations.

    The prediction assumes that the inverse is an exact prefilter. Outside the tested band it relies
    on the extrapolation of the response model.

    Args:
        target: Name of the robot that is to fly the paths.
        sources: Names of the robots whose inverse models are compared.
        specs: Specs of target and sources, by robot.
        responses: All usable tests of each robot; the target's play all axes.
        paths: Positions along each path, shape (samples, axes of the target), at its sample time.
        rng: Generator that draws the samples of each response.
        omega_max_rad_s: Upper end of the tested band in rad/s.
        axes: Names of the axes that were compared. The others are taken to respond like the first.
        by_axis: Source of each compared axis; None where one source is as good on all.

    Returns:
        The predicted errors in the paths' unit.
    """
    step_s = specs[target].sample_time_s
    top_rad_s = max(float(spectrum_of(path, step_s).omega_rad_s[-1]) for path in paths)
    omega = np.linspace(0.0, top_rad_s, GRID_POINTS)[1:]
    powers = [_on_grid(*cross_power(path, step_s), omega) for path in paths]
    known = {}
    for robot in (target, *sources):
        one = AxesKnowledge(robot, specs[robot], omega_max_rad_s, axes)
        for response in responses.get(robot, ()):
            one.learn(response, rng, check=False)
        if not one.unseen:
            known[robot] = one
    drawn = {
        robot: {
            axis: draw_resting(own.model, omega, SAMPLES, rng) for axis, own in one.axes.items()
        }
        for robot, one in known.items()
    }
    names = [axis.name for axis in specs[target].axes]
    fleet = _Fleet(names, axes, drawn[target], _across(known[target], names, omega, rng))

    def mean_rms(inverse: Mapping[str, ComplexArray] | None) -> float:
        entries = fleet.errors(inverse)
        # The median is over the samples, because the error that an inverse leaves has no upper
        # bound.
        return float(np.mean([np.median(_rms(entries, power)) for power in powers]))

    chosen = by_axis if by_axis and set(by_axis.values()) <= drawn.keys() else None
    return PredictedRms(
        without=mean_rms(None),
        of={source: mean_rms(drawn[source]) for source in sources if source in drawn},
        axes=tuple(axes),
        by_axis=mean_rms({a: drawn[s][a] for a, s in chosen.items()}) if chosen else None,
    )


@dataclass(frozen=True)
class _Fleet:
    """Samples of how the target answers to each column of a path."""

    names: Sequence[str]
    """Axes of the path's columns."""
    axes: Sequence[str]
    """Axes that were compared."""
    own: Mapping[str, ComplexArray]
    """Samples of each compared axis's response to its own reference, by axis."""
    across: Entries = field(default_factory=dict)
    """Samples of the responses of axes to others."""

    def errors(self, inverse: Mapping[str, ComplexArray] | None) -> Entries:
        """Return the error matrix with the inverses of these responses; None for no inverse."""
        entries = {}
        for place, name in enumerate(self.names):
            axis = name if name in self.axes else self.axes[0]
            z = self.own[axis]
            left = 1 - z if inverse is None else error_with_transfer(inverse[axis], z)
            entries[place, place] = np.asarray(left)
        for (output, reference), z in self.across.items():
            own = None if inverse is None else inverse[self.names[reference]]
            by = 1.0 if own is None else np.where(np.abs(own) > GAIN_MIN, own, GAIN_MIN)
            entries[output, reference] = np.asarray(-z / by)
        return entries


def _across(
    target: AxesKnowledge, names: Sequence[str], omega_rad_s: FloatArray, rng: np.random.Generator
) -> Entries:
    """Return samples of the responses of axes to others, where they exceed the noise."""
    found = {}
    for one in target.couplings:
        model = target.cross(one.output, one.reference)
        if model is not None:
            place = names.index(one.output), names.index(one.reference)
            found[place] = model.draw(omega_rad_s, SAMPLES, rng)
    return found


def _rms(errors: Entries, power: ComplexArray) -> FloatArray:
    """Return root mean square errors, shape (samples,).

    Parseval: the mean square on axis i is Σ_ω Σ_jk E_ij E_ik* S_jk with the axes' cross power S.
    """
    square = np.zeros(len(next(iter(errors.values()))))
    for (output, first), left in errors.items():
        for (again, second), right in errors.items():
            if again == output:
                square += ((left * right.conj()) @ power[:, first, second]).real
    return np.asarray(np.sqrt(np.maximum(square, 0.0)))


def _on_grid(line_rad_s: FloatArray, power: ComplexArray, omega_rad_s: FloatArray) -> ComplexArray:
    """Distribute the power of lines onto a grid, as weights of shape (grid, axes, axes).

    For any function g that is linear between grid points, Σ weight g equals Σ power g.
    """
    places = np.interp(line_rad_s, omega_rad_s, np.arange(len(omega_rad_s)))
    lower = np.minimum(places.astype(np.int64), len(omega_rad_s) - 2)
    above = (places - lower)[:, None, None]
    weights = np.zeros((len(omega_rad_s), *power.shape[1:]), dtype=np.complex128)
    np.add.at(weights, lower, (1 - above) * power)
    np.add.at(weights, lower + 1, above * power)
    return weights
