"""Simulated MAVLink vehicles on a virtual clock, flown by the driver under test."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nufleet.robot_agent.drivers.mavlink.robot import MavlinkRobot
from nufleet.robot_agent.drivers.mavlink.settings import MavlinkSettings
from nufleet.robot_agent.robot import RobotAround
from nufleet.shared.robots.spec import RobotSpec
from nufleet.sims.mavlink_vehicle.vehicle import SimulatedVehicle, VehicleSettings
from nufleet.sims.mavlink_vehicle.virtual_line import LinkSettings, VirtualClock, VirtualLine

ROUGH = LinkSettings(jitter_s=0.008, loss=0.01)
"""The link of the figures: 8 ms of jitter and 1 % of loss in either direction."""

X_AND_Y = [
    {"name": name, "amplitude_max": 0.5, "velocity_max": 1.0, "acceleration_max": 3.0}
    for name in ("x", "y")
]


def settings(**changes: object) -> MavlinkSettings:
    """A vehicle with the axes x and y."""
    given = {"profile": "px4", "url": "udpin://127.0.0.1:14540", "axes": X_AND_Y, **changes}
    return MavlinkSettings.model_validate(given, strict=False)


class Unpaced(RobotAround):
    """A robot on a virtual clock, which agents need not watch for gaps in real time."""

    @property
    def spec(self) -> RobotSpec:
        return self._robot.spec.model_copy(update={"simulated": True})


@dataclass
class Air:
    """A robot, and the vehicle and the line behind it."""

    robot: MavlinkRobot
    vehicle: SimulatedVehicle
    line: VirtualLine
    clock: VirtualClock

    def wait(self, for_s: float) -> None:
        """Let time pass with nothing asked of the robot."""
        self.line.wait(self.clock.now_s + for_s)

    def in_the_air(self) -> Air:
        """Take off."""
        self.robot.connect()
        self.robot.begin()
        return self

    def hold(self, for_s: float) -> None:
        """Play reference 0."""
        for _ in range(round(for_s / self.robot.spec.sample_time_s)):
            self.robot.step(np.zeros(2))


def air(
    link: LinkSettings | None = None,
    vehicle: VehicleSettings | None = None,
    *,
    seed: int = 0,
    **changes: object,
) -> Air:
    """A vehicle on the ground, and its robot, disconnected; `changes` are the robot's settings."""
    rng, clock = np.random.default_rng(seed), VirtualClock()
    own = settings(**changes)
    simulated = SimulatedVehicle(
        vehicle or VehicleSettings(profile=own.profile), rng.spawn(1)[0], clock.now_s
    )
    line = VirtualLine(simulated, link or LinkSettings(), rng.spawn(1)[0], clock)
    return Air(MavlinkRobot("drone", own, lambda: line), simulated, line, clock)
