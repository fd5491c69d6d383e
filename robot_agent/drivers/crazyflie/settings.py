"""The settings of one Crazyflie in a fleet file."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationError, field_validator, model_validator

from nufleet.robot_agent.drivers.crazyflie.address import problem_of
from nufleet.shared.robots.spec import AxisSpec, RobotSpec, TrackingLimits
from nufleet.shared.strict import Name, NonNegative, Positive, Strict, describe_validation

AxisName = Literal["x", "y", "z"]
AXES: tuple[AxisName, ...] = ("x", "y", "z")

CONTROLLERS = {"pid": 1, "mellinger": 2, "indi": 3, "brescianini": 4, "lee": 5}
"""The firmware's number of each position controller, for `stabilizer.controller`."""

ESTIMATORS = {"complementary": 1, "kalman": 2, "ukf": 3}
"""The firmware's number of each estimator, for `stabilizer.estimator`."""

_Coordinate = Annotated[float, Field(ge=-30, le=30)]  # full-state set-points hold ±32 m
Point = tuple[_Coordinate, _Coordinate, _Coordinate]


class Limits(Strict):
    """Limits on the reference of a frequency test on each axis, and where the drone may be."""

    amplitude_m: Positive = 0.3
    """Largest amplitude."""
    velocity_m_s: Positive = 0.6
    """Largest velocity."""
    acceleration_m_s2: Positive = 1.6
    """Largest acceleration."""
    fence_m: Positive = 1.0
    """Horizontal distance from the origin, and along z if that is an axis, beyond which a motion
    ends and the drone lands; also half the edge of the space for tracked paths. A drone that is
    further than this from its set-point lands where it is: its position may have jumped."""
    height_error_m: Positive = 0.3
    """The same for the height, where z is no axis."""


class StartPose(Strict):
    """Where the drone is put before it takes off, for estimators that have to be told."""

    position_m: Point
    """Position, in the estimator's frame."""
    yaw_rad: float = 0.0
    """Direction of its front, counter-clockwise from the x axis."""


class Battery(Strict):
    """What voltages mean. The defaults suit the Crazyflie's single lithium cell."""

    full_v: Positive = 4.1
    """Voltage of a full battery, in flight."""
    empty_v: Positive = 3.3
    """Voltage in flight below which the drone is not ready: its motion ends."""
    flight_time_s: Positive = 300.0
    """Time of flight from a full battery to an empty one."""
    reserve: Annotated[float, Field(ge=0, lt=1)] = 0.15
    """Share of the charge that is kept for coming back and landing."""

    @model_validator(mode="after")
    def _ordered(self) -> Battery:
        if self.empty_v >= self.full_v:
            raise ValueError(f"empty_v {self.empty_v:g} V must be below full_v {self.full_v:g} V")
        return self


class MotionCaptureSettings(Strict):
    """A motion capture system that tells the drone where it is."""

    system: Literal[
        "fzmotion",
        "motionanalysis",
        "nokov",
        "optitrack",
        "optitrack_closed_source",
        "qualisys",
        "vicon",
        "vrpn",
    ]
    """Kind of system, as the package `motioncapture` names it."""
    hostname: Annotated[str, Field(min_length=1)]
    """Host of its server."""
    body: Annotated[str, Field(min_length=1)]
    """Name of the drone's rigid body there."""
    attitude: bool = False
    """Whether the attitude is sent too; requires marker patterns that no rotation maps onto
    themselves."""
    rate_hz: Annotated[float, Field(gt=0, le=200)] = 50.0
    """Largest rate at which poses are sent to this drone; all share the radio."""


class CrazyflieSettings(Strict):
    """One Crazyflie, as it is reached, set up and flown."""

    uri: str
    """Where it is reached, as cflib writes it: `radio://0/80/2M/E7E7E7E7E7`, `usb://0` (on the
    ground), `udp://HOST:PORT` or `tcp://HOST:PORT`."""
    origin_m: Point = (0.0, 0.0, 0.5)
    """Where it hovers at reference 0, in the estimator's frame; the last number is the height."""
    start: StartPose | None = None
    """Where it stands before it takes off, for an estimator that has to be told; None for one that
    finds out, as with Lighthouse or motion capture."""
    start_within_m: Positive = 1.0
    """Horizontal distance from the origin beyond which it does not take off."""
    kind: Name = "quadrotor"
    """Kind of robot; experiences are transferred between robots of one kind."""
    axes: Annotated[tuple[AxisName, ...], Field(min_length=1, max_length=3)] = ("x", "y")
    """Axes that follow references."""
    limits: Limits = Limits()
    """Limits on its motion."""
    tracking: TrackingLimits | None = TrackingLimits(
        position_max=0.8,
        speed_max=0.8,
        acceleration_max=1.6,
        correction_max=0.2,
        correction_speed_max=0.4,
    )
    """Limits on tracked paths; None to track none."""
    setpoint: Literal["full_state", "position"] = "full_state"
    """What is sent: position and velocity, in whole millimetres, or position alone."""
    sample_time_s: Annotated[float, Field(ge=0.01, le=0.1)] = 0.02
    """Time between two set-points."""
    log_period_s: Annotated[float, Field(ge=0.01, le=0.1)] = 0.01
    """Time between two measurements, a multiple of 0.01 s; several drones on one radio may need
    0.02 s."""
    controller: Literal["pid", "mellinger", "indi", "brescianini", "lee"] | None = None
    """Position controller to select on board; None to leave what is set there."""
    estimator: Literal["complementary", "kalman", "ukf"] | None = "kalman"
    """Estimator to select on board; None to leave what is set there."""
    parameters: Annotated[dict[str, float], Field(default_factory=dict)]
    """Further parameters of the firmware, such as `"posCtlPid.xKp" = 1.8`."""
    takeoff_s: Annotated[float, Field(gt=0, le=20)] = 2.0
    """Time that it takes to climb to its height."""
    landing_s: Annotated[float, Field(gt=0, le=20)] = 2.5
    """Time that it takes to land."""
    rest_within_m: Positive = 0.04
    """Distance from reference 0 within which it rests."""
    settling_time_s: NonNegative = 4.0
    """Time in which it settles after a change of its reference."""
    omega_min_rad_s: Positive = 0.1
    """Lower edge of the band for frequency tests."""
    omega_max_rad_s: Positive = 5.4
    """Upper edge of the band for frequency tests."""
    duration_max_s: Positive = 180.0
    """Longest motion that it accepts."""
    idle_s: Positive = 15.0
    """Time in the air without a motion after which it lands."""
    battery: Battery = Battery()
    """What voltages mean."""
    watchdog: bool = False
    """Whether the firmware cuts the motors when it hears nothing for a second: also in the middle
    of taking off and landing, which it would complete by itself otherwise."""
    motion_capture: MotionCaptureSettings | None = None
    """Motion capture system that tells it where it is; None for one that finds out by itself."""
    delay_uncertainty_s: NonNegative = 0.001
    """Standard deviation of the unknown part of the delay of its measurements: they are dated as if
    the fastest of them had taken no time."""

    @field_validator("uri")
    @classmethod
    def _reachable(cls, uri: str) -> str:
        problem = problem_of(uri)
        if problem is not None:
            raise ValueError(problem)
        return uri

    @field_validator("log_period_s")
    @classmethod
    def _in_ticks(cls, period_s: float) -> float:
        if abs(period_s * 100 - round(period_s * 100)) > 1e-6:
            raise ValueError(f"{period_s:g} s is no multiple of 0.01 s")
        return period_s

    @model_validator(mode="after")
    def _flyable(self) -> CrazyflieSettings:
        if len(set(self.axes)) != len(self.axes):
            raise ValueError(f"axes must differ, got {', '.join(self.axes)}")
        if self.log_period_s > self.sample_time_s:
            raise ValueError(
                f"log_period_s {self.log_period_s:g} s is longer than sample_time_s "
                f"{self.sample_time_s:g} s: not every sample would be measured"
            )
        lower_m, why = self.lowest
        if self.origin_m[2] <= lower_m:
            raise ValueError(
                f"origin_m is {self.origin_m[2]:g} m high, and it may come {lower_m:g} m lower "
                f"({why}): it would touch the ground"
            )
        if self.tracking is not None and self.tracking.position_max > self.limits.fence_m:
            raise ValueError(
                f"tracking.position_max {self.tracking.position_max:g} m lies outside "
                f"limits.fence_m {self.limits.fence_m:g} m"
            )
        try:
            spec_of(self)
        except ValidationError as error:
            raise ValueError(describe_validation(error)) from error
        return self

    @property
    def lowest(self) -> tuple[float, str]:
        """How far below its origin a motion may lead, in m, and by which settings."""
        limits, tracking = self.limits, self.tracking
        if "z" not in self.axes:
            return limits.height_error_m, "limits.height_error_m"
        tested = (limits.amplitude_m, "limits.amplitude_m")
        if tracking is None:
            return tested
        tracked_m = tracking.position_max + tracking.correction_max
        return max(tested, (tracked_m, "tracking.position_max + tracking.correction_max"))


def spec_of(settings: CrazyflieSettings) -> RobotSpec:
    """Return the description of a robot with these settings.

    Raises:
        ValidationError: The settings contradict each other.
    """
    limits = settings.limits
    axes = tuple(
        AxisSpec(
            name=name,
            unit="m",
            amplitude_max=limits.amplitude_m,
            velocity_max=limits.velocity_m_s,
            acceleration_max=limits.acceleration_m_s2,
            output_min=-limits.fence_m,
            output_max=limits.fence_m,
        )
        for name in settings.axes
    )
    return RobotSpec(
        kind=settings.kind,
        axes=axes,
        sample_time_s=settings.sample_time_s,
        omega_min_rad_s=settings.omega_min_rad_s,
        omega_max_rad_s=settings.omega_max_rad_s,
        duration_max_s=settings.duration_max_s,
        settling_time_s=settings.settling_time_s,
        simulated=False,
        tracking=settings.tracking,
        idle_s=settings.idle_s,
        measurement="crazyflie-log",
        delay_uncertainty_s=settings.delay_uncertainty_s,
    )
