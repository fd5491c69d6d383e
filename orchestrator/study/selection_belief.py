"""The belief about how useful each source is to the target, from samples of all responses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtri

from nufleet.orchestrator.study.seen import Seen
from nufleet.orchestrator.study.trajectory_spectrum import Spectrum
from nufleet.orchestrator.study.verdict import error_with_transfer
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.frequency_test.quality import BoolArray

INTERVAL = (0.025, 0.5, 0.975)
"""Quantiles between which a quantity lies with a probability of 95 %, and its median."""

WIDER = 1.3
"""Distance of the bounds of ψ* from its median, as a multiple of that of the samples.

A model of a response has fewer parameters than what it stands for, and says less than is unknown.
Of 1000 distances in ten families of simulated fleets (`benchmarks/selection_families.py`), 87 to
99 % lay within the bounds of the samples, and 94 to 100 % within those 1.3 times as far.
"""


@dataclass(frozen=True)
class PredictedErrors:
    """Samples of the error that each source's inverse would leave on a trajectory."""

    omega_rad_s: FloatArray
    """Frequencies of the trajectory in rad/s, shape (frequencies,)."""
    parts: FloatArray
    """Contribution of each frequency to the mean square error, relative to the mean square of the
    trajectory, shape (sources, samples, frequencies)."""

    @property
    def total(self) -> FloatArray:
        """Root mean square error relative to the trajectory's, shape (sources, samples)."""
        return np.asarray(np.sqrt(self.parts.sum(axis=2)))


@dataclass(frozen=True)
class SelectionBelief:
    """Joint samples of all sources' distances and errors.

    Sample i of every field comes from the same draw of all robots' responses. The best source has
    the smallest ψ* or, where there is a trajectory, leaves the smallest error on it.
    """

    sources: tuple[str, ...]
    """Names of the sources, in the order of the arrays' first axis."""
    omega_rad_s: FloatArray
    """Frequencies of the distances in rad/s, shape (frequencies,)."""
    psi: FloatArray
    """Chordal distance ψ_n(ω), shape (sources, samples, frequencies)."""
    likeliest: FloatArray
    """Chordal distance between the means of the responses, shape (sources, frequencies)."""
    errors: PredictedErrors | None = None
    """Predicted errors on the trajectory, if one is known."""
    closest_other: FloatArray | None = None
    """Least loss that others may have, whose tones alone were compared, shape (samples,)."""

    @staticmethod
    def of(
        omega_rad_s: FloatArray,
        target: ComplexArray,
        sources: Mapping[str, ComplexArray],
        spectrum: Spectrum | None = None,
    ) -> SelectionBelief:
        """Compare samples of the target's response with samples of each source's response.

        Args:
            omega_rad_s: Frequencies of the distances in rad/s, shape (frequencies,).
            target: Samples of the target's z at these frequencies, followed by those at the
                spectrum's frequencies, shape (samples, all frequencies).
            sources: Samples of each source's z, by source, in the same shape.
            spectrum: Spectrum of the trajectory to be flown, if one is known.
        """
        count = len(omega_rad_s)
        psi = np.stack(
            [chordal_distance(target[:, :count], z[:, :count]) for z in sources.values()]
        )
        means = [z[:, :count].mean(axis=0) for z in sources.values()]
        likeliest = chordal_distance(target[:, :count].mean(axis=0), np.stack(means))
        errors = None
        if spectrum is not None:
            left = [error_with_transfer(z[:, count:], target[:, count:]) for z in sources.values()]
            parts = np.abs(np.stack(left)) ** 2 * spectrum.shares
            errors = PredictedErrors(spectrum.omega_rad_s, parts)
        return SelectionBelief(tuple(sources), omega_rad_s, psi, likeliest, errors)

    def and_also(self, other: SelectionBelief) -> SelectionBelief:
        """Return the belief about the sources of both, without errors on a trajectory.

        Args:
            other: Belief about other sources and the same target, from the same samples of it.
        """
        return SelectionBelief(
            (*self.sources, *other.sources),
            self.omega_rad_s,
            np.concatenate([self.psi, other.psi]),
            np.concatenate([self.likeliest, other.likeliest]),
        )

    @cached_property
    def psi_star(self) -> FloatArray:
        """Worst-case distance ψ*_n = max ψ_n(ω) (paper, eq. 6), shape (sources, samples)."""
        return largest(self.omega_rad_s, self.psi)

    @cached_property
    def loss(self) -> FloatArray:
        """Quantity that the best source minimises, ψ* or the error, shape (sources, samples).

        Of distances, it is what the samples scatter around the distance of the mean responses.
        What is not known of a source moves it away from the target in nearly every sample, which
        would leave the source that is known best the closest.
        """
        if self.errors is not None:
            return self.errors.total
        return np.asarray(self.psi_star - self._lengthened[:, None])

    @cached_property
    def _lengthened(self) -> FloatArray:
        """By how much the unknown lengthens the median distance of each source, (sources,)."""
        return lengthened(self.psi_star, largest(self.omega_rad_s, self.likeliest))

    @cached_property
    def psi_quantiles(self) -> FloatArray:
        """Quantiles `INTERVAL` of ψ_n(ω) at each frequency, shape (sources, 3, frequencies)."""
        return np.stack([np.quantile(psi, INTERVAL, axis=0) for psi in self.psi])

    def interval(self, source: str) -> tuple[float, float, float]:
        """Return the bounds of a source's ψ*, and its median between them; see `bounds`."""
        n = self.sources.index(source)
        return bounds(self.psi_star[n], float(self._lengthened[n]))

    def decisive_omega_rad_s(self, source: str) -> float:
        """Return the frequency (rad/s) that dominates a source's loss.

        It is the median, over the samples, of the frequency with the largest contribution.
        """
        n = self.sources.index(source)
        omega, parts = (
            (self.omega_rad_s, self.psi[n])
            if self.errors is None
            else (self.errors.omega_rad_s, self.errors.parts[n])
        )
        return float(np.median(omega[np.argmax(parts, axis=1)]))

    @cached_property
    def typical_loss(self) -> FloatArray:
        """Mean distance or, since errors have no upper bound, median error; shape (sources,)."""
        if self.errors is None:
            return np.asarray(self.loss.mean(axis=1))
        return np.asarray(np.median(self.loss, axis=1))

    def leader(self, epsilon: float, delta: float) -> tuple[str, float]:
        """Return the source to select, and the probability that it is within ε of the best.

        Among the sources that are within ε of the best with probability 1 − δ, it is the one with
        the smallest typical loss; while there is none, it is the most probable one.

        Args:
            epsilon: Difference ε of two losses that does not matter.
            delta: Accepted probability δ of a wrong selection.
        """
        least = self.loss.min(axis=0)
        if self.closest_other is not None:
            least = np.minimum(least, self.closest_other)
        within = np.mean(self.loss <= least + epsilon, axis=1)
        order = np.lexsort((self.typical_loss, -np.minimum(within, 1 - delta)))
        return self.sources[order[0]], float(within[order[0]])

    def beaten(
        self, leader: str, epsilon: float, seen: Mapping[str, FloatArray]
    ) -> tuple[float, dict[str, float]]:
        """Return how sure the leader is if the others may do anything where they were not seen.

        A loss is a maximum, or a sum of squares, over frequencies: what is not seen of a source can
        only make it worse, so that what is seen is enough to tell that it is not the best.

        Args:
            leader: Name of the source that is selected now.
            epsilon: Difference ε of two losses that does not matter.
            seen: Part of the loss that was seen, of the sources that tests did not show in the
                whole band, each of shape (samples,).

        Returns:
            The probability that the leader is within ε of the best, and the probability that it is
            not within ε of each of the others.
        """
        limit = self.loss[self.sources.index(leader)] - epsilon
        everywhere = Seen.above(0.0)
        ahead = {
            source: (seen[source] if source in seen else self.part(source, everywhere)) < limit
            for source in self.sources
            if source != leader
        }
        others = np.inf if self.closest_other is None else self.closest_other
        surely = 1.0 - float(np.mean(np.any([*ahead.values(), limit > others], axis=0)))
        return surely, {source: float(np.mean(one)) for source, one in ahead.items()}

    def part(self, source: str, *seen: Seen) -> FloatArray:
        """Return the part of a source's loss that was seen, shape (samples,).

        Args:
            source: Name of the source.
            seen: Frequencies at which tests say what it does; of several, those in all of them.
        """
        if self.errors is None:
            at = np.all([one.at(self.omega_rad_s) for one in seen], axis=0)
            return part_of_worst(source, [(self, at)])
        at = np.all([one.at(self.errors.omega_rad_s) for one in seen], axis=0)
        parts = self.errors.parts[self.sources.index(source)][:, at]
        return np.asarray(np.sqrt(parts.sum(axis=1)))

    def variance_to_settle(self, leader: str, epsilon: float, delta: float) -> float:
        """Return the factor by which variances have to fall until the leader is surely the best.

        All leads are assumed to be normal, and their means to stay what they are; it is infinite
        where one of them says that another source is the best.

        Args:
            leader: Name of the source that is selected now.
            epsilon: Difference ε of two losses that does not matter.
            delta: Accepted probability δ of a wrong selection.
        """
        n = self.sources.index(leader)
        leads = np.delete(self.loss, n, axis=0) - self.loss[n]
        needed = -float(ndtri(delta / len(self.sources))) * leads.std(axis=1)
        margin = leads.mean(axis=1) + epsilon
        if np.any(margin <= 0.0):
            return math.inf
        return float(np.max(needed / margin, initial=1.0)) ** 2

    def probability_best(self) -> FloatArray:
        """Return the share of samples in which each source is the best, shape (sources,)."""
        best = np.argmin(self.loss, axis=0)
        counts = np.bincount(best, minlength=len(self.sources))
        return np.asarray(counts / self.loss.shape[1], dtype=np.float64)

    def hopeless(self, leader: str, delta: float) -> dict[str, str]:
        """Return the sources that cannot win, with the reasons.

        A source cannot win if it is the best in no sample and if the probability that it is ahead
        of the leader, with its lead assumed to be normal, is below δ / (2 sources).

        Args:
            leader: Name of the source that is selected now.
            delta: Accepted probability δ of a wrong selection.
        """
        ahead = self.loss[self.sources.index(leader)]
        chances = self.probability_best()
        out: dict[str, str] = {}
        for n, source in enumerate(self.sources):
            behind = self.loss[n] - ahead
            deviation = float(np.std(behind))
            needed = -float(ndtri(delta / (2 * len(self.sources)))) * deviation
            if source != leader and chances[n] == 0.0 and float(np.mean(behind)) > needed:
                out[source] = self.lag(source, leader)
        return out

    def lag(self, source: str, leader: str) -> str:
        """Return in words by how much a source's loss is larger than that of the leader."""
        what = "worst-case distance" if self.errors is None else "predicted error"
        behind = self.loss[self.sources.index(source)] - self.loss[self.sources.index(leader)]
        return (
            f"its {what} is {np.mean(behind):.3f} ± {np.std(behind):.1g} larger "
            f"than that of {leader}"
        )


def part_of_worst(source: str, axes: Sequence[tuple[SelectionBelief, BoolArray]]) -> FloatArray:
    """Return the part of a source's distance on its worst axis that was seen, shape (samples,).

    Args:
        source: Name of the source.
        axes: Belief about each axis, and at which of its frequencies tests say what the source
            does, of shape (frequencies,).
    """
    n = axes[0][0].sources.index(source)
    psi = np.max([one.psi[n][:, at].max(axis=1, initial=0.0) for one, at in axes], axis=0)
    of_means = np.max([one.likeliest[n, at].max(initial=0.0) for one, at in axes])
    return np.asarray(psi - lengthened(psi[None], of_means))


def lengthened(psi_star: FloatArray, of_means: FloatArray) -> FloatArray:
    """Return by how much the unknown lengthens the median distance of each source, (sources,).

    Args:
        psi_star: Samples of the distances, shape (sources, samples).
        of_means: Distances between the means of the responses, shape (sources,).
    """
    return np.maximum(np.median(psi_star, axis=1) - of_means, 0.0)


def bounds(psi_star: FloatArray, longer: float) -> tuple[float, float, float]:
    """Return the bounds of a distance, and its median between them.

    What is not known of two responses moves them apart in nearly every sample, so that the samples
    of their distance lie above that of their means; and what is wrong with the means has moved
    these apart by as much. The lower bound is therefore that of the samples less twice the
    difference (the basic bootstrap: Davison and Hinkley, 1997, section 5.2). Both bounds are then
    moved away from the median (`WIDER`).

    Args:
        psi_star: Samples of the distance, shape (samples,).
        longer: By how much the unknown lengthens it.
    """
    low, median, high = np.quantile(psi_star, INTERVAL).tolist()
    low -= 2.0 * longer
    low, high = (median + WIDER * (bound - median) for bound in (low, high))
    return max(low, 0.0), median, min(high, 1.0)


def largest(omega_rad_s: FloatArray, psi: FloatArray) -> FloatArray:
    """Return the largest distance over frequencies, also where it lies between two of them.

    A parabola through the largest value and its two neighbours has its vertex there. A light
    resonance is narrower than a few frequencies of the grid, and has its largest distance between
    them.

    Args:
        omega_rad_s: Frequencies in rad/s, rising, shape (frequencies,).
        psi: Distances there, shape (..., frequencies).
    """
    highest: FloatArray = psi.max(axis=-1)
    if len(omega_rad_s) < 3:
        return highest
    peak = np.argmax(psi, axis=-1)
    middle = peak.clip(1, len(omega_rad_s) - 2)
    before, at, after = (
        np.take_along_axis(psi, (middle + n)[..., None], axis=-1)[..., 0] for n in (-1, 0, 1)
    )
    left = omega_rad_s[middle] - omega_rad_s[middle - 1]
    right = omega_rad_s[middle + 1] - omega_rad_s[middle]
    rise, fall = (at - before) / left, (at - after) / right
    bend = (rise + fall) / (left + right)
    slope = (rise * right - fall * left) / (left + right)
    inside = (peak == middle) & (bend > 0.0)
    above = np.divide(slope**2, 4.0 * bend, where=inside, out=np.zeros_like(at))
    return np.asarray(np.minimum(highest + above, 1.0))
