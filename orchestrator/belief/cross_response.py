"""The belief about how one axis of a robot answers to the reference of another.

A cross response has no shape that is typical of robots: it is small, causal and smooth, vanishes
where the axes are not coupled, and rings no longer than the axes do. It is therefore a sum of
delayed pulses, normal with deviations that decay with the delay; their size and their memory are
weighed by the evidence, as for the residual in `nufleet.orchestrator.belief.response_belief`.
"""

from __future__ import annotations

from itertools import product

import numpy as np
from scipy.linalg import solve_triangular

from nufleet.orchestrator.belief.loop_features import TAPS, tap_columns, tap_std
from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.shared.arrays import ComplexArray, FloatArray

SIZES = (1e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0)
MEMORIES = (2.0, 4.0, 8.0, 16.0)
"""Prior standard deviations of the response, and its memories in units of 1/ω_max."""


class CrossModel:
    """The belief about one cross response after the tests of its two axes."""

    def __init__(self, tones: Tones, omega_max_rad_s: float) -> None:
        """Weigh all sizes and memories.

        Args:
            tones: All measurements of the response, at least one.
            omega_max_rad_s: Upper end of the band.
        """
        self._omega_max_rad_s = omega_max_rad_s
        columns = tones.whiten(tap_columns(omega_max_rad_s, tones.omega_rad_s).T).T
        measured = tones.whiten(tones.z)
        self._parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
        evidence = []
        for size, memory in product(SIZES, MEMORIES):
            std = tap_std(size, memory / omega_max_rad_s, omega_max_rad_s)
            weighted = columns * std
            factor = np.linalg.cholesky(np.eye(TAPS) + weighted.T @ weighted)
            half: FloatArray = solve_triangular(factor, weighted.T @ measured, lower=True)
            # ln p(r) = ½ ‖L⁻¹Φᵀr‖² − Σ ln L_ii + const, with I + ΦᵀΦ = LLᵀ.
            evidence.append(0.5 * half @ half - np.sum(np.log(np.diag(factor))))
            self._parts.append((std, np.asarray(factor, dtype=np.float64), half))
        weights = np.exp(np.array(evidence) - max(evidence))
        self._weights = weights / weights.sum()

    def draw(self, omega_rad_s: FloatArray, count: int, rng: np.random.Generator) -> ComplexArray:
        """Draw samples of the response.

        Args:
            omega_rad_s: Frequencies in rad/s, shape (frequencies,).
            count: Number of samples.
            rng: Generator that draws them.

        Returns:
            Samples of z_ij, in random order, shape (count, frequencies).
        """
        taps = tap_columns(self._omega_max_rad_s, omega_rad_s)
        counts = rng.multinomial(count, self._weights)
        samples = []
        for (std, factor, half), own in zip(self._parts, counts.tolist(), strict=True):
            if own:
                # w = L⁻ᵀ (L⁻¹Φᵀr + ε) with ε standard normal.
                noise = rng.standard_normal((TAPS, own))
                weights = solve_triangular(factor, half[:, None] + noise, lower=True, trans="T")
                samples.append((taps @ (std[:, None] * weights)).T)
        return np.concatenate(samples)[rng.permutation(count)]
