"""Tells by its height whether a robot is on the ground."""

from __future__ import annotations

from collections.abc import Callable

from nufleet.shared.errors import RobotDownError, RobotError

ON_GROUND_S = 1.0
"""Time for which a robot has to be seen on the ground before it is disarmed."""

LANDING_MAX_S = 15.0
"""Time after `land_s` in which a robot has to be seen on the ground."""


def not_on_ground(
    height: Callable[[], float],
    ground_z: float,
    tolerance_m: float,
    now_s: Callable[[], float],
    pause: Callable[[], None],
) -> str | None:
    """Wait until a robot has been on the ground for `ON_GROUND_S`; return why it is not, else None.

    Args:
        height: Function that returns the measured z in m; raises RobotError if it is unknown.
        ground_z: Height at which the robot was armed, in m.
        tolerance_m: Distance from it at which the robot is on the ground.
        now_s: Function that returns the time.
        pause: Function that waits a little; raises RobotDownError if the motors were cut.
    """
    away_s = begun_s = now_s()
    while (at_s := now_s()) - away_s < ON_GROUND_S:
        why = None
        try:
            above_m = height() - ground_z
            if abs(above_m) > tolerance_m:
                why = (
                    f"its z is {above_m:+.2f} m from where it was armed, more than "
                    f"services.land_tolerance_m = {tolerance_m:g}"
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
