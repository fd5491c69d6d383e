"""The input of an exact Gaussian process fit: data, hyperparameters and bounds; and its status."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nufleet.shared.arrays import FloatArray

GRADIENT_TOLERANCE = 1e-7
"""Projected gradient, in log hyperparameters, at which a search has converged."""


@dataclass(frozen=True, init=False, eq=False)
class Hyperparameters:
    """Hyperparameters of the Matérn 3/2 kernel and the noise: one of each, or one per problem.

    Raises ValueError when a value is not finite, not positive (the noise variance may be 0), or an
    array with more than one dimension.
    """

    signal_variance: FloatArray
    """σ_f², in the targets' unit squared, shape () or (problems,)."""
    lengthscale: FloatArray
    """ℓ, in the inputs' unit, shape () or (problems,)."""
    noise_variance: FloatArray
    """σ_n² ≥ 0, in the targets' unit squared, shape () or (problems,)."""

    def __init__(
        self, signal_variance: ArrayLike, lengthscale: ArrayLike, noise_variance: ArrayLike
    ) -> None:
        values = {
            "signal_variance": np.asarray(signal_variance, dtype=np.float64),
            "lengthscale": np.asarray(lengthscale, dtype=np.float64),
            "noise_variance": np.asarray(noise_variance, dtype=np.float64),
        }
        for name, value in values.items():
            least = 0.0 if name == "noise_variance" else np.nextafter(0.0, 1.0)
            if value.ndim > 1 or not np.all(np.isfinite(value) & (value >= least)):
                raise ValueError(
                    f"{name} must be finite, positive and 0- or 1-dimensional: {value}"
                )
            object.__setattr__(self, name, value)

    def log(self, problems: int) -> FloatArray:
        """Return θ = (log σ_f², log ℓ, log σ_n²) for each problem, shape (problems, 3).

        Args:
            problems: Number of problems; single values are repeated for all of them.

        Raises:
            ValueError: a hyperparameter is given for another number of problems.
        """
        theta = np.empty((problems, 3))
        with np.errstate(divide="ignore"):
            theta[:, 0] = np.log(self.signal_variance)
            theta[:, 1] = np.log(self.lengthscale)
            theta[:, 2] = np.log(self.noise_variance)
        return theta

    @classmethod
    def from_log(cls, theta: FloatArray) -> Hyperparameters:
        """Return the hyperparameters for θ of shape (problems, 3), the inverse of `log`."""
        return cls(*np.exp(theta).T)


@dataclass(frozen=True)
class Bounds:
    """Closed intervals for the hyperparameters, the same for all problems.

    Equal ends fix a hyperparameter. Raises ValueError unless 0 < low ≤ high < ∞.
    """

    signal_variance: tuple[float, float]
    """Least and greatest σ_f², in the targets' unit squared."""
    lengthscale: tuple[float, float]
    """Least and greatest ℓ, in the inputs' unit."""
    noise_variance: tuple[float, float]
    """Least and greatest σ_n², in the targets' unit squared; (0, 0) if all noise is known."""

    def __post_init__(self) -> None:
        for name in ("signal_variance", "lengthscale", "noise_variance"):
            low, high = getattr(self, name)
            fixed_at_zero = name == "noise_variance" and low == high == 0.0
            if not (fixed_at_zero or 0.0 < low <= high < np.inf):
                raise ValueError(f"{name} needs 0 < low ≤ high < ∞, got ({low}, {high})")

    def log(self) -> FloatArray:
        """Return the least and the greatest θ = (log σ_f², log ℓ, log σ_n²), shape (2, 3)."""
        pairs = np.array([self.signal_variance, self.lengthscale, self.noise_variance])
        with np.errstate(divide="ignore"):
            return np.ascontiguousarray(np.log(pairs).T)

    def starts(self, start: Hyperparameters, lengthscales: int) -> list[Hyperparameters]:
        """Return `start` and copies of it with other lengthscales, log-spaced between the bounds.

        With few points the likelihood has several maxima, which differ mainly in ℓ.

        Args:
            start: Hyperparameters to vary.
            lengthscales: Number of copies.
        """
        low, high = self.lengthscale
        spaced = low * (high / low) ** ((np.arange(lengthscales) + 0.5) / lengthscales)
        return [start] + [
            Hyperparameters(start.signal_variance, ell, start.noise_variance) for ell in spaced
        ]


@dataclass(frozen=True, eq=False)
class Batch:
    """Independent regression problems, stored one after another; see `ragged` and `stacked`.

    Raises ValueError when shapes disagree, a number is not finite, a variance is negative, or a
    problem has no points.
    """

    inputs: FloatArray
    """Inputs x of all problems, shape (rows, d)."""
    targets: FloatArray
    """Targets y less their prior mean, shape (rows,)."""
    known_noise_variance: FloatArray
    """Known part v_i of each target's noise variance, in the targets' unit squared, shape (rows,).
    """
    offsets: NDArray[np.int64]
    """Row boundaries, shape (problems + 1,): problem p owns rows offsets[p] to offsets[p + 1] − 1.
    """

    def __post_init__(self) -> None:
        for name in ("inputs", "targets", "known_noise_variance"):
            array = np.require(getattr(self, name), np.float64, ["C", "W"])
            if not np.all(np.isfinite(array)):
                raise ValueError(f"{name} must be finite")
            object.__setattr__(self, name, array)
        rows = len(self.targets)
        if self.inputs.ndim != 2 or self.inputs.shape[0] != rows or self.inputs.shape[1] < 1:
            raise ValueError(f"inputs must have shape ({rows}, d ≥ 1), got {self.inputs.shape}")
        if self.targets.shape != (rows,) or self.known_noise_variance.shape != (rows,):
            raise ValueError(
                f"targets {self.targets.shape} and known_noise_variance "
                f"{self.known_noise_variance.shape} must both have shape (rows,)"
            )
        if np.any(self.known_noise_variance < 0.0):
            raise ValueError("known_noise_variance must not be negative")
        offsets = np.require(self.offsets, np.int64, ["C", "W"])
        if offsets.ndim != 1 or len(offsets) < 2 or offsets[0] != 0 or offsets[-1] != rows:
            raise ValueError(f"offsets must run from 0 to {rows}")
        if np.any(np.diff(offsets) < 1):
            raise ValueError("every problem needs at least one point")
        object.__setattr__(self, "offsets", offsets)

    def __len__(self) -> int:
        return len(self.offsets) - 1

    @property
    def columns(self) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.int64]]:
        """All four arrays of this class, in the order in which the compiled core takes them."""
        return self.inputs, self.targets, self.known_noise_variance, self.offsets

    @classmethod
    def ragged(
        cls,
        inputs: Sequence[FloatArray],
        targets: Sequence[FloatArray],
        known_noise_variance: Sequence[FloatArray] | None = None,
    ) -> Batch:
        """Build a batch from problems of different sizes.

        Args:
            inputs: Inputs of each problem, shape (n,) or (n, d).
            targets: Targets of each problem, shape (n,).
            known_noise_variance: Known noise variances of each problem, shape (n,), in the targets'
                unit squared; None means zero.

        Raises:
            ValueError: there is nothing to fit, shapes disagree, a number is not finite, or a
                variance is negative.
        """
        if known_noise_variance is None:
            known_noise_variance = [np.zeros(len(y)) for y in targets]
        sizes = [[len(a) for a in arrays] for arrays in (inputs, targets, known_noise_variance)]
        if not sizes[0] or sizes[0] != sizes[1] or sizes[0] != sizes[2]:
            raise ValueError(
                "inputs, targets and known noise must have equal lengths, and at least one problem"
            )
        return cls(
            np.concatenate([x[:, None] if x.ndim == 1 else x for x in inputs]),
            np.concatenate(targets),
            np.concatenate(known_noise_variance),
            np.concatenate([[0], np.cumsum(sizes[0])]),
        )

    @classmethod
    def stacked(
        cls,
        inputs: FloatArray,
        targets: FloatArray,
        known_noise_variance: FloatArray | None = None,
    ) -> Batch:
        """Build a batch from problems of one size.

        Args:
            inputs: Inputs shared by all problems, shape (n,) or (n, d), or one set per problem,
                shape (problems, n, d).
            targets: Targets, shape (problems, n).
            known_noise_variance: Known noise variances in the targets' unit squared, of any shape
                that broadcasts to (problems, n); None means zero.

        Raises:
            ValueError: there is nothing to fit, shapes disagree, a number is not finite, or a
                variance is negative.
        """
        if targets.ndim != 2:
            raise ValueError(f"targets must have shape (problems, n), got {targets.shape}")
        problems, n = targets.shape
        columns = inputs[:, None] if inputs.ndim == 1 else inputs
        known = np.zeros(()) if known_noise_variance is None else known_noise_variance
        return cls(
            np.broadcast_to(columns, (problems, n, columns.shape[-1])).reshape(problems * n, -1),
            targets.reshape(-1),
            np.broadcast_to(known, (problems, n)).reshape(-1),
            np.arange(problems + 1) * n,
        )


class FitStatus(IntEnum):
    """Outcome of the search for the hyperparameters of one problem."""

    CONVERGED = 0
    """The projected gradient is within its tolerance."""
    PRECISION_LIMIT = 1
    """Rounding or overflow hides any improvement that may be left."""
    EVALUATION_LIMIT = 2
    """The limit on likelihood evaluations was reached; the best point found is returned."""
    FAILED = 3
    """No jitter made the covariance at the start positive definite; the start is returned."""
