"""A multicopter under PX4 or ArduPilot as a robot: set-points out, measured positions in."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.robot_agent.drivers.mavlink.line import Line
from nufleet.robot_agent.drivers.mavlink.opening import open_vehicle
from nufleet.robot_agent.drivers.mavlink.set_points import SetPoints
from nufleet.robot_agent.drivers.mavlink.settings import AXES, MavlinkSettings
from nufleet.robot_agent.drivers.mavlink.vehicle import SILENT_S, Vehicle
from nufleet.robot_agent.motion.monitor import rest_error_max
from nufleet.robot_agent.robot import Record, Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import OutsideLimitsError, RobotDownError, RobotError
from nufleet.shared.robots.health import Health
from nufleet.shared.robots.spec import RobotSpec

START_MAX_M = 2.0
"""Largest distance between the place of take-off and an origin that the settings give."""

STILL_MEASUREMENTS = 10
"""Number of measurements in a row near reference 0 after which the vehicle rests there."""

STILL_MAX_S = 15.0
"""Time in which it has to come to rest at the end of its way."""

LANDING_MAX_S = 45.0
"""Time in which a landing has to end."""

TAKEN_OFF = 0.95
"""Share of the height at which a take-off by the vehicle itself has ended."""

RE_ANCHOR_S = 0.25
"""Delay of a sample from which on the following ones keep their distance instead of catching up."""

TAIL_S = 0.25
"""Time to wait for a measurement after the last sample of a motion."""


class MavlinkRobot(Robot):
    """One vehicle; references and outputs are positions around its origin in m."""

    def __init__(self, name: str, settings: MavlinkSettings, line: Callable[[], Line]) -> None:
        """Describe a vehicle.

        Args:
            name: Name of the robot.
            settings: Settings of the robot.
            line: Function that returns a new line to the vehicle.
        """
        self._name, self._settings, self._new_line = name, settings, line
        self._spec = settings.spec
        self._columns = [AXES.index(axis.name) for axis in settings.axes]
        self._others = [column for column in range(len(AXES)) if column not in self._columns]
        self._vehicle: Vehicle | None = None
        self._line: Line | None = None
        self._next_s = 0.0
        self._ground: FloatArray | None = None
        self._origin = np.zeros(3)
        self._set_points = SetPoints(settings)
        self._sent_s: list[float] = []
        self._due_s: float | None = None
        self._seen: FloatArray | None = None

    @property
    def spec(self) -> RobotSpec:
        """Description of the vehicle, from its settings."""
        return self._spec

    @property
    def state_names(self) -> tuple[str, ...]:
        """Position and velocity, as the vehicle's estimator measures them."""
        return ("position", "velocity")

    def connect(self) -> None:
        """Find the vehicle on its address; it stays on the ground."""
        self.disconnect()
        self._line = self._new_line()
        self._vehicle = Vehicle(self._settings, self._line)
        self._ground = None
        self._reset()
        try:
            open_vehicle(self._vehicle, self._settings, self._line)
        except BaseException:
            self._vehicle.close()
            self._vehicle = None
            raise

    def begin(self) -> None:
        """Arm, take off, and come to rest at reference 0."""
        vehicle, line = self._connected()
        health = vehicle.health()
        if not health.ready:
            raise RobotError(health.reason)
        if vehicle.armed:
            raise RobotError(
                f"{self._name} is armed already, in {vehicle.mode} mode: land and disarm it first, "
                "since reference 0 is counted from the place of take-off"
            )
        ground = vehicle.measured().position.copy()
        self._place_origin(ground)
        self._send(ground, np.zeros(3))  # and again and again, before PX4 enters the mode
        line.wait(line.now_s() + vehicle.profile.stream_s)
        vehicle.enter(vehicle.profile.obeys)
        self.check_wanted()
        self._ground = ground  # from here on it has to be ended
        vehicle.arm()
        vehicle.controlled = True
        self.check_wanted()
        above = ground + np.array([0.0, 0.0, self._settings.height_m])
        if vehicle.profile.climbs_itself:
            vehicle.keeper.release()
            self._climb(above)
            self._last = above
        else:
            self._last = ground
            self._glide(above)
        self._settle()

    def end(self) -> None:
        """Land where it is, and disarm."""
        vehicle, _ = self._connected()
        self._reset()
        flies = self._ground is not None
        if flies and (vehicle.armed if vehicle.controlled else not vehicle.check_disarmed()):
            self._land()
        self._ended(vehicle)

    def _land(self) -> None:
        vehicle, line = self._connected()
        vehicle.check_obeys()
        vehicle.land()

        def down() -> bool:
            return not vehicle.armed or vehicle.telemetry.landed is True

        until_s = line.now_s() + LANDING_MAX_S
        if not line.wait(until_s, down):
            raise RobotError(f"{self._name} has not landed after {LANDING_MAX_S:g} s")
        if not line.wait(line.now_s() + 2.0, lambda: not vehicle.armed):
            vehicle.ask("disarming", dialect.MAV_CMD_COMPONENT_ARM_DISARM, 0.0)

    def measure_output(self) -> FloatArray:
        """Wait for the next measurement; return the position, shape (axes,)."""
        vehicle, line = self._connected()
        before = vehicle.measured()
        line.wait(line.now_s() + 1.0, lambda: vehicle.telemetry.newest is not before)
        return self._output(vehicle.measured().position)

    def observe(self) -> FloatArray:
        """Wait for the next sample; return position and velocity, shape (axes, 2)."""
        if self._seen is None:
            vehicle = self._wait_until_due()
            newest = vehicle.measured()
            self._check_others(newest.position)
            self._seen = np.stack(
                [self._output(newest.position), newest.velocity[self._columns]], axis=1
            )
        return self._seen.copy()

    def step(self, reference: FloatArray) -> FloatArray:
        """Send a reference, shape (axes,), when it is due; return the newest position."""
        if self._ground is None:
            raise RobotError(f"{self._name} has not taken off: `begin` has to be called first")
        output: FloatArray = self.observe()[:, 0]
        self._seen = None
        place = self._origin.copy()
        place[self._columns] += reference
        velocity = np.zeros(3)
        if self._settings.feed_forward:
            velocity = (place - self._last) / self._spec.sample_time_s
        self._sent_s.append(self._send(place, velocity))
        self._due_s = self._next_s
        return output

    def record(self) -> Record | None:
        """Return the measurements since the robot rested, at the vehicle's own times."""
        vehicle, line = self._connected()
        if not self._sent_s:
            return None
        clock, telemetry = vehicle.telemetry.clock, vehicle.telemetry
        last_s = self._sent_s[-1]

        def complete() -> bool:
            newest = telemetry.newest
            return newest is not None and clock.ours(np.array([newest.vehicle_s]))[0] >= last_s

        line.wait(line.now_s() + TAIL_S, complete)
        taken = telemetry.recorded()
        positions = np.array([one.position for one in taken]).reshape(-1, 3)
        return Record(
            np.array(self._sent_s),
            clock.ours(np.array([one.vehicle_s for one in taken])),
            (positions - self._origin)[:, self._columns],
            telemetry.stamp_step_s / math.sqrt(12),
        )

    def health(self) -> Health:
        """Return the battery, the state of the estimator, the link, and whether it obeys."""
        vehicle = self._vehicle
        if vehicle is None:
            return Health(ready=False, reason="it is not connected")
        return vehicle.health()

    def kill(self) -> None:
        """Cut the motors."""
        vehicle = self._vehicle
        if vehicle is None:
            raise RobotError(f"{self._name} is not connected")
        vehicle.cut()

    def rest(self) -> None:
        """Return to reference 0 on a smooth way, and wait until the vehicle rests there."""
        vehicle, line = self._connected()
        self._reset()
        if self._ground is None:
            return
        newest, limit_m = vehicle.telemetry.newest, self._settings.stray_max_m
        if newest is not None and line.now_s() - newest.arrived_s <= SILENT_S:
            strayed_m = float(np.abs(newest.position - self._last).max())
            if strayed_m > limit_m:
                raise OutsideLimitsError(
                    f"{self._name} is {strayed_m:.2f} m away from its set-point, further than it "
                    f"may move ({limit_m:g} m), and not led back: its position may have jumped"
                )
        self._settle()

    def _settle(self) -> None:
        vehicle, line = self._connected()
        self._reset()
        vehicle.check_obeys()
        self._glide(self._origin)
        near = [0.5 * rest_error_max(self._spec, axis) for axis in self._spec.axes]
        seen: list[bool] = []
        last = vehicle.telemetry.newest

        def still() -> bool:
            nonlocal last
            newest = vehicle.telemetry.newest
            if newest is not None and newest is not last:
                last = newest
                away = np.abs(self._output(newest.position))
                slow = np.abs(newest.velocity[self._columns]) < self._settings.climb_m_s / 4
                seen.append(bool((away <= near).all() and slow.all()))
            vehicle.check_obeys()
            vehicle.check_in_touch()
            return len(seen) >= STILL_MEASUREMENTS and all(seen[-STILL_MEASUREMENTS:])

        lasts_s = self._spec.settling_time_s + STILL_MAX_S
        if not line.wait(line.now_s() + lasts_s, still):
            away = self._output(vehicle.measured().position)
            raise RobotError(
                f"{self._name} has not come to rest at reference 0 within {lasts_s:.0f} s: it is "
                f"at {np.array2string(away, precision=2)} m"
            )
        self._reset()

    def disconnect(self) -> None:
        """Land if it still flies and obeys, and leave the vehicle alone."""
        vehicle = self._vehicle
        if vehicle is None:
            return
        try:
            if self._ground is not None and not vehicle.out_of_hand():
                self.end()
        finally:
            self._vehicle, self._ground = None, None
            vehicle.close()

    def _reset(self) -> None:
        """Forget the last motion."""
        self._sent_s, self._due_s, self._seen = [], None, None
        if self._vehicle is not None:
            self._vehicle.telemetry.forget()

    def _connected(self) -> tuple[Vehicle, Line]:
        if self._vehicle is None or self._line is None:
            raise RobotError(f"{self._name} is not connected")
        if self._vehicle.cut_off:
            raise RobotDownError("its motors were cut")
        return self._vehicle, self._line

    def _ended(self, vehicle: Vehicle) -> None:
        vehicle.controlled = False
        vehicle.keeper.release()
        self._ground = None

    def _output(self, position: FloatArray) -> FloatArray:
        output: FloatArray = (position - self._origin)[self._columns]
        return output

    def _check_others(self, position: FloatArray) -> None:
        """Check that the vehicle stays where it is along what is not an axis."""
        most_m = self._settings.other_axes_error_m
        for column in self._others:
            away_m = float((position - self._origin)[column])
            if abs(away_m) > most_m:
                raise OutsideLimitsError(
                    f"{self._name} is {away_m:.2f} m away from its origin along {AXES[column]}, "
                    f"which is not one of its axes; other_axes_error_m is {most_m:g} m"
                )

    def _place_origin(self, ground: FloatArray) -> None:
        settings = self._settings
        origin = ground.copy()
        if settings.origin_m is not None:
            origin[:2] = settings.origin_m
            away_m = float(np.linalg.norm(origin - ground))
            if away_m > START_MAX_M:
                raise RobotError(
                    f"{self._name} stands {away_m:.1f} m from its origin_m "
                    f"{settings.origin_m}, at {ground[0]:.2f} m east and {ground[1]:.2f} m north: "
                    "put it there, or check that two robots are not exchanged"
                )
        origin[2] += settings.height_m
        self._origin = self._last = origin
        yaw_deg = settings.yaw_deg
        self._set_points.yaw_rad = None if yaw_deg is None else math.radians(yaw_deg)

    def _climb(self, above: FloatArray) -> None:
        """Have the vehicle take off by itself, and wait until it is up."""
        vehicle, line = self._connected()
        height_m = self._settings.height_m
        takeoff = dialect.MAV_CMD_NAV_TAKEOFF
        vehicle.ask("taking off", takeoff, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, height_m)
        least_m = above[2] - (1 - TAKEN_OFF) * height_m

        def up() -> bool:
            vehicle.check_obeys()
            return bool(vehicle.measured().position[2] >= least_m)

        lasts_s = height_m / self._settings.climb_m_s + STILL_MAX_S
        if not line.wait(line.now_s() + lasts_s, up):
            words = vehicle.telemetry.words(line.now_s())
            raise RobotError(f"{self._name} was told to take off, and does not climb{words}")

    def _glide(self, to: FloatArray) -> None:
        """Lead the set-point to a place along a raised cosine, no faster than `climb_m_s`."""
        begins = self._last
        distance_m = float(np.linalg.norm(to - begins))
        samples = math.ceil(self._settings.way_s(distance_m) / self._spec.sample_time_s)
        self._due_s = None
        for k in range(1, samples + 1):
            place = begins + (to - begins) * (1 - math.cos(math.pi * k / samples)) / 2
            self._wait_until_due()
            self._send(place, (place - self._last) / self._spec.sample_time_s)
            self._due_s = self._next_s
        self._due_s = None

    def _wait_until_due(self) -> Vehicle:
        """Wait until the next set-point is due."""
        vehicle, line = self._connected()
        now_s, due_s = line.now_s(), self._due_s
        if due_s is None or now_s - due_s > RE_ANCHOR_S:
            due_s = now_s
        line.wait(due_s)
        vehicle.check_obeys()
        vehicle.check_in_touch()
        if not self._sent_s:
            vehicle.telemetry.record()
        self._next_s = due_s + self._spec.sample_time_s
        return vehicle

    def _send(self, place: FloatArray, velocity: FloatArray) -> float:
        """Send a set-point now; return when."""
        vehicle, line = self._connected()
        line.send(self._set_points.at(place, velocity, line.now_s()))
        now_s = line.now_s()
        vehicle.keeper.sent(self._set_points.at(place, np.zeros(3), now_s), now_s)
        self._last = place
        return now_s
