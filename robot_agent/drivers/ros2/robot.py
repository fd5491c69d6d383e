"""A robot that takes set-points from a ROS 2 topic and reports its position on another one."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress

import numpy as np

from nufleet.robot_agent.drivers.ros2.landing import Ground
from nufleet.robot_agent.drivers.ros2.link import Link
from nufleet.robot_agent.drivers.ros2.setpoints import Places
from nufleet.robot_agent.drivers.ros2.settings import TWISTS, Ros2Settings
from nufleet.robot_agent.drivers.ros2.sight import Sight
from nufleet.robot_agent.motion.monitor import LOST_MAX_S
from nufleet.robot_agent.motion.pace import GAP_MAX_S
from nufleet.robot_agent.robot import Record, Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import OutsideLimitsError, RobotDownError, RobotError
from nufleet.shared.robots.health import Health
from nufleet.shared.robots.spec import RobotSpec

CATCH_UP_MAX_S = 0.1
"""Delay of a sample that the next ones make up for, so that frequencies are exact; a process that
was held up for longer keeps its pace, since the reference would jump."""

CATCH_UP_SHARE = 0.25
"""Shortest time between two samples that catch up, as a share of the sample time."""

KILL_MAX_S = 0.8
"""Time in which the service that cuts the motors has to answer."""

KILL_REQUESTS = 3
"""Requests to cut the motors, evenly over `KILL_MAX_S`, until one is answered."""

LOOK_S = 0.1
"""Interval at which a wait looks whether the motors were cut."""

STOPS = 5
"""Set-points that stop a robot which is commanded velocities: a single one may be lost."""


class Ros2Robot(Robot):
    """One robot on ROS 2."""

    def __init__(
        self, name: str, settings: Ros2Settings, open_link: Callable[[str, Ros2Settings], Link]
    ) -> None:
        """Describe the robot, without reaching it.

        Args:
            name: Name of the robot.
            settings: Settings of the robot.
            open_link: Function that reaches it, checks its topics and services, and has received
                a first measurement; raises RobotError.
        """
        self._name, self._settings, self._open = name, settings, open_link
        self._spec = settings.spec()
        self._link: Link | None = None
        self._down: str | None = None
        # From the request on: the robot is neither armed nor moved before it is connected again.
        self._kill_asked = False
        self._begun = False
        self._ground = Ground(name, settings)
        self._places, self._sight = Places(settings), Sight(name, settings)
        # The last place commanded. A set-point of a motion and a repetition from the link's thread
        # must not overtake one another.
        self._place = self._places.rest
        self._sending = threading.Lock()
        # When the robot that has begun was sent its last set-point, and why it is sent no more.
        self._commanded_s: float | None = None
        self._stalled: str | None = None
        # Times at which the samples since the last rest were sent, and the next one is due.
        self._sent_s: list[float] = []
        self._due_s: float | None = None

    @property
    def spec(self) -> RobotSpec:
        """Description of the robot; may be read while disconnected."""
        return self._spec

    def connect(self) -> None:
        """Reach the robot's topics and services; nothing is sent yet."""
        self.disconnect()
        if self._down is not None:  # it has fallen, and may have been carried away
            self._ground.disarmed()
        self._down, self._kill_asked = None, False
        self._places = Places(self._settings)
        self._sight = Sight(self._name, self._settings)
        self._forget()
        self._link = self._open(self._name, self._settings)

    def begin(self) -> None:
        """Arm and take off by the robot's services, then go to the origin by set-points."""
        self._check_fence()
        link, services = self._commandable(), self._settings.services
        self.check_wanted()
        problem = link.problem()
        if problem is not None:
            raise RobotError(problem)
        self._ground.arm(self._height() if self._settings.reports_height else None)
        if services.arm is not None:
            self._engage("arm")
        if services.take_off is not None:
            self._engage("take_off")
            self._pause(services.take_off_s)
            self.measure_output()  # the newest one may be of before
            self._ground.check_left(self._height())
        self._commandable()
        here = self._here()[: len(self._settings.commanded)]
        self._places.begin(here)
        # Where the robot is, on the side of the turn from which the way is shortest.
        self._place = self._places.rest + self._places.away(here)
        self._begun, self._commanded_s, self._stalled = True, None, None
        self._send(self._place)
        link.keep_sending(self._resend)
        self._go(self._places.rest)
        self._check_place()

    def end(self) -> None:
        """Land and disarm by the robot's services, and send no more set-points.

        A robot that has not been armed here is left as it is, and one that is not seen on the
        ground stays armed.
        """
        link, services = self._reached(), self._settings.services
        self._let_stand(link)
        ground = self._ground
        if not ground.armed:
            return
        refusal = ""
        if ground.left:
            try:
                link.call("land", True, services.timeout_s)
            except RobotError as error:  # a robot that did not take off need not land
                refusal = f"{error}; "
            self._pause(services.land_s, landing=True)
        if ground.z is not None and (ground.left or services.disarms):
            why = ground.not_seen(
                self._height, link.now_s, lambda: self._pause(LOOK_S, landing=True)
            )
            if why is not None:
                raise RobotError(
                    f"{refusal}{self._name} was not disarmed, since it has not been seen on the "
                    f"ground: {why}; land it by hand"
                )
        self._disarm(link)
        ground.disarmed()

    def measure_output(self) -> FloatArray:
        """Wait for the next measurement, shape (axes,)."""
        arrived = self._reached().arrivals.next(2 * LOST_MAX_S)
        return self._places.output(np.array([*arrived.values.values()]))

    def step(self, reference: FloatArray) -> FloatArray:
        """Send a reference, shape (axes,), when its time has come; return the newest output."""
        link = self._moving()
        period_s = self._spec.sample_time_s
        now_s = link.now_s()
        due_s = self._due_s
        if due_s is None or now_s > due_s + CATCH_UP_MAX_S:
            due_s = now_s
        apart_s = self._sent_s[-1] + CATCH_UP_SHARE * period_s if self._sent_s else due_s
        link.wait_until(max(due_s, apart_s))
        self._moving()
        self._check_place()
        output = self._places.output(self._here())
        self._sent_s.append(self._send(self._places.at(reference)))
        self._due_s = due_s + period_s
        return output

    def record(self) -> Record:
        """Return the measurements by their time stamps, on this computer's clock."""
        link = self._reached()
        if not self._sent_s:
            axes = len(self._spec.axes)
            return Record(np.empty(0), np.empty(0), np.empty((0, axes)))
        measured_s, here = link.arrivals.since(self._sent_s[0])
        return Record(np.array(self._sent_s), measured_s, self._places.output(here))

    def rest(self) -> None:
        """Go to reference 0 from the last one, and wait until the robot has settled."""
        if not self._begun:
            self._reached()
            return
        self._moving()
        self._forget()
        self._go(self._places.rest)
        self._check_place()

    def health(self) -> Health:
        """Return what was reported last of the position and the battery."""
        link, battery = self._link, self._settings.battery
        if link is None:
            return Health(ready=False, reason="its driver is not connected")
        if self._down is not None or self._kill_asked:
            return Health(ready=False, reason=self._down or self._uncut())
        reason, charge, endurance_s = "", None, None
        try:
            self._here()
            charge = link.charge()
            reason = link.problem() or ""
        except RobotError as error:
            reason = str(error)
        if battery is not None and charge is not None:
            spare = max(0.0, charge - battery.reserve)
            endurance_s = None if battery.motion_s is None else spare * battery.motion_s
            if not spare:
                reason = reason or (
                    f"its battery is at {charge:.0%}, and {battery.reserve:.0%} are kept for "
                    "landing: charge it"
                )
        return Health(ready=not reason, reason=reason, battery=charge, endurance_s=endurance_s)

    def kill(self) -> None:
        """Cut the motors by the robot's service."""
        link = self._link
        if link is None:
            raise RobotError(f"the motors of {self._name} cannot be cut: it is not connected")
        if self._settings.services.kill is None:
            raise RobotError(
                f"the fleet file names no service that cuts the motors of {self._name} "
                "(services.kill)"
            )
        self._kill_asked = True
        link.call("kill", True, KILL_MAX_S, KILL_REQUESTS)
        self._down = "its motors were cut"
        link.keep_sending(None)

    def disconnect(self) -> None:
        """Leave ROS 2; set-points are no longer sent."""
        link, self._link = self._link, None
        if link is not None:
            self._let_stand(link)
            link.close()

    def _forget(self) -> None:
        """Forget the times of a motion's samples."""
        self._sent_s, self._due_s = [], None

    def _reached(self) -> Link:
        if self._down is not None:
            raise RobotDownError(self._down)
        if self._link is None:
            raise RobotError(f"{self._name} is not connected")
        return self._link

    def _commandable(self) -> Link:
        """Return the link of a robot whose motors are not to be cut."""
        link = self._reached()
        if self._kill_asked:
            raise RobotError(self._uncut())
        return link

    def _engage(self, role: str) -> None:
        """Arm or take off, unless the robot is not wanted any more or not measured."""
        link = self._commandable()
        self.check_wanted()
        self._here()
        self._ground.left |= role == "take_off"
        try:
            link.call(role, True, self._settings.services.timeout_s)
        finally:
            if self._kill_asked:  # this request may have reached the robot after that one
                with suppress(RobotError):
                    link.call("kill", True, KILL_MAX_S, KILL_REQUESTS)
                self._disarm(link)

    def _uncut(self) -> str:
        return (
            f"the motors of {self._name} were to be cut, and {self._settings.services.kill} has "
            "not confirmed it: see that they stand still, then connect it again"
        )

    def _moving(self) -> Link:
        link = self._commandable()
        if not self._begun:
            raise RobotError(f"{self._name} has not begun: it takes no set-points yet")
        if self._stalled is not None:
            raise RobotError(self._stalled)
        return link

    def _here(self) -> FloatArray:
        """Return the newest measured place, shape (measured components,)."""
        return np.array([*self._sight.newest(self._reached()).values.values()])

    def _send(self, place: FloatArray) -> float:
        """Send the set-point of a place, and return when."""
        with self._sending:
            link = self._moving()
            before, self._place = self._place, place
            return self._publish(link, before)

    def _resend(self) -> None:
        with self._sending:
            if not self._begun or self._down is not None:
                return
            # A robot that is commanded velocities is stopped when it is commanded no more.
            if self._settings.command.type in TWISTS:
                self._publish(self._reached(), self._place)
            elif not self._kill_asked and self._stalled is None:
                self._publish(self._moving(), self._place)

    def _publish(self, link: Link, before: FloatArray) -> float:
        silent_s = 0.0 if self._commanded_s is None else link.now_s() - self._commanded_s
        if silent_s > GAP_MAX_S and self._stalled is None:
            self._stalled = (
                f"{self._name} was sent no set-point for {silent_s:.2g} s, since this process "
                "stood still, and what the robot did meanwhile is not known"
            )
            self._moving()
        here = newest = None
        still = self._kill_asked or self._stalled is not None
        if self._settings.command.type in TWISTS and not still:
            with suppress(RobotError):  # a robot that is not measured stands still
                newest = self._sight.newest(link)
                here = np.array([*newest.values.values()])
        point = self._places.set_point(self._place, before, here)
        if newest is not None:
            self._sight.commanded(newest, self._places.speed_share(point))
        self._commanded_s = link.send(point)
        return self._commanded_s

    def _let_stand(self, link: Link) -> None:
        """Send no more set-points; a robot that is commanded velocities is stopped."""
        link.keep_sending(None)
        with self._sending:
            begun, self._begun = self._begun, False
        if not begun or self._settings.command.type not in TWISTS:
            return
        for _ in range(STOPS):
            sent_s = link.send(self._places.set_point(self._place, self._place, None))
            with suppress(RobotError):  # the clock of a simulation stands still
                link.wait_until(sent_s + self._spec.sample_time_s)

    def _go(self, place: FloatArray) -> None:
        """Go to a place by set-points, and wait until the robot has settled."""
        link = self._moving()
        due_s = link.now_s() + self._spec.sample_time_s
        for step in self._places.way(self._place, place):
            link.wait_until(due_s)
            self._here()
            due_s = self._send(step) + self._spec.sample_time_s
        self._pause(self._spec.settling_time_s)

    def _pause(self, lasts_s: float, *, landing: bool = False) -> None:
        """Wait, unless the motors are cut meanwhile, or are to be cut while it does not land."""
        look = self._reached if landing else self._commandable
        link = look()
        until_s = link.now_s() + lasts_s
        while (now_s := link.now_s()) < until_s:
            link.wait_until(min(until_s, now_s + LOOK_S))
            look()

    def _disarm(self, link: Link) -> None:
        services = self._settings.services
        if services.disarm is not None:
            link.call("disarm", True, services.timeout_s)
        elif services.arm is not None:
            link.call("arm", False, services.timeout_s)

    def _height(self) -> float:
        """Return the measured z."""
        return float(self._here()[self._settings.measured.index("z")])

    def _check_fence(self) -> None:
        """Raise RobotError if the robot is outside the limits of its measured output."""
        outputs = self._places.output(self._here())
        for axis, output in zip(self._spec.axes, outputs.tolist(), strict=True):
            below = axis.output_min is not None and output < axis.output_min
            if below or (axis.output_max is not None and output > axis.output_max):
                raise RobotError(
                    f"{self._name} is at {axis.name} = {output:.3g} {axis.unit}, outside its "
                    f"limits {axis.output_min} to {axis.output_max}: bring it back, or correct "
                    "its origin in the fleet file"
                )

    def _check_place(self) -> None:
        """Raise OutsideLimitsError if a held component is not in its place."""
        names = self._settings.commanded
        away = self._places.away(self._here()[: len(names)])
        for i in range(len(self._spec.axes), len(names)):
            if abs(away[i]) > self._settings.hold_tolerance:
                raise OutsideLimitsError(
                    f"{self._name} is not at {names[i]} = {self._places.rest[i]:.3g}: it is "
                    f"{abs(away[i]):.2g} away, more than hold_tolerance"
                )
