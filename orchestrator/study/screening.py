"""Which of many sources are surely not the closest, from their measured tones alone.

A worst-case distance is a maximum over frequencies, so that a source is at least as far away as at
any of its tones. Where that is enough to tell that it cannot win, its response between the tones
need not be believed anything of: no model is fitted and nothing is drawn, which takes a thousand
times as long.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance

BoolArray = NDArray[np.bool_]

SIGNIFICANCE = 1e-3
"""Probability that any of the sources which are left out as outrun is the closest."""


@dataclass(frozen=True)
class Screened:
    """What the tones of every source say of its worst-case distance to the target.

    Sample i of a bound comes from the i-th sample of the target's response, as sample i of a belief
    does.
    """

    sources: tuple[str, ...]
    """Names of the sources."""
    at_least: FloatArray
    """Lower bound of each source's ψ*, shape (sources, samples)."""
    measured: FloatArray
    """Median of the largest distance at a tone, shape (sources,)."""
    measured_rad_s: FloatArray
    """The tone of that distance in rad/s, shape (sources,)."""

    @staticmethod
    def of(omega_rad_s: FloatArray, target: ComplexArray, known: Mapping[str, Tones]) -> Screened:
        """Bound the distances of sources from samples of the target's response.

        By the triangle inequality, ψ(z_target, z) ≥ ψ(z_target, ẑ) − ψ(ẑ, z), and ψ(ẑ, z) is at
        most |ẑ − z| / √(1 + |ẑ|²). The errors are circular normal, so that |ẑ − z|² exceeds
        −ln(p) E|ẑ − z|² with the probability p, which is shared out among all tones (Bonferroni).

        Args:
            omega_rad_s: Frequencies of the target's samples in rad/s, rising, shape (grid,).
            target: Samples of the target's response there, shape (samples, grid).
            known: Measured tones of each source on the axis, by source.
        """
        count = len(known)
        at_least, measured = np.zeros((count, len(target))), np.zeros(count)
        measured_rad_s = np.full(count, omega_rad_s[0])
        spread = math.log(sum(len(tones.z) for tones in known.values()) / SIGNIFICANCE)
        for n, tones in enumerate(known.values()):
            inside = (tones.omega_rad_s >= omega_rad_s[0]) & (tones.omega_rad_s <= omega_rad_s[-1])
            if not inside.any():
                continue
            omega, z, variance = (
                one[inside] for one in (tones.omega_rad_s, tones.z, tones.variance)
            )
            psi = chordal_distance(_between(omega_rad_s, target, omega), z)
            error = np.sqrt(spread * variance / (1.0 + np.abs(z) ** 2))
            at_least[n] = np.max(psi - error, axis=1, initial=0.0)
            medians = np.median(psi, axis=0)
            most = int(np.argmax(medians))
            measured[n], measured_rad_s[n] = medians[most], omega[most]
        return Screened(tuple(known), at_least, measured, measured_rad_s)

    @property
    def order(self) -> list[int]:
        """Places of the sources, by rising lower bound."""
        return [int(n) for n in np.argsort(self.at_least.mean(axis=1), kind="stable")]

    def outrun(self, psi_star: FloatArray) -> BoolArray:
        """Return whether each source is surely further away than a certain one, shape (sources,).

        Args:
            psi_star: Samples of the worst-case distance of that one, shape (samples,).
        """
        return surely_behind(self.at_least, psi_star, len(self.sources))

    def estimate(self, n: int, tests: int) -> SourceEstimate:
        """Return what is known of a source that was outrun: how far away it is at least.

        Args:
            n: Place of the source.
            tests: Number of its tests.
        """
        low = float(np.quantile(self.at_least[n], 0.025))
        return SourceEstimate(
            robot=self.sources[n],
            psi=float(self.measured[n]),
            psi_low=low,
            psi_high=1.0,
            omega_rad_s=float(self.measured_rad_s[n]),
            tests=tests,
        )

    def reason(self, n: int, leader: str, psi_star: FloatArray) -> str:
        """Return in words why a source was outrun.

        Args:
            n: Place of the source.
            leader: Name of the source that is ahead of it.
            psi_star: Samples of the worst-case distance of that one, shape (samples,).
        """
        behind = float(np.mean(self.at_least[n] - psi_star))
        return (
            f"its tones alone put it {behind:.3f} or more behind {leader}, so that nothing else of "
            "it was compared"
        )


def surely_behind(distances: FloatArray, psi_star: FloatArray, among: int) -> BoolArray:
    """Return whether each of some sources is surely further away than a certain one.

    It is so in every sample, and by more than the deviation of its lag allows, shape (sources,).

    Args:
        distances: Samples of each source's worst-case distance, or of a bound below it, shape
            (sources, samples).
        psi_star: Samples of the worst-case distance of that one, shape (samples,).
        among: Number of sources of which none may be left out wrongly.
    """
    behind = distances - psi_star
    needed = -float(ndtri(SIGNIFICANCE / among)) * behind.std(axis=1)
    return np.asarray((behind.min(axis=1) > 0.0) & (behind.mean(axis=1) > needed))


def _between(grid_rad_s: FloatArray, z: ComplexArray, omega_rad_s: FloatArray) -> ComplexArray:
    """Return samples of a response between the frequencies of a grid, shape (samples, tones)."""
    after = np.searchsorted(grid_rad_s, omega_rad_s).clip(1, len(grid_rad_s) - 1)
    low, high = grid_rad_s[after - 1], grid_rad_s[after]
    share = (omega_rad_s - low) / (high - low)
    return np.asarray(z[:, after - 1] * (1.0 - share) + z[:, after] * share)
