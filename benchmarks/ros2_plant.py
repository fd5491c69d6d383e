"""A ROS 2 node that plays a robot: known linear loops behind a link with jitter and loss.

`python -m benchmarks.ros2_plant '{"namespace": "/cf1", ...}'` runs it until its standard input
ends. Each component of the pose, or each joint, is y'' = ω₀² (r - y) - 2 ζ ω₀ y', where r is the
set-point that arrived last, `delay_s` after it did. Its own clock may differ from this computer's.
"""

from __future__ import annotations

import heapq
import json
import math
import os
import select
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass
class PlantSettings:
    """The robot, its link, and what may be wrong with it."""

    namespace: str = ""
    domain_id: int = 0
    command: str = "geometry_msgs/msg/PoseStamped"
    measurement: str = "nav_msgs/msg/Odometry"
    components: tuple[str, ...] = ("x", "y", "z", "yaw")
    start: dict[str, float] = field(default_factory=dict)
    omega_0_rad_s: float = 6.0
    damping: float = 0.7
    delay_s: float = 0.03
    noise_std: float = 0.0005
    rate_hz: float = 100.0
    jitter_s: float = 0.0
    loss: float = 0.0
    clock_ahead_s: float = 0.0
    clock_rate: float = 1.0
    stamped: bool = True
    services: bool = True
    battery: float | None = 0.9
    goes_back_after: int | None = None
    falls_silent_after: int | None = None
    refuses: tuple[str, ...] = ()
    publishes_clock: bool = False
    reliability: str = "reliable"
    seed: int = 0


class Loop:
    """One component, advanced exactly from set-point to set-point."""

    def __init__(self, settings: PlantSettings, start: float, now_s: float) -> None:
        self._settings, self._at_s = settings, now_s
        self._y, self._v, self._reference = start, 0.0, start
        self._coming: list[tuple[float, float]] = []

    def command(self, reference: float, at_s: float) -> None:
        self._coming.append((at_s + self._settings.delay_s, reference))

    def output(self, now_s: float) -> float:
        while self._coming and self._coming[0][0] <= now_s:
            at_s, reference = self._coming.pop(0)
            self._advance(at_s)
            self._reference = reference
        self._advance(now_s)
        return self._y

    def _advance(self, to_s: float) -> None:
        lasts_s, self._at_s = max(0.0, to_s - self._at_s), max(to_s, self._at_s)
        omega, zeta = self._settings.omega_0_rad_s, self._settings.damping
        sigma, turned = zeta * omega, omega * math.sqrt(1 - zeta**2)
        e, decay = self._y - self._reference, math.exp(-sigma * lasts_s)
        c, s = math.cos(turned * lasts_s), math.sin(turned * lasts_s)
        b = (self._v + sigma * e) / turned
        self._y = self._reference + decay * (e * c + b * s)
        self._v = decay * (self._v * c - (sigma * b + turned * e) * s)


def response(settings: PlantSettings, omega: np.ndarray, period_s: float) -> np.ndarray:
    """Return the mean response from references to outputs, sampled when references are sent.

    Args:
        settings: The robot.
        omega: Frequencies in rad/s, shape (tones,).
        period_s: Sample time.
    """
    w, zeta = settings.omega_0_rad_s, settings.damping
    sigma, turned = zeta * w, w * math.sqrt(1 - zeta**2)
    n = np.arange(math.ceil(20 / sigma / period_s) + 1)

    def step(t: np.ndarray) -> np.ndarray:
        late = np.maximum(t, 0)
        value = 1 - np.exp(-sigma * late) * (
            np.cos(turned * late) + sigma / turned * np.sin(turned * late)
        )
        return np.where(t > 0, value, 0.0)

    gains = step(n * period_s - settings.delay_s) - step((n - 1) * period_s - settings.delay_s)
    held = np.exp(-1j * np.outer(omega, n) * period_s) @ gains
    p = settings.loss
    held *= (1 - p) / (1 - p * np.exp(-1j * omega * period_s))
    if settings.jitter_s:
        # Set-points stay in order, so that one that is overtaken waits.
        sent_s = period_s * np.arange(400_000)
        late_s = np.random.default_rng(1).exponential(settings.jitter_s, len(sent_s))
        late_s = np.maximum.accumulate(sent_s + late_s) - sent_s
        held *= np.array([np.mean(np.exp(-1j * one * late_s)) for one in omega])
    return held


class Plant:
    """The node. A heap holds what is on its way, so that one thread does everything."""

    def __init__(self, settings: PlantSettings) -> None:
        import rclpy
        from rclpy.context import Context
        from rclpy.executors import SingleThreadedExecutor
        from rclpy.node import Node
        from rclpy.qos import QoSProfile, ReliabilityPolicy
        from std_srvs.srv import SetBool, Trigger

        from nufleet.robot_agent.drivers.ros2.node import _new, _type

        self.settings, self._new = settings, _new
        self._rng = np.random.default_rng(settings.seed)
        self._context = Context()
        rclpy.init(args=[], context=self._context, domain_id=settings.domain_id)
        self._node = Node(
            "plant", context=self._context, namespace=settings.namespace or "/", enable_rosout=False
        )
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self._node)
        now_s = time.monotonic()
        self._loops = {
            name: Loop(settings, settings.start.get(name, 0.0), now_s)
            for name in settings.components
        }
        self._coming: list[tuple[float, int, Callable[[], None]]] = []
        self._last_s = {"in": 0.0, "out": 0.0}
        self._count = self._order = 0
        self._killed = False
        self.heard: dict[str, int] = {}
        qos = QoSProfile(depth=10, reliability=ReliabilityPolicy[settings.reliability.upper()])
        self._node.create_subscription(
            _type(settings.command),
            "command",
            lambda m: self._later("in", lambda: self._hear(m)),
            qos,
        )
        self._out = self._node.create_publisher(_type(settings.measurement), "measured", qos)
        self._battery = self._node.create_publisher(
            _type("sensor_msgs/msg/BatteryState"), "battery", 1
        )
        self._clock = None
        if settings.publishes_clock:
            self._clock = self._node.create_publisher(_type("rosgraph_msgs/msg/Clock"), "/clock", 1)
        if settings.services:
            for name, kind in (
                ("arm", SetBool),
                ("take_off", Trigger),
                ("land", Trigger),
                ("kill", Trigger),
            ):
                self._node.create_service(kind, name, self._served(name))

    def _served(self, name: str) -> Callable[[Any, Any], Any]:
        def serve(request: Any, answer: Any) -> Any:
            answer.success = name not in self.settings.refuses
            answer.message = "" if answer.success else f"no {name} today"
            said = f"{name} {request.data}" if hasattr(request, "data") else name
            print(said, flush=True)
            if name == "kill":
                self._killed = True
            if name == "take_off" and "z" in self._loops:
                self._loops["z"].command(1.0, time.monotonic())
            return answer

        return serve

    def run(self) -> None:
        period_s = 1 / self.settings.rate_hz
        due_s = time.monotonic()
        print("ready", flush=True)
        while not select.select([sys.stdin], [], [], 0)[0]:
            wait_s = min([due_s] + [one[0] for one in self._coming[:1]]) - time.monotonic()
            self._executor.spin_once(timeout_sec=max(0.0, wait_s))
            now_s = time.monotonic()
            while self._coming and self._coming[0][0] <= now_s:
                heapq.heappop(self._coming)[2]()
            if now_s >= due_s:
                self._measure(now_s)
                due_s = max(due_s + period_s, now_s - period_s)
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _later(self, way: str, act: Callable[[], None]) -> None:
        """Let the link deliver a message late, in order, or not at all."""
        settings, now_s = self.settings, time.monotonic()
        if settings.loss and self._rng.random() < settings.loss:
            return
        late_s = self._rng.exponential(settings.jitter_s) if settings.jitter_s else 0.0
        at_s = self._last_s[way] = max(self._last_s[way], now_s + late_s)
        if late_s == 0.0:
            act()
            return
        self._order += 1
        heapq.heappush(self._coming, (at_s, self._order, act))

    def _hear(self, message: Any) -> None:
        if self._killed:
            return
        now_s = time.monotonic()
        for name, value in _commanded(message, self.settings.command).items():
            if name in self._loops:
                self._loops[name].command(value, now_s)

    def _measure(self, now_s: float) -> None:
        self._count += 1
        settings, count = self.settings, self._count
        if settings.falls_silent_after is not None and count > settings.falls_silent_after:
            return
        values = {
            name: loop.output(now_s) + settings.noise_std * self._rng.standard_normal()
            for name, loop in self._loops.items()
        }
        stamp_ns = time.time_ns() + round(1e9 * settings.clock_ahead_s)
        stamp_ns += round((settings.clock_rate - 1) * (time.monotonic_ns() % 10**12))
        if settings.publishes_clock:
            stamp_ns = time.monotonic_ns()
        if settings.goes_back_after is not None and count > settings.goes_back_after:
            stamp_ns -= 1_000_000_000
        message = _measured(self._new, settings, values, stamp_ns if settings.stamped else 0)
        self._later("out", lambda: self._out.publish(message))
        if self._clock is not None:
            tick = self._new("rosgraph_msgs/msg/Clock")
            tick.clock.sec, tick.clock.nanosec = divmod(stamp_ns, 10**9)
            self._clock.publish(tick)
        if settings.battery is not None and count % 50 == 1:
            state = self._new("sensor_msgs/msg/BatteryState")
            state.percentage = settings.battery
            self._battery.publish(state)


def _commanded(message: Any, kind: str) -> dict[str, float]:
    if kind.endswith("/JointTrajectory"):
        return dict(zip(message.joint_names, message.points[0].positions, strict=True))
    if kind.endswith("/MultiDOFJointTrajectory"):
        place = message.points[0].transforms[0]
        where, turn = place.translation, place.rotation
    else:
        where, turn = message.pose.position, message.pose.orientation
    return {"x": where.x, "y": where.y, "z": where.z, "yaw": 2 * math.atan2(turn.z, turn.w)}


def _measured(
    new: Callable[[str], Any], settings: PlantSettings, values: dict[str, float], stamp_ns: int
) -> Any:
    message = new(settings.measurement)
    if hasattr(message, "header"):
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
    if settings.measurement.endswith("/JointState"):
        message.name, message.position = list(values), list(values.values())
        return message
    pose = getattr(message, "pose", message)
    pose = getattr(pose, "pose", pose)
    pose.position.x, pose.position.y, pose.position.z = (values[name] for name in "xyz")
    pose.orientation.z = math.sin(values["yaw"] / 2)
    pose.orientation.w = math.cos(values["yaw"] / 2)
    return message


if __name__ == "__main__":
    Plant(PlantSettings(**json.loads(sys.argv[1]))).run()
    os._exit(0)  # destructors of the middleware's threads are none of this program's business
