"""Weighs several models by how well their common prediction would have met what turned out.

The weights w ≥ 0 with sum one are the most probable ones under the predictions' own Gaussian
uncertainty and a prior around the weights s at the start,

    w = argmin Σ_j a^(k − j) (Σ_i w_i e_ij)² / v_j + c Σ_i (w_i − s_i)² / s_i

where e_ij is the error of model i at time j, v_j its variance, and a the forgetting factor, since
the best weights may change during a flight. This is stacking (Breiman, Machine Learning 24, 1996;
Yao, Vehtari, Simpson and Gelman, Bayesian Analysis 13, 2018) as a recursion with the forgetting of
dynamic model averaging (Raftery, Kárný and Ettler, Technometrics 52, 2010). Bayesian model
averaging (Hoeting, Madigan, Raftery and Volinsky, Statistical Science 14, 1999) weighs by the
probability that a model is the true one and ends with the closest one alone; among robots none is
the true one, and a mean of two that err in opposite directions is closer than either.

The prior term is c (Σ_i w_i² / s_i − 1) for weights of sum one, so the whole is a quadratic form
q(w). |L w|² + (Σ_i w_i − 1)² over w ≥ 0 with LᵀL = q has the same minimiser over the simplex,
once scaled to a sum of one, since it equals q / (1 + q) at the best scale: a least-squares problem
with non-negative unknowns (Lawson and Hanson, Solving Least Squares Problems, 1974, ch. 23).
"""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray

ERROR_MAX = 30.0
"""Largest error of a model that counts, in standard deviations of its prediction.

A model that was wrong once by very much could otherwise not return when it becomes right. What all
models have in common, such as a gust of wind, does not change the weights."""


_ROUNDING = 1e-12


class Mixture:
    """Weights of several models, and what they predict together.

    The order of the models has no influence.
    """

    def __init__(
        self,
        start: FloatArray,
        *,
        concentration: float = 1.0,
        forgetting: float = 1.0,
        ease: float = 1.0,
    ) -> None:
        """Begin with the weights of the start.

        Args:
            start: Weight of each model before anything is observed, shape (models,); positive, with
                sum one.
            concentration: How firmly the start is believed, c above.
            forgetting: Factor a in (0, 1] by which earlier observations shrink at each `observe`.
            ease: Share in (0, 1] of the way from its present to its best value that a weight goes
                at each `observe`.

        Raises:
            ValueError: The start is none, or a number is outside its range.
        """
        weights = np.asarray(start, dtype=np.float64)
        if weights.ndim != 1 or not (weights > 0).all():
            raise ValueError(f"the weights at the start must be positive, got {start}")
        if abs(float(weights.sum()) - 1.0) > 1e-9:
            raise ValueError(f"the weights at the start must add up to 1, got {start}")
        for name, factor in (("forgetting", forgetting), ("ease", ease)):
            if not 0 < factor <= 1:
                raise ValueError(f"{name} must be above 0 and at most 1, got {factor}")
        if not concentration > 0:
            raise ValueError(f"concentration must be above 0, got {concentration}")
        self._forgetting, self._ease = forgetting, ease
        self._prior = concentration / weights
        self._squares = np.zeros((len(weights), len(weights)))
        self._best = weights
        self.weights = weights
        """Weight with which each model takes part, shape (models,); the sum is one."""

    @property
    def best(self) -> FloatArray:
        """Weights that explain the observations best, shape (models,), which `weights` approach."""
        return self._best

    def observe(self, predicted: FloatArray, variance: FloatArray, observed: FloatArray) -> None:
        """Take what turned out, after what each model predicted of it.

        Args:
            predicted: Mean of each model's prediction, shape (models, m). One that is not finite
                counts as wrong by `ERROR_MAX`.
            variance: Variance of the predictions, measurement noise included, shape (m,); positive.
            observed: What was measured, shape (m,). Numbers that are not finite count for nothing.
        """
        known = np.isfinite(observed)
        with np.errstate(invalid="ignore", over="ignore"):
            errors = (predicted[:, known] - observed[known]) / np.sqrt(variance[known])
        errors = np.clip(np.nan_to_num(errors, nan=ERROR_MAX), -ERROR_MAX, ERROR_MAX)
        self._squares = self._forgetting * self._squares + errors @ errors.T
        form = self._squares + np.diag(self._prior)
        # The scale of the form does not matter; one near 1 keeps the digits of both terms.
        found = _non_negative(form / form.trace() + 1.0, np.ones(len(form)), self._best)
        self._best = found / found.sum()
        self.weights = self.weights + self._ease * (self._best - self.weights)

    def mean(self, predicted: FloatArray) -> FloatArray:
        """Return the weighted mean of predictions, shape (m,), for predictions (models, m)."""
        return np.asarray(self.weights @ predicted)


def _non_negative(matrix: FloatArray, right: FloatArray, start: FloatArray) -> FloatArray:
    """Return the minimum of ½ xᵀAx − bᵀx over x ≥ 0, shape (n,), by Lawson and Hanson's method.

    Unknowns that would become negative return to zero, and others leave it, the one first that
    promises most. From the solution of a similar problem it takes one or two rounds. SciPy's `nnls`
    does the same; without it no agent imports SciPy's optimisers.

    Args:
        matrix: Positive definite matrix A, shape (n, n), of a size near 1.
        right: Vector b, shape (n,).
        start: Point to start from, shape (n,), with no negative number.
    """
    found, free = start, start > 0
    for _ in range(3 * len(right)):
        while free.any():
            wished = np.zeros(len(right))
            wished[free] = np.linalg.solve(matrix[free][:, free], right[free])
            negative = free & (wished <= 0)
            if not negative.any():
                found = wished
                break
            # As far as the first of them allows, which then returns to zero.
            away = found[negative] / (found[negative] - wished[negative])
            found = found + away.min() * (wished - found)
            first = np.flatnonzero(negative)[away.argmin()]
            free[first], found[first] = False, 0.0
        promise = np.where(free, -np.inf, right - matrix @ found)
        if promise.max() <= _ROUNDING:
            break
        free[promise.argmax()] = True
    return found
