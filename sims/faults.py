"""Faults of a robot's sensor and of its driver, as entries of a fleet file.

Sensor faults change the measurements that the driver returns; the robot's own controller keeps its
sound sensor. Driver faults stop the driver at a sample: an error, a crash, a hang.
"""

from __future__ import annotations

from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from nufleet.shared.strict import NonNegative, Positive, Strict

Probability = Annotated[float, Field(ge=0, le=1)]
SampleCount = Annotated[int, Field(ge=0)]


class FaultBase(Strict):
    """The motions and samples at which a fault acts.

    Samples and times are counted from the beginning of the motion. Without a length, the fault
    lasts to the motion's end.
    """

    motion: Annotated[int, Field(ge=1)] | None = None
    """Number of the motion, from 1, in which the fault acts; None for every motion."""

    from_sample: SampleCount | None = None
    """First sample at which it acts; excludes `from_s`."""

    from_s: NonNegative | None = None
    """Time from which it acts, in seconds; excludes `from_sample`."""

    samples: Annotated[int, Field(ge=1)] | None = None
    """Length in samples; excludes `for_s`."""

    for_s: Positive | None = None
    """Length in seconds; excludes `samples`."""

    @model_validator(mode="after")
    def _said_once(self) -> FaultBase:
        if self.from_sample is not None and self.from_s is not None:
            raise ValueError("give either from_sample or from_s, not both")
        if self.samples is not None and self.for_s is not None:
            raise ValueError("give either samples or for_s, not both")
        return self

    def acts(self, motion: int, sample: int, count: int, sample_time_s: float) -> NDArray[np.bool_]:
        """Return a mask of the next samples of a motion at which the fault acts.

        Args:
            motion: Number of the motion, from 1.
            sample: Index of the next sample in the motion.
            count: Number of samples.
            sample_time_s: Sample time in seconds.

        Returns:
            True where the fault acts, shape (count,).
        """
        if self.motion not in (None, motion):
            return np.zeros(count, dtype=np.bool_)
        first = self.first_sample(sample_time_s)
        length = self.samples
        if self.for_s is not None:
            length = max(1, round(self.for_s / sample_time_s))
        index = np.arange(sample, sample + count)
        return (index >= first) & (index < (np.inf if length is None else first + length))

    def first_sample(self, sample_time_s: float) -> int:
        """Return the index of the first sample of a motion at which the fault acts."""
        if self.from_sample is not None:
            return self.from_sample
        return round((self.from_s or 0.0) / sample_time_s)


class NotANumber(FaultBase):
    """Each sample reads NaN with this probability."""

    kind: Literal["not-a-number"]
    """Discriminator of the fault's type."""
    probability: Probability = 1.0
    """Probability at each sample."""


class Infinite(FaultBase):
    """Each sample reads infinity, of either sign, with this probability."""

    kind: Literal["infinite"]
    """Discriminator of the fault's type."""
    probability: Probability = 1.0
    """Probability at each sample."""


class Frozen(FaultBase):
    """The sensor repeats its last reading, with noise of standard deviation `noise` on top."""

    kind: Literal["frozen"]
    """Discriminator of the fault's type."""
    noise: NonNegative = 0.0
    """Standard deviation of the noise, in the axis's unit."""


class Saturated(FaultBase):
    """The sensor's readings are clipped to the range from `low` to `high`."""

    kind: Literal["saturated"]
    """Discriminator of the fault's type."""
    low: float
    """Smallest reading, in the axis's unit."""
    high: float
    """Largest reading, in the axis's unit."""

    @model_validator(mode="after")
    def _a_range(self) -> Saturated:
        if not self.low < self.high:
            raise ValueError(f"low must be below high, got {self.low:g} and {self.high:g}")
        return self


class Noisy(FaultBase):
    """White noise of standard deviation `std` is added to the robot's own."""

    kind: Literal["noisy"]
    """Discriminator of the fault's type."""
    std: NonNegative
    """Standard deviation of the noise, in the axis's unit."""


class Spikes(FaultBase):
    """Single samples are far off."""

    kind: Literal["spikes"]
    """Discriminator of the fault's type."""

    probability: Probability
    """Probability of a spike at each sample."""

    height: float
    """Amount by which a spike is off, up or down, in the axis's unit."""

    replace: bool = False
    """Whether a spike reads `height` itself instead."""


class Late(FaultBase):
    """Each reading is `late_min` to `late_max` samples old, drawn independently for each sample."""

    kind: Literal["late"]
    """Discriminator of the fault's type."""
    late_min: SampleCount = 0
    """Smallest age of a reading, in samples."""
    late_max: Annotated[int, Field(ge=0, le=1000)]
    """Largest age of a reading, in samples."""

    @model_validator(mode="after")
    def _a_range(self) -> Late:
        if self.late_min > self.late_max:
            raise ValueError(f"late_min {self.late_min} exceeds late_max {self.late_max}")
        return self


class Held(FaultBase):
    """Samples drop out, and the last reading is repeated instead.

    At every sample a drop-out of `run` samples begins with this probability.
    """

    kind: Literal["held"]
    """Discriminator of the fault's type."""
    probability: Probability
    """Probability at each sample that a drop-out begins."""
    run: Annotated[int, Field(ge=1)] = 1
    """Length of a drop-out in samples."""


class DropOut(FaultBase):
    """The driver reports an error (`RobotError`) instead of a sample, with this probability."""

    kind: Literal["drop-out"]
    """Discriminator of the fault's type."""
    probability: Probability = 1.0
    """Probability at each sample."""


class Crash(FaultBase):
    """The driver ends: its process at once, or with an exception that no driver should raise."""

    kind: Literal["crash"]
    """Discriminator of the fault's type."""
    way: Literal["exits", "raises"]
    """Whether the process ends, or the driver raises an exception."""


class Hang(FaultBase):
    """The driver does not return from a sample for `hang_s` seconds; for ever if that is None."""

    kind: Literal["hang"]
    """Discriminator of the fault's type."""
    hang_s: Positive | None = None
    """Time in s until the driver returns; None for ever."""


SensorFault = NotANumber | Infinite | Frozen | Saturated | Noisy | Spikes | Late | Held
DriverFault = DropOut | Crash | Hang
Fault = Annotated[SensorFault | DriverFault, Field(discriminator="kind")]
