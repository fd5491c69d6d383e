"""What a fleet file says of a robot on ROS 2: its topics, its services and its limits."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from nufleet.shared.robots.spec import AxisSpec, RobotSpec, TrackingLimits
from nufleet.shared.strict import Fraction, Name, NonNegative, Positive, Strict

RosName = Annotated[
    str, Field(pattern=r"^/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*$", max_length=200)
]
"""Name of a topic or service; one that does not begin with `/` is in the robot's namespace."""
Component = Annotated[str, Field(min_length=1, max_length=100)]
"""`x`, `y`, `z` or `yaw` of a pose, or the name of a joint."""

POSE_UNITS: dict[str, Literal["m", "rad"]] = {"x": "m", "y": "m", "z": "m", "yaw": "rad"}
"""Components of a pose, with their units."""
JOINT_COMMAND = "trajectory_msgs/msg/JointTrajectory"
JOINT_MEASUREMENT = "sensor_msgs/msg/JointState"
TF = "tf2_msgs/msg/TFMessage"
UNSTAMPED = "geometry_msgs/msg/Pose"
TWISTS = ("geometry_msgs/msg/Twist", "geometry_msgs/msg/TwistStamped")

DELAY_UNCERTAINTY_S = {"synchronised": 0.001, "own-clock": 0.002, "arrival": 0.01}
"""Standard deviation of a chain's unknown delay unless the fleet file states it: by how much
synchronised clocks differ, half the least time that a message travels, and half a usual time."""


class Qos(Strict):
    """Quality of service of a topic; durability is volatile, and history keeps the last."""

    reliability: Literal["reliable", "best_effort"]
    """Whether lost messages are sent again; late measurements and set-points are of no use."""
    depth: Annotated[int, Field(ge=1, le=1000)] = 10
    """Messages kept for a reader that is late."""


class CommandTopic(Strict):
    """The topic on which the robot takes its set-points."""

    topic: RosName
    """Name of the topic."""
    type: Literal[
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/Twist",
        "geometry_msgs/msg/TwistStamped",
        "trajectory_msgs/msg/MultiDOFJointTrajectory",
        "trajectory_msgs/msg/JointTrajectory",
    ]
    """Type of its messages. A trajectory has one point, which is due one sample later."""
    frame_id: str | None = None
    """Frame in the messages' headers; None for `base_link` of a TwistStamped in the frame of the
    body, and for `map` otherwise."""
    velocity: bool = False
    """Whether points of trajectories also state the velocity of the reference."""
    gain_1_s: Positive | None = None
    """For a Twist: velocity commanded for each unit of distance between reference and output, on
    top of the velocity of the reference, up to the axis's `velocity_max` (0.25 m/s or rad/s for
    what is no axis). This gain is then part of the baseline controller."""
    twist_frame: Literal["body", "world"] = "body"
    """For a Twist: frame in which the robot takes its velocities."""
    qos: Qos = Qos(reliability="reliable", depth=1)
    """Quality of service offered to the robot."""

    @model_validator(mode="after")
    def _has_a_gain(self) -> CommandTopic:
        if (self.type in TWISTS) != (self.gain_1_s is not None):
            raise ValueError(
                "gain_1_s belongs to a Twist, which commands velocities, and only to it"
            )
        return self

    @property
    def frame(self) -> str:
        """Frame in the messages' headers."""
        in_body = self.type in TWISTS and self.twist_frame == "body"
        return self.frame_id or ("base_link" if in_body else "map")


class MeasurementTopic(Strict):
    """The topic on which the robot's position is reported."""

    topic: RosName
    """Name of the topic; `/tf` for transforms."""
    type: Literal[
        "nav_msgs/msg/Odometry",
        "geometry_msgs/msg/PoseStamped",
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "geometry_msgs/msg/Pose",
        "tf2_msgs/msg/TFMessage",
        "sensor_msgs/msg/JointState",
    ]
    """Type of its messages."""
    parent: str | None = None
    child: str | None = None
    """For transforms: frames of the one transform that is the robot's pose."""
    stamps: Literal["own-clock", "synchronised", "arrival"] = "own-clock"
    """What the messages' time stamps mean. `own-clock`: times of a clock of their own, which is
    compared with this computer's through the messages that travelled fastest. `synchronised`: times
    of this computer's clock, or of one that PTP or chrony keeps equal. `arrival`: nothing, so the
    time at which a message arrives counts. In simulated time, stamps are of the simulation's
    clock."""
    source: Name = "onboard"
    """What measures, such as `motion-capture`: robots with equal sources share its unknown
    delay."""
    delay_uncertainty_s: NonNegative | None = None
    """Standard deviation of the unknown part of the delay; None for what the stamps allow."""
    qos: Qos = Qos(reliability="best_effort")
    """Quality of service asked of the publisher."""

    @model_validator(mode="after")
    def _consistent(self) -> MeasurementTopic:
        frames = self.parent is not None and self.child is not None
        if frames != (self.type == TF) or (self.parent is None) != (self.child is None):
            raise ValueError(f"parent and child are the frames of a {TF}, which needs both")
        if self.type == UNSTAMPED and self.stamps != "arrival":
            raise ValueError(f'a {UNSTAMPED} has no time stamp: state stamps = "arrival"')
        return self


class Services(Strict):
    """Services of type std_srvs/srv/Trigger or std_srvs/srv/SetBool; None for what is not there."""

    arm: RosName | None = None
    """Arms; a SetBool also disarms."""
    disarm: RosName | None = None
    """Disarms; required if `arm` is a Trigger."""
    take_off: RosName | None = None
    """Takes off."""
    land: RosName | None = None
    """Lands."""
    kill: RosName | None = None
    """Cuts the motors."""
    take_off_s: Annotated[float, Field(ge=0, le=20)] = 5.0
    """Time from the answer of `take_off` until the robot hovers."""
    land_s: Annotated[float, Field(ge=0, le=14)] = 5.0
    """Time from the answer of `land` after which the robot is expected on the ground. It is
    disarmed only after it was seen there."""
    land_tolerance_m: Positive = 0.15
    """Distance of the measured z from where the robot was armed at which it is on the ground."""
    timeout_s: Annotated[float, Field(gt=0, le=14)] = 10.0
    """Longest time until a service answers, except `kill`."""

    @model_validator(mode="after")
    def _lands(self) -> Services:
        if (self.take_off is None) != (self.land is None):
            raise ValueError("take_off and land: a robot has both or neither")
        return self

    @property
    def disarms(self) -> bool:
        """Whether there is a service that disarms."""
        return self.arm is not None or self.disarm is not None

    @property
    def named(self) -> dict[str, str]:
        """Names of the services that are there, by what they do."""
        roles = ("arm", "disarm", "take_off", "land", "kill")
        return {role: name for role in roles if (name := getattr(self, role)) is not None}


class BatteryTopic(Strict):
    """The topic on which the robot reports its battery."""

    topic: RosName
    """Name of the topic, of type sensor_msgs/msg/BatteryState."""
    reserve: Fraction = 0.2
    """Share of the charge that is kept for coming back and landing."""
    motion_s: Positive | None = None
    """Time of motion from a full battery to an empty one; None if unknown."""


class Ros2Axis(AxisSpec):
    """One axis of the baseline loop, and where it is in the messages."""

    component: Component | None = None
    """Component of the pose, or the joint; the axis's name if None."""
    origin: float = 0.0
    """Value of the component at reference 0, in the frame of the topics."""

    @property
    def of(self) -> str:
        """The component or joint."""
        return self.component or self.name


class Ros2Settings(Strict):
    """One robot on ROS 2."""

    kind: Name
    """Kind of robot; experiences can be transferred only between robots of one kind."""
    namespace: Annotated[str, Field(pattern=r"^(/[A-Za-z_][A-Za-z0-9_]*)*$", max_length=200)] = ""
    """Namespace of all names that do not begin with `/`, such as `/cf1`."""
    domain_id: Annotated[int, Field(ge=0, le=232)] | None = None
    """ROS domain; None for the one in ROS_DOMAIN_ID."""
    use_sim_time: bool = False
    """Whether the robot is simulated, and its simulator publishes `/clock`."""
    command: CommandTopic
    """Topic of the set-points."""
    measurement: MeasurementTopic
    """Topic of the measured position."""
    axes: Annotated[tuple[Ros2Axis, ...], Field(min_length=1, max_length=16)]
    """The axes."""
    hold: Annotated[dict[Component, float], Field(default_factory=dict)]
    """Values of components or joints that are no axes, in the frame of the topics. A pose keeps
    those that are neither where they were when the robot began."""
    hold_tolerance: Positive = 0.2
    """Largest distance in m or rad of a component that is no axis from its place at which the robot
    counts as ready to move; a larger one ends a motion."""
    services: Services = Services()
    """Services."""
    battery: BatteryTopic | None = None
    """Topic of the battery; None if it is not reported."""
    sample_time_s: Annotated[float, Field(ge=0.001, le=1)]
    """Time between two set-points."""
    omega_min_rad_s: Positive
    """Lowest frequency of a test."""
    omega_max_rad_s: Positive
    """Highest frequency of a test."""
    duration_max_s: Positive
    """Longest motion that the robot accepts."""
    settling_time_s: NonNegative
    """Time after which a transient of the baseline loop is negligible."""
    idle_s: Positive | None = None
    """Time without a motion after which the robot lands, required with `services.take_off`; None to
    disarm it only with the agent."""
    tracking: TrackingLimits | None = None
    """Limits on paths; a robot without them accepts only frequency tests."""

    @model_validator(mode="after")
    def _consistent(self) -> Ros2Settings:
        joints = self.command.type == JOINT_COMMAND
        if joints != (self.measurement.type == JOINT_MEASUREMENT):
            raise ValueError(
                f"a robot that takes {self.command.type} is not measured by "
                f"{self.measurement.type}: joints are commanded and measured, or a pose"
            )
        moved = [axis.of for axis in self.axes]
        twice = {one for one in moved if moved.count(one) > 1} | (set(moved) & set(self.hold))
        if twice:
            raise ValueError(f"{', '.join(sorted(twice))}: moved by two axes, or moved and held")
        unknown = {*moved, *self.hold} - set(POSE_UNITS)
        if unknown and not joints:
            raise ValueError(
                f"{', '.join(sorted(unknown))}: a pose has the components {', '.join(POSE_UNITS)}"
            )
        for axis in self.axes:
            if not joints and axis.unit != POSE_UNITS[axis.of]:
                raise ValueError(
                    f"axis {axis.name}: the unit of {axis.of} is {POSE_UNITS[axis.of]}"
                )
        if self.services.take_off is not None and joints:
            raise ValueError("services.take_off: a robot with joints reports no height to land by")
        if self.services.take_off is not None and self.idle_s is None:
            raise ValueError(
                "idle_s: a robot that takes off needs it, or it hovers until its agent ends"
            )
        self.spec()
        return self

    @property
    def joints(self) -> bool:
        """Whether the robot has joints; it has a pose otherwise."""
        return self.command.type == JOINT_COMMAND

    @property
    def commanded(self) -> tuple[str, ...]:
        """Components or joints that are commanded: axes first, in their order, then the others.

        A pose is commanded as a whole, and a Twist moves nothing that it need not.
        """
        needed = (*(axis.of for axis in self.axes), *self.hold)
        if self.joints or self.command.type in TWISTS:
            return needed
        return (*needed, *(one for one in POSE_UNITS if one not in needed))

    @property
    def measured(self) -> tuple[str, ...]:
        """Components or joints that have to be measured: those that are commanded come first."""
        turned = ("yaw",) if self.command.type in TWISTS else ()
        landed = () if self.services.land is None else ("z",)
        return tuple(dict.fromkeys((*self.commanded, *turned, *landed)))

    @property
    def reports_height(self) -> bool:
        """Whether a z is measured."""
        return not self.joints and "z" in self.measured

    def full(self, name: str) -> str:
        """Return a name with the namespace before it unless it is absolute."""
        return name if name.startswith("/") else f"{self.namespace}/{name}"

    def spec(self) -> RobotSpec:
        """Return the robot's description."""
        axis_fields, measured = AxisSpec.model_fields, self.measurement
        stamps = "synchronised" if self.use_sim_time else measured.stamps
        uncertain_s = measured.delay_uncertainty_s
        return RobotSpec(
            kind=self.kind,
            axes=tuple(
                AxisSpec(**{field: getattr(axis, field) for field in axis_fields})
                for axis in self.axes
            ),
            sample_time_s=self.sample_time_s,
            omega_min_rad_s=self.omega_min_rad_s,
            omega_max_rad_s=self.omega_max_rad_s,
            duration_max_s=self.duration_max_s,
            settling_time_s=self.settling_time_s,
            simulated=self.use_sim_time,
            tracking=self.tracking,
            idle_s=self.idle_s,
            measurement=f"{measured.source}-by-arrival" if stamps == "arrival" else measured.source,
            delay_uncertainty_s=(
                DELAY_UNCERTAINTY_S[stamps] if uncertain_s is None else uncertain_s
            ),
        )
