"""Tells by its height whether a robot is on the ground, and whether it may be in the air."""

from __future__ import annotations

from collections.abc import Callable

from nufleet.robot_agent.drivers.ros2.settings import Ros2Settings
from nufleet.shared.errors import RobotDownError, RobotError

ON_GROUND_S = 1.0
"""Time for which a robot has to be seen on the ground before it is disarmed."""

LANDING_MAX_S = 15.0
"""Time after `land_s` in which a robot has to be seen on the ground."""


class Ground:
    """Where one robot was armed, until it is disarmed: also after it was connected again."""

    def __init__(self, name: str, settings: Ros2Settings) -> None:
        """Describe a robot that stands on the ground.

        Args:
            name: Name of the robot.
            settings: Settings of the robot.
        """
        self._name, self._tolerance_m = name, settings.services.land_tolerance_m
        heights = {axis.of: axis.origin for axis in settings.axes} | settings.hold
        takes_off = settings.services.take_off is not None
        self._hover_z = heights.get("z") if takes_off else None
        self.armed = self.left = False
        self.z: float | None = None

    def arm(self, z: float | None) -> None:
        """Note that the robot is being armed; where it stands is kept if it was not disarmed.

        Args:
            z: Its measured height in m; None if it is not measured.

        Raises:
            RobotError: The robot is as high already as it shall fly.
        """
        if self.armed:
            return
        hover_z = self._hover_z
        if z is not None and hover_z is not None and abs(z - hover_z) <= self._tolerance_m:
            raise RobotError(
                f"{self._name} is at z = {z:.3g}, where it shall hover (z = {hover_z:g}), "
                "before it was armed: land it by hand, or correct the height in the fleet file"
            )
        self.armed, self.z = True, z

    def check_left(self, z: float) -> None:
        """Raise RobotError if a robot that has taken off is where it was armed."""
        if self.z is not None and abs(z - self.z) <= self._tolerance_m:
            raise RobotError(
                f"{self._name} has not taken off: its z is {z - self.z:+.2f} m from where it was "
                "armed, services.take_off_s after its service answered"
            )

    def disarmed(self) -> None:
        """Note that the robot stands disarmed."""
        self.armed = self.left = False

    def not_seen(
        self, height: Callable[[], float], now_s: Callable[[], float], pause: Callable[[], None]
    ) -> str | None:
        """Wait until the robot has been on the ground for `ON_GROUND_S`; return why it is not.

        Args:
            height: Function that returns the measured z in m; raises RobotError if it is unknown.
            now_s: Function that returns the time.
            pause: Function that waits a little; raises RobotDownError if the motors were cut.
        """
        away_s = begun_s = now_s()
        while (at_s := now_s()) - away_s < ON_GROUND_S:
            why = None
            try:
                above_m = height() - (self.z or 0.0)
                if abs(above_m) > self._tolerance_m:
                    why = (
                        f"its z is {above_m:+.2f} m from where it was armed, more than "
                        f"services.land_tolerance_m = {self._tolerance_m:g}"
                    )
            except RobotDownError:
                raise
            except RobotError as error:
                why = str(error)
            if why is not None:
                away_s = at_s
                if at_s - begun_s > LANDING_MAX_S:
                    return why
            pause()
        return None
