"""Tells where a robot is by its newest measurement, or why that does not say it."""

from __future__ import annotations

from nufleet.robot_agent.drivers.ros2.clocks import Arrived
from nufleet.robot_agent.drivers.ros2.link import Link
from nufleet.robot_agent.drivers.ros2.settings import Ros2Settings
from nufleet.robot_agent.motion.monitor import LOST_MAX_S
from nufleet.shared.errors import RobotError


class Sight:
    """Judges the measurements of one robot while it is connected.

    Motion capture that has lost a body, and an estimator that has stopped, may publish the last
    pose again and again with new time stamps. A robot that is commanded velocities would be led by
    it without end. Such a measurement is refused once the robot would have gone as far as it may
    go without any.
    """

    def __init__(self, name: str, settings: Ros2Settings) -> None:
        """Have seen nothing.

        Args:
            name: Name of the robot.
            settings: Settings of the robot.
        """
        self._name, self._topic = name, settings.full(settings.measurement.topic)
        self._last: Arrived | None = None
        self._commanded_s = 0.0

    def newest(self, link: Link) -> Arrived:
        """Return the newest measurement.

        Raises:
            RobotError: There is none that says where the robot is now.
        """
        arrived = link.arrivals.newest()
        age_s = None if arrived is None else link.now_s() - arrived.arrived_s
        if arrived is None or age_s is None or age_s > LOST_MAX_S:
            since = "" if age_s is None else f" for {age_s:.2g} s"
            raise RobotError(
                f"nothing came on {self._topic}{since}: check its publisher and the network"
            )
        if arrived.late_s > LOST_MAX_S:
            raise RobotError(
                f"what comes on {self._topic} is {arrived.late_s:.2g} s old: check the network, "
                "and the load of its computers"
            )
        last = self._last
        if last is not None and arrived.values == last.values and self._commanded_s > LOST_MAX_S:
            raise RobotError(
                f"what comes on {self._topic} stays exactly the same while {self._name} is "
                "commanded to move: its body may be lost to motion capture, or its estimator "
                "stands still"
            )
        return arrived

    def commanded(self, newest: Arrived, share: float) -> None:
        """Note a velocity that follows from a measurement.

        Args:
            newest: The measurement.
            share: The velocity as a share of the largest one; more than 1 counts as 1.
        """
        last, self._last = self._last, newest
        if last is None or newest.values != last.values:
            self._commanded_s = 0.0
        else:
            # Between two messages there is nothing to see, however long that lasts.
            self._commanded_s += min(1.0, share) * (newest.arrived_s - last.arrived_s)
