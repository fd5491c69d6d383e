"""What a fleet file says of a vehicle that is reached over MAVLink."""

from __future__ import annotations

import math
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, ValidationError, model_validator

from nufleet.robot_agent.drivers.mavlink.address import Address
from nufleet.shared.robots.spec import AxisSpec, RobotSpec, TrackingLimits
from nufleet.shared.strict import Fraction, Name, NonNegative, Positive, Strict, describe_validation

AXES = ("x", "y", "z")
"""Names of the axes that a vehicle may have: to the east, to the north, and up."""


def _checked_url(url: str) -> str:
    Address.parsed(url)
    return url


FENCE_SHARE = 3.0
"""Default geofence, as a multiple of the largest reference."""


class MavlinkAxis(Strict):
    """One axis, with the limits on its reference and its measured output; see `AxisSpec`."""

    name: Literal["x", "y", "z"]
    """Direction: `x` to the east, `y` to the north, `z` up."""
    amplitude_max: Positive
    """Largest amplitude of the reference, in m."""
    velocity_max: Positive
    """Largest velocity of the reference, in m/s."""
    acceleration_max: Positive
    """Largest acceleration of the reference, in m/s²."""
    output_min: float | None = None
    output_max: float | None = None
    """Limits on the measured position around the origin (a geofence), in m; None for
    `FENCE_SHARE` times the largest reference."""
    together: bool = True
    """Whether the axis may move at the same time as another in a test."""

    def spec(self, tracking: TrackingLimits | None) -> AxisSpec:
        """Return the axis as the agent knows it.

        Args:
            tracking: Limits on the paths of the robot.
        """
        fence_m = FENCE_SHARE * self.reach_m(tracking)
        given = self.model_dump()
        given["output_min"] = -fence_m if self.output_min is None else self.output_min
        given["output_max"] = fence_m if self.output_max is None else self.output_max
        return AxisSpec(unit="m", **given)

    def reach_m(self, tracking: TrackingLimits | None) -> float:
        """Return the largest distance of a reference from 0, in a test or on a path."""
        if tracking is None:
            return self.amplitude_max
        return max(self.amplitude_max, tracking.position_max + tracking.correction_max)


class MavlinkSettings(Strict):
    """One multicopter in a fleet file; the lab chooses its limits, not the vehicle."""

    profile: Literal["px4", "ardupilot"]
    """Autopilot: `px4` flies in offboard mode, `ardupilot` (Copter) in guided mode."""
    url: Annotated[str, AfterValidator(_checked_url)]
    """Address, such as `udpin://0.0.0.0:14540` or `serial:///dev/ttyACM0:57600`."""
    system_id: Annotated[int, Field(ge=1, le=255)] = 1
    """MAVLink system id of the vehicle (PX4 MAV_SYS_ID, ArduPilot SYSID_THISMAV)."""
    component_id: Annotated[int, Field(ge=1, le=255)] = 1
    """MAVLink component id of its autopilot."""
    own_system_id: Annotated[int, Field(ge=1, le=255)] = 245
    """System id under which the driver sends; no vehicle or ground station may have it, too."""

    kind: Name = "multicopter"
    """Kind of robot; experiences can be transferred only between robots of one kind."""
    axes: Annotated[tuple[MavlinkAxis, ...], Field(min_length=1, max_length=3)]
    """The axes, in any order."""
    sample_time_s: Annotated[float, Field(ge=0.005, le=0.25)] = 0.02
    """Time between two set-points. PX4 leaves offboard mode without two of them a second."""
    omega_min_rad_s: Positive = 0.2
    """Lowest frequency of a test."""
    omega_max_rad_s: Positive = 6.0
    """Highest frequency of a test."""
    duration_max_s: Annotated[float, Field(gt=0, le=3600)] = 120.0
    """Longest motion."""
    settling_time_s: NonNegative = 4.0
    """Time after which a transient of the position loop is negligible."""
    tracking: TrackingLimits | None = None
    """Limits on paths; without them the robot accepts only frequency tests."""
    idle_s: Positive = 20.0
    """Time without a motion after which the vehicle lands."""

    height_m: Annotated[float, Field(ge=0.3, le=100)] = 1.5
    """Height of reference 0 above the place of take-off."""
    origin_m: tuple[float, float] | None = None
    """Reference 0 as (east, north) in the vehicle's local frame; None for above the place of
    take-off. A vehicle that stands more than 2 m from it does not take off."""
    yaw_deg: Annotated[float, Field(ge=-180, le=180)] | None = None
    """Direction of the nose, anticlockwise from the east; None for as it stands."""
    climb_m_s: Annotated[float, Field(gt=0, le=3)] = 0.7
    """Speed of take-off and of the ways to the origin."""
    other_axes_error_m: Positive = 0.5
    """Distance from the origin, along each direction that is not an axis, at which a motion ends
    and the vehicle lands."""
    feed_forward: bool = True
    """Whether set-points hold the velocity of the reference, too."""

    measured_by: Literal["LOCAL_POSITION_NED", "ODOMETRY"] = "LOCAL_POSITION_NED"
    """Message with the measured position. PX4's ODOMETRY has stamps in µs, the other in ms."""
    telemetry_hz: Annotated[float, Field(ge=5, le=500)] = 50.0
    """Rate of that message, which is requested by SET_MESSAGE_INTERVAL."""
    measurement: Name = "onboard"
    """Chain from the vehicle to its measured position; see `RobotSpec`."""
    delay_uncertainty_s: Annotated[float, Field(ge=0, le=0.1)] = 0.005
    """Standard deviation of the unknown part of that chain's delay, with the error of the clock. A
    vehicle whose clock is known less well is refused."""

    battery_min: Fraction = 0.25
    """Charge below which the vehicle does not begin a motion."""
    flight_time_s: Positive | None = None
    """Time in the air from a full battery to an empty one; None for unknown, and then a motion is
    not compared with the charge that is left."""
    kill: Literal["disarm", "flight-termination"] = "disarm"
    """What `nufleet stop --kill` sends: MAV_CMD_COMPONENT_ARM_DISARM with force, or
    MAV_CMD_DO_FLIGHTTERMINATION, which may release a parachute."""

    @model_validator(mode="after")
    def _consistent(self) -> MavlinkSettings:
        try:
            _ = self.spec
        except ValidationError as error:
            raise ValueError(describe_validation(error)) from error
        if self.own_system_id == self.system_id:
            raise ValueError(
                f"own_system_id: {self.own_system_id} is the vehicle's own system_id; give the "
                "driver another one"
            )
        deepest_m = max((a.reach_m(self.tracking) for a in self.axes if a.name == "z"), default=0.0)
        if deepest_m > self.height_m - GROUND_CLEARANCE_M:
            raise ValueError(
                f"axes: z moves {deepest_m:g} m down from a height_m of "
                f"{self.height_m:g} m; at least {GROUND_CLEARANCE_M:g} m above the ground must be "
                "left"
            )
        climbs_s = self.way_s(self.height_m)
        if climbs_s > CLIMB_MAX_S:
            raise ValueError(
                f"height_m: the climb to {self.height_m:g} m takes {climbs_s:.0f} s within "
                f"climb_m_s and the limits of the axes; at most {CLIMB_MAX_S:g} s are allowed"
            )
        if self.telemetry_hz * math.pi < self.omega_max_rad_s:
            raise ValueError(
                f"telemetry_hz: {self.telemetry_hz:g} measurements a second cannot tell "
                f"{self.omega_max_rad_s:g} rad/s"
            )
        return self

    def way_s(self, distance_m: float) -> float:
        """Return how long a way along a raised cosine lasts, in s, within the limits of all axes.

        d (1 − cos π t / τ) / 2 reaches the speed π d / 2 τ and the acceleration π² d / 2 τ².
        """
        slowest = min([self.climb_m_s, *(axis.velocity_max for axis in self.axes)])
        gentlest = min(axis.acceleration_max for axis in self.axes)
        return math.pi * max(distance_m / 2 / slowest, math.sqrt(distance_m / 2 / gentlest))

    @property
    def stray_max_m(self) -> float:
        """Distance from its set-point, in m, from which a vehicle is not led back any more."""
        fences = [axis.spec(self.tracking) for axis in self.axes]
        reach_m = [(one.output_max or 0.0) - (one.output_min or 0.0) for one in fences]
        return max(self.other_axes_error_m, max(reach_m) / 2)

    @property
    def spec(self) -> RobotSpec:
        """The robot as its agent knows it."""
        return RobotSpec(
            kind=self.kind,
            axes=tuple(axis.spec(self.tracking) for axis in self.axes),
            simulated=False,
            **{name: getattr(self, name) for name in _OF_THE_SPEC},
        )


GROUND_CLEARANCE_M = 0.2
"""Height above the ground below which no reference leads."""

CLIMB_MAX_S = 30.0
"""Longest climb: an agent takes a driver that does not return for a minute for one that hangs."""

_OF_THE_SPEC = (
    "sample_time_s",
    "omega_min_rad_s",
    "omega_max_rad_s",
    "duration_max_s",
    "settling_time_s",
    "tracking",
    "idle_s",
    "measurement",
    "delay_uncertainty_s",
)
