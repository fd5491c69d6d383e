"""Which of many sources may be the closest, from their measured tones alone.

A worst-case distance is a maximum over frequencies, so that a source is at least as far away as at
any of its tones. Where that is enough to tell that it cannot win, its response between the tones
need not be believed anything of: no model is fitted and nothing is drawn, which takes a hundred
times as long.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.orchestrator.study.selection_belief import bounds, lengthened
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance

BoolArray = NDArray[np.bool_]

SIGNIFICANCE = 1e-3
"""Probability that any of the sources which are left out as outrun is the closest."""


@dataclass(frozen=True)
class Screened:
    """What the tones of every source say of its worst-case distance to the target.

    Sample i of a distance comes from the i-th sample of the target's response, as sample i of a
    belief does.
    """

    sources: tuple[str, ...]
    """Names of the sources."""
    largest: FloatArray
    """Largest distance at the tones of each source, shape (sources, samples)."""
    of_means: FloatArray
    """The same of the measured responses and of the target's mean, shape (sources,)."""
    largest_rad_s: FloatArray
    """The tone of the latter in rad/s, shape (sources,)."""

    @staticmethod
    def of(
        omega_rad_s: FloatArray,
        target: ComplexArray,
        known: Mapping[str, Tones],
        rng: np.random.Generator,
    ) -> Screened:
        """Draw the distances of sources at their tones.

        Args:
            omega_rad_s: Frequencies of the target's samples in rad/s, rising, shape (grid,).
            target: Samples of the target's response there, shape (samples, grid).
            known: Measured tones of each source on the axis, by source.
            rng: Generator that draws the errors of the measurements.
        """
        count = len(known)
        largest, of_means = np.zeros((count, len(target))), np.zeros(count)
        largest_rad_s = np.full(count, omega_rad_s[0])
        for n, tones in enumerate(known.values()):
            inside = (tones.omega_rad_s >= omega_rad_s[0]) & (tones.omega_rad_s <= omega_rad_s[-1])
            if not inside.any():
                continue
            omega, z, variance = (
                one[inside] for one in (tones.omega_rad_s, tones.z, tones.variance)
            )
            at_tones = _between(omega_rad_s, target, omega)
            error = rng.standard_normal((2, len(target), len(z))) * np.sqrt(variance / 2)
            drawn = chordal_distance(at_tones, z + error[0] + 1j * error[1])
            largest[n] = drawn.max(axis=1)
            means = chordal_distance(at_tones.mean(axis=0), z)
            most = int(np.argmax(means))
            of_means[n], largest_rad_s[n] = means[most], omega[most]
        return Screened(tuple(known), largest, of_means, largest_rad_s)

    @cached_property
    def _lengthened(self) -> FloatArray:
        return lengthened(self.largest, self.of_means)

    @cached_property
    def loss(self) -> FloatArray:
        """What a source's loss is at least, as in `SelectionBelief`, shape (sources, samples)."""
        return np.asarray(self.largest - self._lengthened[:, None])

    def ahead(self, limit: FloatArray) -> FloatArray:
        """Return the probability that the loss of each source is below a limit, shape (sources,).

        Args:
            limit: Samples of the limit, shape (samples,).
        """
        return np.asarray(np.mean(self.loss < limit, axis=1))

    def outrun(self, loss: FloatArray) -> BoolArray:
        """Return whether each source is surely further away than a certain one, shape (sources,).

        It is so in every sample, and by more than the deviation of its lag allows.

        Args:
            loss: Samples of the loss of that one, shape (samples,).
        """
        behind = self.loss - loss
        needed = -float(ndtri(SIGNIFICANCE / len(self.sources))) * behind.std(axis=1)
        return np.asarray((behind.min(axis=1) > 0.0) & (behind.mean(axis=1) > needed))

    def estimate(self, n: int, tests: int) -> SourceEstimate:
        """Return what is known of a source from its tones: how far away it is at least.

        Args:
            n: Place of the source.
            tests: Number of its tests.
        """
        low, median, _ = bounds(self.largest[n], float(self._lengthened[n]))
        return SourceEstimate(
            robot=self.sources[n],
            psi=median,
            psi_low=low,
            psi_high=1.0,
            omega_rad_s=float(self.largest_rad_s[n]),
            tests=tests,
        )

    def reason(self, n: int, leader: str, loss: FloatArray) -> str:
        """Return in words why a source was outrun.

        Args:
            n: Place of the source.
            leader: Name of the source that is ahead of it.
            loss: Samples of the loss of that one, shape (samples,).
        """
        behind = float(np.mean(self.loss[n] - loss))
        return (
            f"its tones alone put it {behind:.3f} or more behind {leader}, so that nothing else of "
            "it was compared"
        )


def _between(grid_rad_s: FloatArray, z: ComplexArray, omega_rad_s: FloatArray) -> ComplexArray:
    """Return samples of a response between the frequencies of a grid, shape (samples, tones)."""
    after = np.searchsorted(grid_rad_s, omega_rad_s).clip(1, len(grid_rad_s) - 1)
    low, high = grid_rad_s[after - 1], grid_rad_s[after]
    share = (omega_rad_s - low) / (high - low)
    return np.asarray(z[:, after - 1] * (1.0 - share) + z[:, after] * share)
