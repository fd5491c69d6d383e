"""What a robot says of itself before it moves: axes, limits, sample time."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from nufleet.shared.models.linear_model import LinearModel
from nufleet.shared.strict import Name, NonNegative, Positive, Strict


class AxisSpec(Strict):
    """One axis of a robot's baseline loop, and how far, fast and hard it may be driven.

    The limits are in the axis's unit, unit/s and unit/s²; they bound the *reference* of a test.
    """

    name: Name
    unit: Literal["m", "rad"]
    amplitude_max: Positive
    velocity_max: Positive
    acceleration_max: Positive
    model: LinearModel | None = None


class TrackingLimits(Strict):
    """What a path to be tracked may ask of a robot, in its axes' unit.

    `position_max` bounds each axis of the path, `speed_max` and `acceleration_max` the Euclidean
    norms along it. On each axis the reference sent may be `correction_max` away from the path, and
    that correction may change at `correction_speed_max`: baseline controllers act on the speed of
    their reference, so a correction that jumps can throw a robot over.
    """

    position_max: Positive
    speed_max: Positive
    acceleration_max: Positive
    correction_max: Positive
    correction_speed_max: Positive


class RobotSpec(Strict):
    """A robot's description, readable while it is disconnected.

    `settling_time_s` is the time after which a transient of the baseline loop is negligible;
    `duration_max_s` is the longest motion the robot accepts (battery, patience). A robot without
    `tracking` limits only takes frequency tests.
    """

    kind: Name
    axes: Annotated[tuple[AxisSpec, ...], Field(min_length=1, max_length=16)]
    sample_time_s: Positive
    omega_min_rad_s: Positive
    omega_max_rad_s: Positive
    duration_max_s: Positive
    settling_time_s: NonNegative
    simulated: bool
    tracking: TrackingLimits | None = None

    @model_validator(mode="after")
    def _consistent(self) -> RobotSpec:
        names = [axis.name for axis in self.axes]
        if len(set(names)) != len(names):
            raise ValueError(f"axis names must differ, got {names}")
        if self.omega_min_rad_s >= self.omega_max_rad_s:
            raise ValueError("omega_min_rad_s must be below omega_max_rad_s")
        nyquist_rad_s = math.pi / self.sample_time_s
        if self.omega_max_rad_s >= nyquist_rad_s:
            raise ValueError(
                f"omega_max_rad_s must be below the Nyquist frequency {nyquist_rad_s:.4g} rad/s"
            )
        return self

    def axis(self, name: str) -> AxisSpec:
        """Return the axis of that name; raises KeyError with the names there are."""
        for axis in self.axes:
            if axis.name == name:
                return axis
        raise KeyError(f"no axis {name!r}; there are {[axis.name for axis in self.axes]}")
