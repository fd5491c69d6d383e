"""What is believed of every source's worth for the target, from samples of all responses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.special import ndtri

from nufleet.orchestrator.study.trajectory_spectrum import Spectrum
from nufleet.orchestrator.study.verdict import error_with_transfer
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance


@dataclass(frozen=True)
class PredictedErrors:
    """What each source's inverse would leave of the target's error on a trajectory.

    `parts`, shape (sources, samples, frequencies), is each frequency's share of the mean square
    error relative to the trajectory's, at the trajectory's frequencies.
    """

    omega_rad_s: FloatArray
    parts: FloatArray

    @property
    def total(self) -> FloatArray:
        """Root mean square error relative to the trajectory's, shape (sources, samples)."""
        return np.asarray(np.sqrt(self.parts.sum(axis=2)))


@dataclass(frozen=True)
class SelectionBelief:
    """Joint samples: row i of everything comes from one draw of all robots' responses.

    `psi` has shape (sources, samples, frequencies), `psi_star` shape (sources, samples). The best
    source has the smallest ψ* or, where there is a trajectory, leaves the smallest error on it.
    """

    sources: tuple[str, ...]
    omega_rad_s: FloatArray
    psi: FloatArray
    psi_star: FloatArray
    errors: PredictedErrors | None = None

    @staticmethod
    def of(
        omega_rad_s: FloatArray,
        target: ComplexArray,
        sources: Mapping[str, ComplexArray],
        spectrum: Spectrum | None = None,
    ) -> SelectionBelief:
        """Compare samples of the target's z with each source's.

        Args:
            omega_rad_s: where distances are wanted.
            target: samples at these frequencies and at the spectrum's after them, of shape
                (samples, frequencies).
            sources: the same of each source.
            spectrum: of the trajectory to be flown, if one is known.
        """
        count = len(omega_rad_s)
        psi = np.stack(
            [chordal_distance(target[:, :count], z[:, :count]) for z in sources.values()]
        )
        errors = None
        if spectrum is not None:
            left = [error_with_transfer(z[:, count:], target[:, count:]) for z in sources.values()]
            parts = np.abs(np.stack(left)) ** 2 * spectrum.shares
            errors = PredictedErrors(spectrum.omega_rad_s, parts)
        return SelectionBelief(tuple(sources), omega_rad_s, psi, psi.max(axis=2), errors)

    @cached_property
    def loss(self) -> FloatArray:
        """What the best source has least of, shape (sources, samples)."""
        return self.psi_star if self.errors is None else self.errors.total

    def decisive_omega_rad_s(self, source: str) -> float:
        """Return where a source's loss mostly comes from: the middle of all samples' largest."""
        n = self.sources.index(source)
        omega, parts = (
            (self.omega_rad_s, self.psi[n])
            if self.errors is None
            else (self.errors.omega_rad_s, self.errors.parts[n])
        )
        return float(np.median(omega[np.argmax(parts, axis=1)]))

    @cached_property
    def typical_loss(self) -> FloatArray:
        """Each source's mean distance or, since errors have no upper bound, its median error."""
        if self.errors is None:
            return np.asarray(self.loss.mean(axis=1))
        return np.asarray(np.median(self.loss, axis=1))

    def leader(self, epsilon: float, delta: float) -> tuple[str, float]:
        """Return the source to select, and the probability that it is within ε of the best.

        Of the sources that are so with probability 1 − δ it is the one with the smallest loss; as
        long as there is none, the most probable one.
        """
        within = np.mean(self.loss <= self.loss.min(axis=0) + epsilon, axis=1)
        order = np.lexsort((self.typical_loss, -np.minimum(within, 1 - delta)))
        return self.sources[order[0]], float(within[order[0]])

    def probability_best(self) -> FloatArray:
        """Return for each source the share of samples in which it is the best."""
        best = np.argmin(self.loss, axis=0)
        counts = np.bincount(best, minlength=len(self.sources))
        return np.asarray(counts / self.loss.shape[1], dtype=np.float64)

    def hopeless(self, leader: str, delta: float) -> dict[str, str]:
        """Return the sources that cannot win, with the reason.

        A source is out when it was the best in no sample and when, its lead over the leader
        taken as normal, it is ahead with a probability below δ / (2 sources).
        """
        ahead = self.loss[self.sources.index(leader)]
        what = "worst-case distance" if self.errors is None else "predicted error"
        chances = self.probability_best()
        out: dict[str, str] = {}
        for n, source in enumerate(self.sources):
            behind = self.loss[n] - ahead
            deviation = float(np.std(behind))
            needed = -float(ndtri(delta / (2 * len(self.sources)))) * deviation
            if source != leader and chances[n] == 0.0 and float(np.mean(behind)) > needed:
                out[source] = (
                    f"its {what} is {np.mean(behind):.3f} ± {deviation:.3f} larger "
                    f"than that of {leader}"
                )
        return out
