"""Robots on ROS 2 as in fleet files, and a link that plays one in virtual time without ROS 2."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from nufleet.robot_agent.drivers.ros2.clocks import Arrivals, Arrived
from nufleet.robot_agent.drivers.ros2.messages import SetPoint
from nufleet.robot_agent.drivers.ros2.robot import Ros2Robot
from nufleet.robot_agent.drivers.ros2.settings import TWISTS, Ros2Settings
from nufleet.shared.errors import RobotError

AXIS = {"name": "x", "unit": "m", "amplitude_max": 0.3, "velocity_max": 0.6}
DRONE: dict[str, Any] = {
    "kind": "lab-drone",
    "namespace": "/cf1",
    "command": {"topic": "command", "type": "geometry_msgs/msg/PoseStamped"},
    "measurement": {"topic": "measured", "type": "nav_msgs/msg/Odometry"},
    "axes": [
        {**AXIS, "acceleration_max": 1.6, "origin": 0.5},
        {**AXIS, "acceleration_max": 1.6, "name": "y"},
    ],
    "sample_time_s": 0.02,
    "omega_min_rad_s": 0.3,
    "omega_max_rad_s": 8.0,
    "duration_max_s": 240.0,
    "settling_time_s": 2.0,
}
FLYING = {"arm": "arm", "take_off": "take_off", "land": "land", "kill": "kill"}
ARM: dict[str, Any] = {
    **DRONE,
    "command": {"topic": "command", "type": "trajectory_msgs/msg/JointTrajectory"},
    "measurement": {"topic": "measured", "type": "sensor_msgs/msg/JointState"},
    "axes": [
        {**AXIS, "name": "elbow", "unit": "rad", "acceleration_max": 1.6, "component": "Elbow_1"}
    ],
    "hold": {"Wrist_1": 0.4},
}
CART: dict[str, Any] = {
    **DRONE,
    "command": {"topic": "cmd_vel", "type": "geometry_msgs/msg/Twist", "gain_1_s": 3.0},
}


def settings(document: dict[str, Any] = DRONE, **changes: Any) -> Ros2Settings:
    return Ros2Settings.model_validate_json(json.dumps({**document, **changes}))


class VirtualArrivals(Arrivals):
    """Measurements that come as virtual time passes."""

    tick: Callable[[], None]

    def next(self, timeout_s: float) -> Arrived:
        before = self._count
        for _ in range(round(timeout_s / TICK_S)):
            self.tick()
            if self._count > before:
                break
        return super().next(0.0) if self._count == before else self._kept[-1]


TICK_S = 0.01


class VirtualLink:
    """A robot that goes a share of the way to its set-point every 10 ms, and says what it heard.

    Taking off lifts it, and landing brings it back to the height 0.
    """

    def __init__(self, own: Ros2Settings, start: dict[str, float]) -> None:
        self.settings = own
        self.place = {name: start.get(name, 0.0) for name in own.measured}
        self.goal = {} if own.command.type in TWISTS else dict(self.place)
        self.velocity: dict[str, float] = {}
        self.time_s = self.sent_at_s = 1000.0
        self.sent: list[SetPoint] = []
        self.sent_s: list[float] = []
        self.calls: list[tuple[str, bool]] = []
        self.refusals: dict[str, str] = {}
        self.battery: float | None = None
        self.resend: Callable[[], None] | None = None
        self.silent = self.closed = False
        self.repeats: dict[str, float] | None = None  # what is measured from now on
        self.stamp_offset_s, self.delay_s = 77.0, 0.002
        self.found: str | None = None
        self.at_call: Callable[[], None] = lambda: None
        self.lift_m, self.share = 1.0, 0.1
        self.kill_requests = 0
        self.arrivals = VirtualArrivals("/cf1/measured", own.measured, "own-clock")
        self.arrivals.tick = self.tick
        self.tick()

    def tick(self) -> None:
        self.time_s += TICK_S
        for name, goal in self.goal.items():
            self.place[name] += self.share * (goal - self.place[name])
        for name, speed in self.velocity.items():
            self.place[name] += TICK_S * speed
        if not self.silent:
            stamp_s = self.time_s + self.stamp_offset_s
            self.taken_s = self.time_s
            seen = dict(self.repeats or self.place)
            self.arrivals.take(stamp_s - self.delay_s, self.time_s, seen)
        period_s = self.settings.sample_time_s
        if self.resend is not None and self.time_s - self.sent_at_s > 1.5 * period_s:
            self.resend()

    def now_s(self) -> float:
        return self.time_s

    def wait_until(self, due_s: float) -> None:
        while self.time_s < due_s - 1e-9:
            self.tick()
        self.time_s = max(self.time_s, due_s)

    def send(self, point: SetPoint) -> float:
        self.sent.append(point)
        self.sent_s.append(self.time_s)
        self.sent_at_s = self.time_s
        if self.settings.command.type in TWISTS:
            self.velocity = dict(point.velocities)
        else:
            self.goal.update(point.positions)
        return self.time_s

    def keep_sending(self, resend: Callable[[], None] | None) -> None:
        self.resend = resend

    def call(self, role: str, engage: bool, timeout_s: float, requests: int = 1) -> None:
        if role == "kill":
            self.kill_requests = requests
        if role in self.refusals:
            self.at_call()
            raise RobotError(f"the service {role} refused: {self.refusals[role]}")
        self.calls.append((role, engage))
        if role in ("take_off", "land") and "z" in self.place:
            self.goal["z"] = self.lift_m if role == "take_off" else 0.0
        self.at_call()

    def problem(self) -> str | None:
        return self.found

    def charge(self) -> float | None:
        return self.battery

    def close(self) -> None:
        self.closed = True


class Lab:
    """A robot and its link; every connection opens a new one."""

    def __init__(self, own: Ros2Settings, **start: float) -> None:
        self.links: list[VirtualLink] = []
        self.start = start

        def opened(_: str, described: Ros2Settings) -> VirtualLink:
            self.links.append(VirtualLink(described, self.start))
            return self.links[-1]

        self.robot = Ros2Robot("cf-1", own, opened)

    @property
    def link(self) -> VirtualLink:
        return self.links[-1]


class Message(SimpleNamespace):
    """A message whose fields come into being when they are named, as deep as needed."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)
        made = Message()
        setattr(self, name, made)
        return made
