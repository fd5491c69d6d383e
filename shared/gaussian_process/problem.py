"""What an exact Gaussian process is fitted to, and how a fit ends."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nufleet.shared.arrays import FloatArray


@dataclass(frozen=True, init=False, eq=False)
class Hyperparameters:
    """Signal variance σ_f², lengthscale ℓ and noise variance σ_n²: one of each, or one per problem.

    The variances are in the targets' unit squared, the lengthscale in the inputs'. σ_n² may be 0.
    """

    signal_variance: FloatArray
    lengthscale: FloatArray
    noise_variance: FloatArray

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
        """Return the hyperparameters of θ, shape (problems, 3)."""
        return cls(*np.exp(theta).T)


@dataclass(frozen=True)
class Bounds:
    """Closed intervals, the same for all problems; equal ends fix a hyperparameter.

    The noise variance may be fixed at 0, when all noise is known.
    """

    signal_variance: tuple[float, float]
    lengthscale: tuple[float, float]
    noise_variance: tuple[float, float]

    def __post_init__(self) -> None:
        for name in ("signal_variance", "lengthscale", "noise_variance"):
            low, high = getattr(self, name)
            fixed_at_zero = name == "noise_variance" and low == high == 0.0
            if not (fixed_at_zero or 0.0 < low <= high < np.inf):
                raise ValueError(f"{name} needs 0 < low ≤ high < ∞, got ({low}, {high})")

    def log(self) -> FloatArray:
        """Return the least and the greatest θ, shape (2, 3)."""
        pairs = np.array([self.signal_variance, self.lengthscale, self.noise_variance])
        with np.errstate(divide="ignore"):
            return np.ascontiguousarray(np.log(pairs).T)

    def starts(self, start: Hyperparameters, lengthscales: int) -> list[Hyperparameters]:
        """Return `start` and copies of it with other lengthscales, log-spaced between the bounds.

        Few points make a likelihood with several maxima, which differ in ℓ above all.
        """
        low, high = self.lengthscale
        spaced = low * (high / low) ** ((np.arange(lengthscales) + 0.5) / lengthscales)
        return [start] + [
            Hyperparameters(start.signal_variance, ell, start.noise_variance) for ell in spaced
        ]


@dataclass(frozen=True, eq=False)
class Batch:
    """Independent regression problems; problem p owns rows offsets[p] to offsets[p + 1].

    inputs (rows, d), targets and known_noise_variance (rows,), offsets (problems + 1,); `ragged`
    and `stacked` build it.
    """

    inputs: FloatArray
    targets: FloatArray
    known_noise_variance: FloatArray
    offsets: NDArray[np.int64]

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

    @classmethod
    def ragged(
        cls,
        inputs: Sequence[FloatArray],
        targets: Sequence[FloatArray],
        known_noise_variance: Sequence[FloatArray] | None = None,
    ) -> Batch:
        """Build problems of different sizes.

        Args:
            inputs: per problem, shape (n,) or (n, d).
            targets: per problem, shape (n,).
            known_noise_variance: per problem, shape (n,); none is known if left out.

        Raises:
            ValueError: nothing to fit, shapes that disagree, numbers that are not finite, or a
                negative variance.
        """
        if known_noise_variance is None:
            known_noise_variance = [np.zeros(len(y)) for y in targets]
        sizes = [[len(a) for a in arrays] for arrays in (inputs, targets, known_noise_variance)]
        if not sizes[0] or sizes[0] != sizes[1] or sizes[0] != sizes[2]:
            raise ValueError(
                "inputs, targets and known noise must have equal lengths, and problems"
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
        """Build problems of one size.

        Args:
            inputs: shared by all problems, shape (n,) or (n, d), or their own, (problems, n, d).
            targets: shape (problems, n).
            known_noise_variance: broadcasts to (problems, n); none is known if left out.

        Raises:
            ValueError: as for `ragged`.
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
    """How the search for the hyperparameters of one problem ended."""

    CONVERGED = 0
    """The projected gradient is within its tolerance."""
    PRECISION_LIMIT = 1
    """Rounding, or overflow, hides what is left to gain."""
    EVALUATION_LIMIT = 2
    """The likelihood was evaluated as often as allowed; the best point so far is returned."""
    FAILED = 3
    """No jitter made the covariance at the start positive definite; the start is returned."""
