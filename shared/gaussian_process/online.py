"""A Gaussian process for a control loop: a few outputs over one window, refitted every step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nufleet.shared.arrays import FloatArray
from nufleet.shared.gaussian_process.problem import GRADIENT_TOLERANCE, Bounds, Hyperparameters


class OnlineFit:
    """Independent processes for several outputs over the same inputs, fitted to convergence.

    Each output has its own hyperparameters. The constructor allocates all memory and loads (or
    compiles) the core, so that `refit` and `predict` take only as long as their arithmetic. Each
    refit starts from the hyperparameters that the previous one found. The posterior is the paper's
    eq. (2), with the prior mean subtracted from the targets beforehand. Not thread-safe.
    """

    def __init__(
        self,
        *,
        capacity: int,
        dimension: int,
        outputs: int,
        start: Hyperparameters,
        bounds: Bounds,
        evaluations_max: int = 100,
    ) -> None:
        """Allocate memory for windows of up to `capacity` points and load the compiled core.

        Args:
            capacity: Largest number of points in a window.
            dimension: Number of inputs per point.
            outputs: Number of outputs per point.
            start: Hyperparameters of the first refit, one set for all outputs or one per output.
            bounds: Bounds on the hyperparameters of every output.
            evaluations_max: Limit on likelihood evaluations per output and refit.

        Raises:
            ValueError: a size is below 1, or `start` is given for another number of outputs.
        """
        if min(capacity, dimension, outputs, evaluations_max) < 1:
            raise ValueError("capacity, dimension, outputs and evaluations_max must be at least 1")
        from nufleet.shared.gaussian_process import core

        self._core = core
        self._capacity, self._dimension, self._outputs = capacity, dimension, outputs
        self._start = start.log(outputs)
        self._search = (bounds.log(), GRADIENT_TOLERANCE, evaluations_max)
        self._inputs = np.zeros((outputs * capacity, dimension))
        self._targets = np.zeros(outputs * capacity)
        self._offsets = np.zeros(outputs + 1, dtype=np.int64)
        # No part of the noise is known, so it is zero for every target.
        self._columns = (self._inputs, self._targets, np.zeros(outputs * capacity), self._offsets)
        self._first_points = np.empty((1, outputs, 3))
        self._theta = self._start.copy()
        self._outcomes = np.zeros((outputs, 3))
        self._counts = np.zeros((outputs, 2), dtype=np.int64)

    @property
    def hyperparameters(self) -> Hyperparameters:
        """Hyperparameters of the last refit, one set per output; the start before the first."""
        return Hyperparameters.from_log(self._theta)

    @property
    def log_marginal_likelihood(self) -> FloatArray:
        """Log marginal likelihood of each output at the last refit, shape (outputs,)."""
        return self._outcomes[:, 0].copy()

    @property
    def evaluations(self) -> NDArray[np.int64]:
        """Number of likelihood evaluations in the last refit, shape (outputs,)."""
        return self._counts[:, 0].copy()

    @property
    def status(self) -> NDArray[np.int64]:
        """The `FitStatus` of the last refit, shape (outputs,)."""
        return self._counts[:, 1].copy()

    def restart(self) -> None:
        """Make the next refit begin at the constructor's `start` rather than at its predecessor."""
        self._theta[:] = self._start

    def refit(self, x: FloatArray, y: FloatArray) -> None:
        """Replace the window and maximise each output's marginal likelihood.

        Args:
            x: Inputs, shape (n, dimension), 1 ≤ n ≤ capacity.
            y: Targets less their prior mean, shape (n, outputs).

        Raises:
            ValueError: a shape is wrong or a number is not finite; the previous window is kept.
        """
        n = len(x)
        if not 1 <= n <= self._capacity or x.shape != (n, self._dimension):
            raise ValueError(
                f"x must have shape (1 to {self._capacity}, {self._dimension}), got {x.shape}"
            )
        if y.shape != (n, self._outputs):
            raise ValueError(f"y must have shape ({n}, {self._outputs}), got {y.shape}")
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            raise ValueError("x and y must be finite")
        for output in range(self._outputs):
            rows = slice(output * n, (output + 1) * n)
            self._inputs[rows] = x
            self._targets[rows] = y[:, output]
            self._offsets[output + 1] = rows.stop
        self._first_points[0] = self._theta
        found = (self._theta, self._outcomes, self._counts)
        starts = self._first_points
        self._core.fit_range(*self._columns, 0, self._outputs, starts, *self._search, *found)

    def predict(self, x_query: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the posterior mean and variance of the outputs, without noise.

        Before the first refit this is the prior.

        Args:
            x_query: Points to predict at, shape (queries, dimension).

        Returns:
            Mean and variance, each of shape (queries, outputs), in the outputs' unit and its
            square.

        Raises:
            ValueError: the shape is wrong or a number is not finite.
        """
        if x_query.ndim != 2 or x_query.shape[1] != self._dimension:
            raise ValueError(
                f"x_query must have shape (queries, {self._dimension}), got {x_query.shape}"
            )
        if not np.isfinite(x_query).all():
            raise ValueError("x_query must be finite")
        shape = (self._outputs, len(x_query))
        mean, variance = np.empty(shape), np.empty(shape)
        queries = np.require(x_query.T, np.float64, ["C", "W"])
        self._core.posterior_range(
            *self._columns, 0, self._outputs, self._theta, queries, mean, variance
        )
        return mean.T, variance.T
