"""What is kept of a flight along a path."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.wire.motions import TakenBack

STOPPED = "stopped"
"""Value of `TrackingRecord.failure` for a flight that was ended on request."""


@dataclass(frozen=True, eq=False)
class TrackingRecord:
    """The record of one flight along a path, with one row per sample played."""

    sample_time_s: float
    """Sample time in seconds."""

    desired: FloatArray
    """Path y_d, shape (samples, axes), in the axes' units."""

    reference: FloatArray
    """References y_r sent, shape (samples, axes), in the axes' units."""

    actual: FloatArray
    """Outputs y_a measured, shape (samples, axes), in the axes' units."""

    prior: FloatArray
    """The prior's part of γ (see `InverseLayout`), shape (samples, axes), in unit/s; zero for the
    baseline alone, like `mean` and `variance`. For corrections known ahead, their speed."""

    mean: FloatArray
    """The online process's part of γ, shape (samples, axes), in unit/s; for corrections known
    ahead, the speed of what a feedback adds."""

    variance: FloatArray
    """Variance of `mean`, shape (samples, axes), in unit²/s²."""

    weights: FloatArray
    """Weights of a mixture, shape (samples, experts + 1), none's last; (samples, 0) without one."""

    share: FloatArray
    """Share of the correction that the guard let act, shape (samples,), from 0 to 1."""

    limited: np.ndarray
    """True where the correction was cut to its bounds, shape (samples,)."""

    step_time_s: FloatArray
    """Time that choosing each reference took, the robot not included, shape (samples,)."""

    dropped_pairs: int
    """Number of training pairs dropped because they were not finite."""

    taken_back: TakenBack | None
    """When and why the guard withdrew the prior; None when it did not, or without a guard."""

    failure: str | None
    """Why the path was not finished; None when it was."""

    @property
    def rms_error(self) -> float:
        """Root mean square of the distance to the path, in the axes' unit; infinite if unfinished.

        It is sqrt(mean_k |y_a(k) − y_d(k)|²).
        """
        if self.failure is not None:
            return math.inf
        return float(np.sqrt(np.mean(np.sum((self.actual - self.desired) ** 2, axis=1))))

    @property
    def deadline_misses(self) -> int:
        """Number of references that took longer to choose than a sample lasts."""
        return int((self.step_time_s > self.sample_time_s).sum())
