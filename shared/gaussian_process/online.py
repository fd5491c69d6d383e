"""The Gaussian process of a control loop: a few outputs over one window, refitted every step."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nufleet.shared.arrays import FloatArray
from nufleet.shared.gaussian_process.problem import Bounds, Hyperparameters


class OnlineFit:
    """Outputs that share their inputs, each with its own hyperparameters, fitted to convergence.

    Memory is allocated and the core loaded (or compiled) when it is made, so that `refit` and
    `predict` take the time of their arithmetic. A refit starts from the hyperparameters that the
    last one found. Not for calls from two threads at once.
    """

    def __init__(
        self,
        *,
        capacity: int,
        dimension: int,
        outputs: int,
        start: Hyperparameters,
        bounds: Bounds,
        gradient_tolerance: float = 1e-7,
        evaluations_max: int = 100,
    ) -> None:
        """Prepare for windows of up to `capacity` points, with so many inputs and outputs.

        Raises:
            ValueError: a size below 1, or a start for another number of outputs.
        """
        if min(capacity, dimension, outputs, evaluations_max) < 1:
            raise ValueError("capacity, dimension, outputs and evaluations_max must be at least 1")
        from nufleet.shared.gaussian_process import core

        self._core = core
        self._capacity, self._dimension, self._outputs = capacity, dimension, outputs
        self._bounds = bounds.log()
        self._start = start.log(outputs)
        self._gradient_tolerance, self._evaluations_max = gradient_tolerance, evaluations_max
        self._inputs = np.zeros((outputs * capacity, dimension))
        self._targets = np.zeros(outputs * capacity)
        self._known = np.zeros(outputs * capacity)
        self._offsets = np.zeros(outputs + 1, dtype=np.int64)
        self._first_points = np.empty((1, outputs, 3))
        self._theta = self._start.copy()
        self._outcomes = np.zeros((outputs, 3))
        self._counts = np.zeros((outputs, 2), dtype=np.int64)

    @property
    def hyperparameters(self) -> Hyperparameters:
        """What the last refit found, one of each per output; the start before there was one."""
        return Hyperparameters.from_log(self._theta)

    @property
    def log_marginal_likelihood(self) -> FloatArray:
        """The maximum the last refit found, shape (outputs,)."""
        return self._outcomes[:, 0].copy()

    @property
    def evaluations(self) -> NDArray[np.int64]:
        """How many likelihoods the last refit took, shape (outputs,)."""
        return self._counts[:, 0].copy()

    @property
    def status(self) -> NDArray[np.int64]:
        """The `FitStatus` of the last refit, shape (outputs,)."""
        return self._counts[:, 1].copy()

    def restart(self) -> None:
        """Let the next refit begin at the start given at first, not at the last hyperparameters."""
        self._theta[:] = self._start

    def refit(self, x: FloatArray, y: FloatArray) -> None:
        """Take a new window and maximise each output's marginal likelihood.

        Args:
            x: inputs, shape (n, dimension), 1 ≤ n ≤ capacity.
            y: targets less their prior mean, shape (n, outputs).

        Raises:
            ValueError: another shape, or a number that is not finite; the last window stays.
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
        self._core.fit_range(
            self._inputs,
            self._targets,
            self._known,
            self._offsets,
            0,
            self._outputs,
            self._first_points,
            self._bounds,
            self._gradient_tolerance,
            self._evaluations_max,
            self._theta,
            self._outcomes,
            self._counts,
        )

    def predict(self, x_query: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the posterior mean and the variance without noise, shape (queries, outputs) each.

        Args:
            x_query: shape (queries, dimension). Before the first refit the answer is the prior.

        Raises:
            ValueError: another shape, or a number that is not finite.
        """
        if x_query.ndim != 2 or x_query.shape[1] != self._dimension:
            raise ValueError(
                f"x_query must have shape (queries, {self._dimension}), got {x_query.shape}"
            )
        if not np.isfinite(x_query).all():
            raise ValueError("x_query must be finite")
        shape = (self._outputs, len(x_query))
        mean, variance = np.empty(shape), np.empty(shape)
        self._core.posterior_range(
            self._inputs,
            self._targets,
            self._known,
            self._offsets,
            0,
            self._outputs,
            self._theta,
            np.require(x_query.T, np.float64, ["C", "W"]),
            mean,
            variance,
        )
        return mean.T, variance.T
