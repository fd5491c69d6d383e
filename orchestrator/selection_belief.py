"""What is believed of every source's distance to the target, from samples of all responses."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from shared.arrays import ComplexArray, FloatArray
from shared.chordal import chordal_distance


@dataclass(frozen=True)
class SelectionBelief:
    """Joint samples: row i of everything comes from one draw of all robots' responses.

    `psi` has shape (sources, samples, frequencies), `psi_star` shape (sources, samples).
    """

    sources: tuple[str, ...]
    omega_rad_s: FloatArray
    psi: FloatArray
    psi_star: FloatArray

    @staticmethod
    def of(
        omega_rad_s: FloatArray, target: ComplexArray, sources: Mapping[str, ComplexArray]
    ) -> SelectionBelief:
        """Compare samples of the target's z, shape (samples, frequencies), with each source's."""
        psi = np.stack([chordal_distance(target, z) for z in sources.values()])
        return SelectionBelief(tuple(sources), omega_rad_s, psi, psi.max(axis=2))

    def leader(self, epsilon: float) -> tuple[str, float]:
        """Return the source most probably within ε of the closest, and that probability."""
        within = np.mean(self.psi_star <= self.psi_star.min(axis=0) + epsilon, axis=1)
        # Among equals the one closest on average.
        order = np.lexsort((self.psi_star.mean(axis=1), -within))
        return self.sources[order[0]], float(within[order[0]])

    def probability_best(self) -> FloatArray:
        """Return for each source the share of samples in which it is the closest."""
        best = np.argmin(self.psi_star, axis=0)
        counts = np.bincount(best, minlength=len(self.sources))
        return np.asarray(counts / self.psi_star.shape[1], dtype=np.float64)

    def hopeless(self, leader: str, delta: float) -> dict[str, str]:
        """Return the sources that cannot win, with the reason.

        A source is out when it was the closest in no sample and when, its lead over the leader
        taken as normal, it is ahead with a probability below δ / (2 sources).
        """
        ahead = self.psi_star[self.sources.index(leader)]
        chances = self.probability_best()
        out: dict[str, str] = {}
        for n, source in enumerate(self.sources):
            behind = self.psi_star[n] - ahead
            deviation = float(np.std(behind))
            needed = -float(ndtri(delta / (2 * len(self.sources)))) * deviation
            if source != leader and chances[n] == 0.0 and float(np.mean(behind)) > needed:
                out[source] = (
                    f"its worst-case distance is {np.mean(behind):.3f} ± {deviation:.3f} larger "
                    f"than that of {leader}"
                )
        return out
