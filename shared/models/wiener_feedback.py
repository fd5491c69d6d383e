"""The linear feedback that leaves the least of a disturbance, for a loop whose response is known.

What a loop measures beyond what its references explain, m = d + n, is a disturbance d and white
noise n. A filter Q adds Q m to the reference, which leaves (1 + z Q) d + z Q n: internal model
control (Morari and Zafiriou, Robust Process Control, 1989). The best causal Q is a Wiener filter,
here with as many unknowns as needed by its normal equations over the frequencies. A loop that is
what its model says stays stable with any Q, since nothing is fed back that the reference explains.
What is not known of its response counts as another disturbance, and bounds the filter's gain.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.fft import irfft, rfft, rfftfreq

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.models.error_belief import ErrorBelief
from nufleet.shared.models.error_response import dirichlet
from nufleet.shared.models.unexplained import autocovariance, fast_length, spectrum

_WIDENING = 1.4  # ratio of the lags of neighbouring steps of Q
_GAIN = 0.7
_SURE = 2.0  # standard deviations by which a model may be wrong
_CLOSE = 0.05  # share by which the gain may exceed its bound
_TRIES = 40
_FIRMER = 3.0  # factor on a penalty that did not suffice
_EASY = 1e-3  # share of the disturbance that the gentleness of the filter may cost at first
_SAMPLES_MAX = 20_000  # an answer longer than this is too long for a feedback


@dataclass(frozen=True, eq=False)
class WienerFeedback:
    """A filter from what is measured beyond the expected to the reference of the next sample."""

    taps: FloatArray
    """Weights of what was measured 1, 2, … samples ago, shape (taps,)."""
    answer: FloatArray
    """Impulse response of the loop to the filter's input, z Q, shape (samples,)."""
    doubtful: float
    """Variance to be expected beside, in unit², since the loop's response is not quite known."""

    def variance(self, covariance: FloatArray) -> float:
        """Return the variance that is left of a disturbance, in unit².

        Args:
            covariance: Autocovariance of the disturbance, shape (lags,), in unit²; its variance
                alone for white noise of the sensor, which is then measured as well.
        """
        kept = self.answer.copy()
        kept[0] += 1.0
        lags = min(len(kept), len(covariance))
        weights = autocovariance(kept[np.newaxis], lags) * len(kept)
        weights[1:] *= 2.0  # a lag to either side
        return max(0.0, float(weights @ covariance[:lags]))

    def closed(self, rows: FloatArray) -> FloatArray:
        """Return what is left of disturbances, shape (disturbances, samples) like theirs."""
        length = fast_length(rows.shape[1] + len(self.answer))
        answered = irfft(rfft(rows, length) * rfft(self.answer, length), length)
        return np.asarray(rows + answered[:, : rows.shape[1]])


def wiener_feedback(
    belief: ErrorBelief,
    covariance: FloatArray,
    noise_variance: float,
    *,
    relative_error: float,
    safe_error: float,
    acceleration_max: float,
) -> WienerFeedback | None:
    """Return the feedback that leaves the least of a disturbance; None if none is safe.

    The output that it answers is one sample old.

    Args:
        belief: Belief about the loop.
        covariance: Autocovariance of the disturbance, shape (lags,), in unit².
        noise_variance: Variance of the white noise of the sensor, in unit².
        relative_error: Standard deviation of the share of the error response z − 1 that is
            expected to be wrong.
        safe_error: The same for which the loop must stay stable, at least as large.
        acceleration_max: Root mean square acceleration, in unit/s², that the feedback may ask for.
    """
    step_s, answer = belief.basis.sample_time_s, int(belief.basis.nodes[-1]) + 1
    if answer > _SAMPLES_MAX or not covariance[0] > 0:
        return None
    length = fast_length(2 * (answer + len(covariance)))
    omega_rad_s = np.asarray(2 * np.pi * rfftfreq(length, step_s), dtype=np.float64)
    lasting = spectrum(covariance, length)
    total = lasting + noise_variance
    z, variance = belief.response(omega_rad_s)
    delay = np.exp(-1j * omega_rad_s * step_s)
    late = z * delay
    wrong = variance + (safe_error * np.abs(1 - z)) ** 2
    edges = _edges(answer)
    parts = _steps(edges, omega_rad_s * step_s)
    pull = np.abs(1 - delay) ** 4 / step_s**4 / acceleration_max**2
    # Frequencies other than the ends of the band stand for their negative ones, too.
    weight = np.full(len(z), 2.0 / length)
    weight[0] = 1.0 / length
    if length % 2 == 0:
        weight[-1] = 1.0 / length
    doubt, gentle = np.ones(len(z)), _EASY * float(covariance[0])
    for _ in range(_TRIES):
        costs = weight * total * (np.abs(late) ** 2 + doubt * wrong)
        costs = costs + weight * total * pull * gentle
        normal = (parts.conj().T * costs) @ parts
        right = -(parts.conj().T * (weight * lasting)) @ late.conj()
        normal = normal.real + 1e-9 * np.trace(normal.real) / len(edges) * np.eye(len(edges) - 1)
        heights = np.linalg.solve(normal, right.real)
        filter_ = parts @ heights
        excess = np.abs(filter_) * _SURE * np.sqrt(wrong) / _GAIN
        rough = bool(np.sum(weight * total * pull * np.abs(filter_) ** 2) > 1.0)
        if excess.max() <= 1.0 + _CLOSE and not rough:
            answered = irfft(late * filter_, length)[: length // 2]
            expected = variance + (relative_error * np.abs(1 - z)) ** 2
            doubtful = float(np.sum(weight * total * expected * np.abs(filter_) ** 2))
            taps = np.repeat(heights, np.diff(edges))
            return WienerFeedback(taps, np.asarray(answered), doubtful)
        # Only where the gain is too large does a model that may be wrong count for more.
        doubt *= np.clip(excess, 1.0, _FIRMER) ** 2
        gentle *= _FIRMER if rough else 1.0
    return None


def _edges(samples: int) -> np.ndarray:
    """Return the lags between which the filter is constant, ascending from 0."""
    widening = _WIDENING ** np.arange(int(np.log(max(samples, 2)) / np.log(_WIDENING)) + 1)
    return np.unique(np.concatenate([[0], np.round(widening).astype(int)]))


def _steps(edges: np.ndarray, turn: FloatArray) -> ComplexArray:
    """Return the frequency responses of filters that are 1 between two edges, (frequencies, n)."""
    # Σ_k e^{−jkθ} over a range of k is a Dirichlet kernel about its centre.
    columns = [
        np.exp(-0.5j * turn * (first + end - 1)) * dirichlet(turn, int(end - first)) * (end - first)
        for first, end in pairwise(edges)
    ]
    return np.stack(columns, axis=1)
