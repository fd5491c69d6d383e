"""A ROS 2 node that plays a robot: known linear loops behind a link with jitter and loss.

`python -m benchmarks.ros2_plant '{"namespace": "/cf1", ...}'` runs it until its standard input
ends. Each component of the pose, or each joint, is y'' = ω₀² (r - y) - 2 ζ ω₀ y', where r is the
set-point that arrived last, `delay_s` after it did. Its own clock may differ from this computer's.
With `publishes_clock` it is a simulation, whose clock advances evenly, and waits for set-points
that come late because the driver's process waits for a processor.
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
    topic: str = "measured"
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
    wall_clock: bool = False
    stamped: bool = True
    services: bool = True
    battery: float | None = 0.9
    goes_back_every: int | None = None
    falls_silent_after: int | None = None
    refuses: tuple[str, ...] = ()
    publishes_clock: bool = False
    speed: float = 1.0
    reliability: str = "reliable"
    seed: int = 0


SIMULATED_FROM_S = 1000.0
WAITS_AFTER_S = 0.04
"""Time in a simulation without a set-point after which it waits for one, for `WAITS_S` at most."""
WAITS_S = 0.5


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
        self._simulated_s = SIMULATED_FROM_S
        # When the last set-point was sent in the simulation, and heard here; None for none of late.
        self._commanded_s: tuple[float, float] | None = None
        self._wall_s = time.time() - time.monotonic()
        now_s = self._now_s()
        self._loops = {
            name: Loop(settings, settings.start.get(name, 0.0), now_s)
            for name in settings.components
        }
        self._coming: list[tuple[float, int, Callable[[], None]]] = []
        self._last_s = {"in": 0.0, "out": 0.0}
        self._heard = 0
        self._count = 0
        self._killed = self._landing = False
        self._speeds: dict[str, float] = {}
        self._goals = {name: settings.start.get(name, 0.0) for name in settings.components}
        reliability = ReliabilityPolicy[settings.reliability.upper()]
        # Deep enough for the set-points that come while this process waits for a processor.
        qos = QoSProfile(depth=200, reliability=reliability)
        self._node.create_subscription(_type(settings.command), "command", self._hear, qos)
        self._out = self._node.create_publisher(_type(settings.measurement), settings.topic, qos)
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
            if not answer.success:
                return answer
            if name == "kill":
                self._killed = True
            if name in ("take_off", "land") and "z" in self._loops:
                self._landing = name == "land"  # set-points still on their way are not followed
                z = self.settings.start.get("z", 0.0) if self._landing else 1.0
                self._loops["z"].command(z, self._now_s())
            return answer

        return serve

    def run(self) -> None:
        simulates, period_s = self.settings.publishes_clock, 1 / self.settings.rate_hz
        every_s = period_s / self.settings.speed if simulates else period_s
        due_s = time.monotonic()
        print("ready", flush=True)
        while not select.select([sys.stdin], [], [], 0)[0]:
            coming_s = [one[0] for one in self._coming[:1] if not simulates]
            wait_s = min([due_s, *coming_s]) - time.monotonic()
            self._executor.spin_once(timeout_sec=max(0.0, wait_s))
            now_s = time.monotonic()
            while self._coming and self._coming[0][0] <= self._now_s():
                heapq.heappop(self._coming)[2]()
            if now_s >= due_s and not self._waits(now_s):
                self._take_all()
                self._simulated_s += period_s
                self._measure(self._now_s())
                due_s = max(due_s + every_s, now_s - every_s)
        self._executor.shutdown()
        self._node.destroy_node()
        self._context.try_shutdown()

    def _now_s(self) -> float:
        return self._simulated_s if self.settings.publishes_clock else time.monotonic()

    def _waits(self, now_s: float) -> bool:
        """Return whether the simulation waits for a set-point."""
        if self._commanded_s is None or not self.settings.publishes_clock:
            return False
        sent_s, heard_s = self._commanded_s
        if now_s - heard_s > WAITS_S:
            self._commanded_s = None
            return False
        return self._simulated_s - sent_s > WAITS_AFTER_S

    def _take_all(self) -> None:
        """Take the set-points that have been sent, so that the robot has moved by them."""
        heard = -1
        while heard != self._heard:
            heard = self._heard
            self._executor.spin_once(timeout_sec=0)

    def _arrives_s(self, way: str, sent_s: float) -> float | None:
        """Return when the link delivers a message, in order; None if never."""
        settings = self.settings
        if settings.loss and self._rng.random() < settings.loss:
            return None
        late_s = 2 * settings.jitter_s * self._rng.random()
        self._last_s[way] = max(self._last_s[way], sent_s + late_s)
        return self._last_s[way]

    def _hear(self, message: Any, info: Any) -> None:
        self._heard += 1
        # When it was sent, and not when this process got a processor to take it.
        waited_s = 1e-9 * (time.time_ns() - info["source_timestamp"])
        sent_s = self._now_s() - min(max(waited_s, 0.0), 1.0)
        if self.settings.publishes_clock:
            stamp = message.header.stamp
            sent_s = stamp.sec + 1e-9 * stamp.nanosec
            self._commanded_s = (sent_s, time.monotonic())
        at_s = self._arrives_s("in", sent_s)
        if at_s is None or self._killed or self._landing:
            return
        if self.settings.command.endswith(("/Twist", "/TwistStamped")):
            twist = getattr(message, "twist", message)
            self._speeds = {"x": twist.linear.x, "y": twist.linear.y, "yaw": twist.angular.z}
            return
        for name, value in _commanded(message, self.settings.command).items():
            if name in self._loops:
                self._loops[name].command(value, at_s)

    def _measure(self, now_s: float) -> None:
        self._count += 1
        settings, count = self.settings, self._count
        if settings.falls_silent_after is not None and count > settings.falls_silent_after:
            return
        for name, speed in self._speeds.items():  # its set-point moves as a Twist says
            self._goals[name] += speed / settings.rate_hz
            self._loops[name].command(self._goals[name], now_s)
        values = {
            name: loop.output(now_s) + settings.noise_std * self._rng.standard_normal()
            for name, loop in self._loops.items()
        }
        if settings.publishes_clock:
            stamp_s = now_s
        elif settings.wall_clock:
            stamp_s = time.time()
        else:  # a steady one: a computer's time of day is set again and again
            stamp_s = self._wall_s + settings.clock_rate * now_s
        stamp_ns = round(1e9 * (stamp_s + settings.clock_ahead_s))
        if settings.goes_back_every is not None and count // settings.goes_back_every % 2:
            stamp_ns -= 1_000_000_000
        message = _measured(self._new, settings, values, stamp_ns if settings.stamped else 0)
        at_s = self._arrives_s("out", now_s)
        if at_s is not None:
            heapq.heappush(self._coming, (at_s, count, lambda: self._out.publish(message)))
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
