"""A test that contradicts the earlier tests of a robot: how far it misses what they predict."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import chdtri

from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.orchestrator.belief.response_belief import ResponseModel
from nufleet.shared.arrays import ComplexArray, FloatArray

CHANGE_SIGNIFICANCE = 1e-3
"""Probability that noise alone makes a test contradict the earlier ones."""

CHECK_SAMPLES = 400
"""Number of responses that are drawn to tell what was expected."""


NO_DELAY_SIGNIFICANCE = 0.01
"""Probability that noise alone makes tests that differ by a delay differ by more."""

DELAY_TONES_MIN = 3
"""Number of tones from which a delay is told from other changes: at one, any change of the phase is
like one."""

SAME_TONE = 1e-6
"""Relative difference of two frequencies up to which they are the same tone."""


@dataclass(frozen=True)
class Miss:
    """How far a test misses what the earlier tests predict of it."""

    omega_rad_s: FloatArray
    """Frequencies at which the two are compared in rad/s, shape (tones,)."""
    measured: ComplexArray
    """What the test measured at each, shape (tones,)."""
    expected: ComplexArray
    """Mean of the prediction, shape (tones,)."""
    squared: FloatArray
    """Squared distance from it, shape (tones,)."""
    usual: FloatArray
    """Variance that the distance was expected to have, shape (tones,)."""
    worst: float
    """The most significant distance."""
    worst_rad_s: float
    """Its frequency in rad/s."""

    @property
    def delay_s(self) -> float | None:
        """Delay in s by which alone the test differs from what was expected; None if by more.

        It is also None if there are too few tones, or no response, to tell.
        """
        slope, weight = -1j * self.omega_rad_s * self.expected, 1 / self.usual
        if len(slope) < DELAY_TONES_MIN or not slope.any():
            return None
        towards = np.sum(weight * np.real(np.conj(slope) * (self.measured - self.expected)))
        delay_s = float(towards / np.sum(weight * np.abs(slope) ** 2))
        late = self.expected * np.exp(-1j * self.omega_rad_s * delay_s)
        left = 2 * float(np.sum(weight * np.abs(self.measured - late) ** 2))
        return delay_s if left <= chdtri(2 * len(late) - 1, NO_DELAY_SIGNIFICANCE) else None

    @property
    def excess(self) -> float:
        """Mean of what the squared distances have in excess of the usual.

        A flight's estimates differ in certainty; the uncertain ones say nothing about a change.
        """
        return float(np.average(np.maximum(self.squared - self.usual, 0.0), weights=1 / self.usual))


def miss_of(
    new: Tones,
    doubt: FloatArray,
    before: ResponseModel,
    after: ResponseModel,
    rng: np.random.Generator,
) -> Miss | None:
    """Return how far a new test misses what the earlier ones predict; None if it does not.

    The test statistic is the squared distance of the new ẑ from what was expected, of which the
    belief with the new one as well says how large it is; its distribution is χ² with one degree
    of freedom for each real and imaginary part.

    Args:
        new: Estimates of the new test.
        doubt: Variance of them that is the same in all tests, shape (tones,).
        before: Belief after the earlier tests.
        after: Belief after the new one as well.
        rng: Generator that draws the responses expected from the earlier tests.
    """
    if before.distance(after) <= chdtri(2 * len(new.z), CHANGE_SIGNIFICANCE):
        return None
    expected = before.draw_fitted(new.omega_rad_s, CHECK_SAMPLES, rng)
    usual = new.variance + doubt + np.var(expected, axis=0)
    return _miss(new.omega_rad_s, new.z, expected.mean(axis=0), usual)


def miss_at_same_tones(new: Tones, doubt: FloatArray, earlier: Tones) -> Miss | None:
    """Return how far a new test misses earlier estimates at the same tones; None if it does not.

    No model of the response is needed to compare these, which may explain a small change at all
    frequencies by resonances between the tones.

    Args:
        new: Estimates of the new test.
        doubt: Variance of them that is the same in all tests, shape (tones,).
        earlier: Estimates of the earlier tests, with what is doubted of them in their variances.
    """
    apart = np.abs(new.omega_rad_s[:, None] - earlier.omega_rad_s)
    variance = np.where(apart <= SAME_TONE * new.omega_rad_s[:, None], earlier.variance, np.inf)
    known = np.argmin(variance, axis=1)
    shared = np.isfinite(variance.min(axis=1))
    if not shared.any():
        return None
    known = known[shared]
    usual = (new.variance + doubt)[shared] + earlier.variance[known]
    miss = _miss(new.omega_rad_s[shared], new.z[shared], earlier.z[known], usual)
    excess = 2 * float(np.sum(miss.squared / miss.usual))
    return miss if excess > chdtri(2 * len(usual), CHANGE_SIGNIFICANCE) else None


def _miss(
    omega_rad_s: FloatArray, measured: ComplexArray, expected: ComplexArray, usual: FloatArray
) -> Miss:
    squared = np.abs(measured - expected) ** 2
    worst = int(np.argmax(squared / usual))
    return Miss(
        omega_rad_s,
        measured,
        expected,
        squared,
        usual,
        float(np.sqrt(squared[worst])),
        float(omega_rad_s[worst]),
    )
