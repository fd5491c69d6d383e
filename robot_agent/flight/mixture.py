"""Weighs several models by how well each of them predicted what turned out.

Bayesian model averaging (Hoeting, Madigan, Raftery and Volinsky, Statistical Science 14, 1999,
eq. 1 and 2): every model gives a predictive density, its weight is its posterior probability, and
the average predicts with the weighted mean. Since the best model may change during a flight, old
evidence is forgotten exponentially, as in dynamic model averaging (Raftery, Kárný and Ettler,
Technometrics 52, 2010, eq. 6 and 7); what is forgotten leads back to the weights at the start.

    log w_i(k) = log s_i + Σ_j a^(k − j) log p_i(y_j | y_1 … y_(j−1)) + constant

with the start s, the forgetting factor a and the predictive densities p_i, here Gaussian. With
a = 1 these are the exact posterior probabilities.
"""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray

EVIDENCE_MAX = 30.0
"""Most by which the log evidence of a model falls behind the best one's.

Its weight is then about 1e-13 of the best. Without a bound a model that was wrong for long, or once
by very much, could hardly return when it becomes right."""


class Mixture:
    """Weights of several models, and what they predict together.

    The order of the models has no influence. A model whose prediction is not finite takes no part
    in that mean, and its evidence falls to the least.
    """

    def __init__(self, start: FloatArray, forgetting: float) -> None:
        """Begin with the weights of the start.

        Args:
            start: Prior probability of each model, shape (models,); positive, with sum one.
            forgetting: Factor a in (0, 1] by which the evidence so far shrinks at each `observe`.

        Raises:
            ValueError: The start holds no probabilities, or the factor is outside (0, 1].
        """
        probabilities = np.asarray(start, dtype=np.float64)
        if probabilities.ndim != 1 or not (probabilities > 0).all():
            raise ValueError(f"the weights at the start must be positive, got {start}")
        if abs(float(probabilities.sum()) - 1.0) > 1e-9:
            raise ValueError(f"the weights at the start must add up to 1, got {start}")
        if not 0 < forgetting <= 1:
            raise ValueError(f"the forgetting factor must be above 0 and at most 1: {forgetting}")
        self._log_start = np.log(probabilities)
        self._forgetting = forgetting
        self._evidence = np.zeros(len(probabilities))

    @property
    def weights(self) -> FloatArray:
        """Probability of each model, shape (models,); the sum is one."""
        return softmax(self._log_start + self._evidence)

    def observe(self, predicted: FloatArray, variance: FloatArray, observed: FloatArray) -> None:
        """Take what turned out, after what each model predicted of it.

        Args:
            predicted: Mean of each model's prediction, shape (models, m).
            variance: Variance of each prediction, measurement noise included, shape (models, m) or
                one that broadcasts to it; positive.
            observed: What was measured, shape (m,). Numbers that are not finite count for nothing.
        """
        known = np.isfinite(observed)
        with np.errstate(invalid="ignore", over="ignore"):
            error = predicted[:, known] - observed[known]
            spread = np.broadcast_to(variance, predicted.shape)[:, known]
            log_density = -0.5 * (error**2 / spread + np.log(spread)).sum(axis=1)
        evidence = self._forgetting * self._evidence + np.nan_to_num(
            log_density, nan=-np.inf, posinf=-np.inf
        )
        best = evidence.max()
        if np.isfinite(best):
            self._evidence = np.maximum(evidence - best, -EVIDENCE_MAX)

    def mean(self, predicted: FloatArray) -> FloatArray:
        """Return the weighted mean of the models' predictions, shape (m,).

        Args:
            predicted: Prediction of each model, shape (models, m). One that is not finite leaves
                the mean to the others; if none is finite, the mean is NaN.
        """
        return weighted_mean(self.weights, predicted)


def weighted_mean(weights: FloatArray, predicted: FloatArray) -> FloatArray:
    """Return the mean of predictions, shape (m,), for weights (models,), predictions (models, m).

    Each prediction that is not finite has no weight; where none has any, the mean is NaN.
    """
    finite = np.isfinite(predicted)
    if finite.all():
        return np.asarray(weights @ predicted)
    shares = np.where(finite, weights[:, np.newaxis], 0.0)
    total = shares.sum(axis=0)
    with np.errstate(invalid="ignore"):
        return np.asarray((shares * np.where(finite, predicted, 0.0)).sum(axis=0) / total)


def softmax(log_weights: FloatArray) -> FloatArray:
    """Return exp(log_weights), scaled to a sum of one, shape as given."""
    weights = np.exp(log_weights - log_weights.max())
    return np.asarray(weights / weights.sum())
