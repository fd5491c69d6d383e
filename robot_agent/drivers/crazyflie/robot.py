"""A real Crazyflie as a Robot: set-points out at an exact rate, logged states in."""

from __future__ import annotations

import time

import numpy as np

from nufleet.robot_agent.drivers.crazyflie.condition import condition
from nufleet.robot_agent.drivers.crazyflie.flight import UNMEASURED_MAX_S, Flight
from nufleet.robot_agent.drivers.crazyflie.glide import glide
from nufleet.robot_agent.drivers.crazyflie.link import Link
from nufleet.robot_agent.drivers.crazyflie.motion_capture import Sighting
from nufleet.robot_agent.drivers.crazyflie.settings import AXES, CrazyflieSettings, spec_of
from nufleet.robot_agent.drivers.crazyflie.telemetry import Measurement, Telemetry
from nufleet.robot_agent.robot import Record, Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.robots.health import Health
from nufleet.shared.robots.spec import RobotSpec

FIRST_TAKEN = 10
"""Number of measurements that show whether they can be those of one drone."""

STATE_NAMES = ("position", "velocity", "tilt")

LATE_MAX_S = 0.25
"""Longest delay that the following samples make up for."""

FIRST_MAX_S = 3.0
"""Time in which the first measurements arrive, and the position should be known."""

FLIES_ALREADY = (
    "it was in the air when it was connected, and is left alone until it has landed: land it from "
    "where it was started, or cut its motors with `nufleet stop --kill`"
)


class Crazyflie(Robot):
    """A Crazyflie under the position controller of its firmware."""

    def __init__(
        self, name: str, settings: CrazyflieSettings, sighting: Sighting | None = None
    ) -> None:
        """Describe a drone.

        Args:
            name: Name of the robot, for errors.
            settings: Settings of the drone.
            sighting: How motion capture sees it; None if it finds out by itself where it is.
        """
        self._name, self._settings = name, settings
        self._spec = spec_of(settings)
        self._columns = [AXES.index(axis) for axis in settings.axes]
        self._sighting = sighting
        self._telemetry = Telemetry(settings.log_period_s)
        self._link: Link | None = None
        self._flight: Flight | None = None
        self._found_flying = self._is_set_up = False
        # Since it rested: when references were sent, and when the next one is due; what `observe`
        # saw, which `step` returns, too.
        self._sent_s: list[float] = []
        self._due_s: float | None = None
        self._seen: Measurement | None = None

    @property
    def spec(self) -> RobotSpec:
        """Description of the drone."""
        return self._spec

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states on each axis; the tilt is the thrust's, towards the axis."""
        return STATE_NAMES

    def connect(self) -> None:
        """Open the link, set the parameters, and wait for a first measurement; it does not move."""
        self.disconnect()
        self._telemetry = telemetry = Telemetry(self._settings.log_period_s)
        self._link = link = Link(self._settings, telemetry)
        try:
            link.open()
            if self._sighting is not None:
                self._sighting.begin(link.send_position, link.send_pose)
            self._wait_for_first()
            self._flight = flight = Flight(self._name, self._settings, link, telemetry)
            self._found_flying = flight.flying
            if not self._found_flying:
                self._set_up(link, flight)
        except BaseException:
            self.disconnect()
            raise

    def begin(self) -> None:
        """Find out where it is, arm, take off, and come to rest at its origin."""
        flight = self._connected()
        hindrance = self.health().reason
        if hindrance:
            raise RobotError(f"{self._name} does not take off: {hindrance}")
        if self._link is not None and not self._is_set_up:
            self._set_up(self._link, flight)
        flight.take_off(self.check_wanted)
        self.rest()

    def end(self) -> None:
        """Land and disarm."""
        if self._connected().airborne:
            self._forget()
            self._connected().land()

    def measure_output(self) -> FloatArray:
        """Wait for the next measurement and return its output, shape (axes,)."""
        flight = self._connected()
        return self._outputs(flight, flight.next())

    def observe(self) -> FloatArray:
        """Return position, velocity and tilt of each axis, shape (axes, 3)."""
        flight = self._connected()
        self._seen = seen = flight.newest()
        tilt = np.arctan2(seen.thrust_axis, seen.thrust_axis[2])
        tilt[2] = 0.0
        states = np.stack([flight.offset_of(seen), seen.velocity_m_s, tilt], axis=1)
        observed: FloatArray = states[self._columns]
        return observed

    def step(self, reference: FloatArray) -> FloatArray:
        """Send a reference when it is due; return the newest measurement, both of shape (axes,)."""
        flight = self._flying()
        if not self._sent_s:
            self._telemetry.begin_recording()
        self._wait_for_sample()
        seen, self._seen = self._seen, None
        measured = flight.newest() if seen is None else seen
        flight.check(measured)
        offset = np.zeros(3)
        offset[self._columns] = reference
        velocity = (offset - flight.offset) / self._spec.sample_time_s
        self._sent_s.append(flight.send(offset, velocity))
        return self._outputs(flight, measured)

    def record(self) -> Record:
        """Return the measurements since it rested, dated by the drone's own clock."""
        flight, telemetry = self._connected(), self._telemetry
        sent_s = np.array(self._sent_s)
        if len(sent_s):
            # The measurement of the last sample is still on its way.
            telemetry.wait_for(lambda: telemetry.dated_newest() > sent_s[-1], UNMEASURED_MAX_S)
        measured_s, positions = telemetry.dated()
        offsets = positions - flight.origin_m
        return Record(sent_s, measured_s, offsets[:, self._columns])

    def health(self) -> Health:
        """Return its condition, as it was logged last."""
        flight, sighting = self._flight, self._sighting
        down = "it is not connected" if flight is None else flight.down or flight.failure
        if flight is not None and self._found_flying:
            self._found_flying = flight.flying  # it may have landed meanwhile
            down = down or (FLIES_ALREADY if self._found_flying else None)
        blind = None if sighting is None else sighting.hindrance(UNMEASURED_MAX_S)
        return condition(self._settings, self._telemetry, down, blind, time.monotonic())

    def kill(self) -> None:
        """Have the firmware stop the motors: the drone falls.

        Raises:
            RobotError: There is no link.
        """
        self._connected().cut_motors()

    def rest(self) -> None:
        """Glide to reference 0 from the last reference, and wait until it is still there."""
        flight, limits = self._flying(), self._settings.limits
        flight.check_near()
        path = glide(
            flight.offset,
            flight.velocity,
            velocity_max=limits.velocity_m_s / 2,
            acceleration_max=limits.acceleration_m_s2 / 2,
            sample_time_s=self._spec.sample_time_s,
        )
        self._forget()
        for offset, velocity in zip(*path, strict=True):
            self._wait_for_sample()
            flight.check_near()
            flight.send(offset, velocity)
        flight.send(np.zeros(3), np.zeros(3))
        self._forget()
        flight.wait_until_still()

    def disconnect(self) -> None:
        """Land if it flies, stop logging and close the link."""
        link, flight = self._link, self._flight
        if link is None:
            return
        try:
            if flight is not None and flight.airborne and flight.down is None:
                flight.land()
        finally:
            self._flight = self._link = None
            self._is_set_up = False
            if flight is not None:
                flight.release()
            if self._sighting is not None:
                self._sighting.end()
            self._forget()
            link.close()

    def _set_up(self, link: Link, flight: Flight) -> None:
        """Set the parameters and let it find out where it is; in the air both could bring it down.

        Whether it knows is in its health; it may be carried to where it does.
        """
        link.set_up()
        flight.reset_estimator(FIRST_MAX_S)
        self._is_set_up = True

    def _wait_for_first(self) -> None:
        telemetry = self._telemetry
        if not telemetry.wait_for(
            lambda: telemetry.taken >= FIRST_TAKEN and telemetry.status is not None, FIRST_MAX_S
        ):
            raise RobotError(telemetry.fault or f"{self._name} answers, but logs nothing")

    def _connected(self) -> Flight:
        if self._flight is None:
            raise RobotError(f"{self._name} is not connected")
        return self._flight

    def _flying(self) -> Flight:
        flight = self._connected()
        if not flight.airborne:
            raise RobotError(f"{self._name} stands on the ground: `begin` has to be called first")
        return flight

    def _outputs(self, flight: Flight, measurement: Measurement) -> FloatArray:
        outputs: FloatArray = flight.offset_of(measurement)[self._columns]
        return outputs

    def _wait_for_sample(self) -> None:
        now_s = time.monotonic()
        due_s = now_s if self._due_s is None else max(self._due_s, now_s - LATE_MAX_S)
        time.sleep(max(0.0, due_s - now_s))
        self._due_s = due_s + self._spec.sample_time_s

    def _forget(self) -> None:
        """Begin a new motion with the next sample."""
        self._telemetry.end_recording()
        self._sent_s = []
        self._due_s = None
        self._seen = None
