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

    The order of the models has no influence.
    """

    def __init__(self, start: FloatArray, *, forgetting: float = 1.0, ease: float = 1.0) -> None:
        """Begin with the probabilities of the start.

        Args:
            start: Prior probability of each model, shape (models,); positive, with sum one.
            forgetting: Factor a in (0, 1] by which the evidence so far shrinks at each `observe`.
            ease: Share in (0, 1] of the way from its present value to the probability that a weight
                goes at each `observe`.

        Raises:
            ValueError: The start holds no probabilities, or a factor is outside (0, 1].
        """
        probabilities = np.asarray(start, dtype=np.float64)
        if probabilities.ndim != 1 or not (probabilities > 0).all():
            raise ValueError(f"the weights at the start must be positive, got {start}")
        if abs(float(probabilities.sum()) - 1.0) > 1e-9:
            raise ValueError(f"the weights at the start must add up to 1, got {start}")
        for name, factor in (("forgetting", forgetting), ("ease", ease)):
            if not 0 < factor <= 1:
                raise ValueError(f"{name} must be above 0 and at most 1, got {factor}")
        self._log_start = np.log(probabilities)
        self._forgetting, self._ease = forgetting, ease
        self._evidence = np.zeros(len(probabilities))
        self.weights = probabilities
        """Weight with which each model takes part, shape (models,); the sum is one."""

    @property
    def probabilities(self) -> FloatArray:
        """Posterior probability of each model, shape (models,), which the weights approach."""
        scores = self._log_start + self._evidence
        relative = np.exp(scores - scores.max())
        return np.asarray(relative / relative.sum())

    def observe(self, predicted: FloatArray, variance: FloatArray, observed: FloatArray) -> None:
        """Take what turned out, after what each model predicted of it.

        Args:
            predicted: Mean of each model's prediction, shape (models, m). A model whose prediction
                is not finite falls behind as far as a model can.
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
        self.weights = self.weights + self._ease * (self.probabilities - self.weights)

    def mean(self, predicted: FloatArray) -> FloatArray:
        """Return the weighted mean of predictions, shape (m,), for predictions (models, m)."""
        return np.asarray(self.weights @ predicted)
