"""The description that a robot gives of itself before it moves: axes, limits, sample time."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import Field, model_validator

from nufleet.shared.models.linear_model import LinearModel
from nufleet.shared.strict import Name, NonNegative, Positive, Strict


class AxisSpec(Strict):
    """One axis of a robot's baseline loop, with the limits on the *reference* of a test.

    Examples:
        >>> axis = AxisSpec(
        ...     name="x", unit="m", amplitude_max=0.3, velocity_max=0.6, acceleration_max=1.6
        ... )
        >>> axis.velocity_max
        0.6
    """

    name: Name
    """Name of the axis."""
    unit: Literal["m", "rad"]
    """Unit of its reference and output."""
    amplitude_max: Positive
    """Largest amplitude of the reference, in the axis's unit."""
    velocity_max: Positive
    """Largest velocity of the reference, in unit/s."""
    acceleration_max: Positive
    """Largest acceleration of the reference, in unit/s²."""
    output_min: float | None = None
    output_max: float | None = None
    """Limits on the *measured* output (a geofence), in the axis's unit, around 0; None for none. A
    motion that leaves them ends, and the robot has a fault."""
    together: bool = True
    """Whether the axis may move at the same time as another in a test."""
    model: LinearModel | None = None
    """Exact model of the axis, known only for linear simulations; used to check estimates."""

    @model_validator(mode="after")
    def _holds_the_reference(self) -> AxisSpec:
        for name, limit in (("output_min", self.output_min), ("output_max", self.output_max)):
            if limit is not None and abs(limit) < self.amplitude_max:
                raise ValueError(
                    f"{name} {limit:g} {self.unit} of axis {self.name} is closer to 0 than its "
                    f"amplitude_max {self.amplitude_max:g} {self.unit}"
                )
        if (self.output_min or -1.0) >= 0.0 or (self.output_max or 1.0) <= 0.0:
            raise ValueError(f"axis {self.name} rests at 0, outside its output_min and output_max")
        return self


class TrackingLimits(Strict):
    """Limits on the path that a robot may be asked to track, and on the corrections to it."""

    position_max: Positive
    """Largest magnitude of the path on each axis, in the axes' unit."""
    speed_max: Positive
    """Largest speed along the path (Euclidean norm), in unit/s."""
    acceleration_max: Positive
    """Largest acceleration along the path (Euclidean norm), in unit/s²."""
    correction_max: Positive
    """Largest distance of the reference from the path on each axis, in the axes' unit."""
    correction_speed_max: Positive
    """Largest rate of change of that distance, in unit/s. Baseline controllers act on the speed of
    their reference, so a correction that jumps can throw a robot over."""


class RobotSpec(Strict):
    """A robot's description, available even while the robot is disconnected.

    Examples:
        >>> axis = AxisSpec(
        ...     name="x", unit="m", amplitude_max=0.3, velocity_max=0.6, acceleration_max=1.6
        ... )
        >>> spec = RobotSpec(
        ...     kind="my-drone",
        ...     axes=(axis,),
        ...     sample_time_s=0.02,
        ...     omega_min_rad_s=0.1,
        ...     omega_max_rad_s=6.0,
        ...     duration_max_s=300.0,
        ...     settling_time_s=4.0,
        ...     simulated=False,
        ... )
        >>> spec.axis("x").unit
        'm'
    """

    kind: Name
    """Kind of robot; experiences can be transferred only between robots of one kind."""
    axes: Annotated[tuple[AxisSpec, ...], Field(min_length=1, max_length=16)]
    """Axes of the baseline loop; their names differ."""
    sample_time_s: Positive
    """Time between samples."""
    omega_min_rad_s: Positive
    """Lowest frequency of a test."""
    omega_max_rad_s: Positive
    """Highest frequency of a test, below the Nyquist frequency."""
    duration_max_s: Positive
    """Longest motion that the robot accepts (battery, patience)."""
    settling_time_s: NonNegative
    """Time after which a transient of the baseline loop is negligible."""
    simulated: bool
    """True for a simulated robot."""
    tracking: TrackingLimits | None = None
    """Limits on paths; a robot without them accepts only frequency tests."""
    idle_s: Positive | None = None
    """Time without a motion after which the agent ends (lands) a robot that has begun; None to end
    it only with the agent."""
    measurement: Name = "own-sensor"
    """Chain from the robot to its measured output, such as `onboard` or `motion-capture`. The
    unknown delay of a chain is the same for all robots measured through it."""
    delay_uncertainty_s: NonNegative = 0.0
    """Standard deviation of the unknown part of that chain's delay."""

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
        """Return the axis of that name.

        Raises:
            KeyError: there is no such axis; the message lists the existing ones.
        """
        for axis in self.axes:
            if axis.name == name:
                return axis
        raise KeyError(f"no axis {name!r}; there are {[axis.name for axis in self.axes]}")
