"""The belief about how one axis of a robot answers to the reference of another.

Forces between axes add C(ω) to what holds each axis by itself, Z = (D + C)⁻¹ K with diagonal D and
K, so that to first order z_ij = −z_ii z_jj C_ij / K_i: axis j moves, what couples the axes turns
its motion into a force, and axis i answers to that. A cross response thus resonates where its two
axes do, which both of their tests show, and not only the few tones of one. It is therefore the
product z_ii z_jj times what couples the axes, a stiffness, damping and inertia, and times a sum of
delayed pulses for all that the first order leaves out. The alternative is such a sum by itself, for
axes that are coupled in another way. Sizes, memories and the choice between both are weighed by the
evidence, as for the residual in `nufleet.orchestrator.belief.response_belief`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.linalg import solve_triangular

from nufleet.orchestrator.belief.loop_features import TAPS, tap_columns, tap_std
from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.shared.arrays import ComplexArray, FloatArray

SIZES = (1e-3, 1e-2, 3e-2, 0.1, 0.3, 1.0)
MEMORIES = (2.0, 4.0, 8.0, 16.0)
"""Prior standard deviations of a response without shape, and its memories in units of 1/ω_max."""

SHARES = (0.03, 0.1, 0.3, 1.0)
SHARE_MEMORIES = (4.0, 16.0, 40.0)
"""Prior standard deviations of what the first order leaves out, as shares of what it says, and
their memories in units of 1/ω_max."""

WITHOUT_SHAPE = 0.3
"""Prior weight of each size of a response without shape, relative to each with the shape of its
axes."""

NEGLIGIBLE = 1e-4
"""Posterior probability below which a prior is left out."""

FORCES = 3
"""Number of ways in which axes pull at each other: by stiffness, damping and inertia."""

Response = Callable[[FloatArray], ComplexArray]
"""A response at frequencies in rad/s, shape (frequencies,)."""


@dataclass(frozen=True, eq=False)
class ForeseenErrors:
    """What samples of other responses of a column say of the errors of one's measurements.

    One disturbance may move several axes, so that errors of their estimates at a tone go together.
    """

    errors: ComplexArray
    """Expected errors ẑ − z in each sample, shape (samples, tones)."""
    left: FloatArray
    """Share of their variance that is left, shape (tones,)."""


class CrossModel:
    """The belief about one cross response after the tests of its two axes."""

    def __init__(self, tones: Tones, omega_max_rad_s: float, own: Response) -> None:
        """Weigh all sizes and memories.

        Args:
            tones: All measurements of the response, at least one.
            omega_max_rad_s: Upper end of the band.
            own: Product z_ii z_jj of the two axes' responses to their own references.
        """
        self._omega_max_rad_s, self._own, self._tones = omega_max_rad_s, own, tones
        std, log_prior = _priors(omega_max_rad_s)
        columns = tones.whiten(self._columns(tones.omega_rad_s).T).T * std[:, None, :]
        transposed = columns.swapaxes(1, 2)
        factors = np.linalg.cholesky(np.eye(std.shape[1]) + transposed @ columns)
        toward = transposed @ tones.whiten(tones.z)
        halves: FloatArray = np.linalg.solve(factors, toward[..., None])[..., 0]
        # ln p(r) = ½ ‖L⁻¹Φᵀr‖² − Σ ln L_ii + const, with I + ΦᵀΦ = LLᵀ.
        determinant = np.sum(np.log(np.diagonal(factors, axis1=1, axis2=2)), axis=1)
        evidence = log_prior + 0.5 * np.sum(halves**2, axis=1) - determinant
        weights = np.exp(evidence - evidence.max())
        left = weights > NEGLIGIBLE * weights.sum()
        self._weights = weights[left] / weights[left].sum()
        self._std, self._factors, self._halves = std[left], factors[left], halves[left]

    def mean(self, omega_rad_s: FloatArray) -> ComplexArray:
        """Return the mean of the response at frequencies in rad/s, shape (frequencies,)."""
        backward = self._factors.swapaxes(1, 2)
        each = self._std * np.linalg.solve(backward, self._halves[..., None])[..., 0]
        return np.asarray(self._columns(omega_rad_s) @ (self._weights @ each))

    def draw(
        self,
        omega_rad_s: FloatArray,
        count: int,
        rng: np.random.Generator,
        foreseen: ForeseenErrors | None = None,
    ) -> ComplexArray:
        """Draw samples of the response.

        Args:
            omega_rad_s: Frequencies in rad/s, shape (frequencies,).
            count: Number of samples.
            rng: Generator that draws them.
            foreseen: What samples of other responses say of the errors of the measurements; None
                if nothing.

        Returns:
            Samples of z_ij, shape (count, frequencies), in the order of those of the others.
        """
        columns, tones = self._columns(omega_rad_s), self._tones
        samples = np.empty((count, len(omega_rad_s)), dtype=np.complex128)
        parts = rng.choice(len(self._weights), size=count, p=self._weights)
        at_tones, errors = None, None
        if foreseen is not None:
            left = Tones(tones.omega_rad_s, tones.z, tones.variance * foreseen.left)
            at_tones = left.whiten(self._columns(tones.omega_rad_s).T).T
            errors = left.whiten(tones.z - foreseen.errors)
        for part in np.unique(parts).tolist():
            mine = np.flatnonzero(parts == part)
            factor, half, std = self._factors[part], self._halves[part][:, None], self._std[part]
            if at_tones is not None and errors is not None:
                own = at_tones * std
                factor = np.linalg.cholesky(np.eye(len(std)) + own.T @ own)
                half = solve_triangular(factor, own.T @ errors[mine].T, lower=True)
            # w = L⁻ᵀ (L⁻¹Φᵀr + ε) with ε standard normal.
            noise = rng.standard_normal((len(std), len(mine)))
            weights = solve_triangular(factor, half + noise, lower=True, trans="T")
            samples[mine] = (columns @ (std[:, None] * weights)).T
        return samples

    def _columns(self, omega_rad_s: FloatArray) -> ComplexArray:
        """Return what the weights multiply, shape (frequencies, weights)."""
        jx = 1j * omega_rad_s[:, None] / self._omega_max_rad_s
        own = self._own(omega_rad_s)[:, None]
        pulses = tap_columns(self._omega_max_rad_s, omega_rad_s)
        return np.concatenate([own * jx ** np.arange(FORCES), own * pulses, pulses], axis=1)


def _priors(omega_max_rad_s: float) -> tuple[FloatArray, FloatArray]:
    """Return the standard deviations of all weights, and the logarithm of each prior's weight.

    The shapes are (priors, weights) and (priors,).
    """

    def pulses(size: float, memory: float) -> FloatArray:
        return tap_std(size, memory / omega_max_rad_s, omega_max_rad_s)

    nothing = np.zeros(TAPS)
    shaped = [
        np.concatenate([np.full(FORCES, size), pulses(share * size, memory), nothing])
        for size, share, memory in product(SIZES, SHARES, SHARE_MEMORIES)
    ]
    shapeless = [
        np.concatenate([np.zeros(FORCES), nothing, pulses(size, memory)])
        for size, memory in product(SIZES, MEMORIES)
    ]
    log_prior = np.repeat([0.0, np.log(WITHOUT_SHAPE)], [len(shaped), len(shapeless)])
    return np.array([*shaped, *shapeless]), log_prior
