"""What the firmware's supervisor says of a Crazyflie, in words."""

from __future__ import annotations

from enum import IntFlag


class Supervisor(IntFlag):
    """Bits of the log variable `supervisor.info`."""

    CAN_BE_ARMED = 1 << 0
    ARMED = 1 << 1
    ARMS_ITSELF = 1 << 2
    CAN_FLY = 1 << 3
    FLYING = 1 << 4
    TUMBLED = 1 << 5
    LOCKED = 1 << 6
    CRASHED = 1 << 7


_DOWN = {
    Supervisor.LOCKED: "it is locked after an emergency stop or a lost link: switch it off and on",
    Supervisor.CRASHED: "it has crashed: look at it, then switch it off and on",
    Supervisor.TUMBLED: "it lies on its side: set it upright",
}


def why_down(info: int) -> str | None:
    """Return why a Crazyflie no longer responds to commands; None while it does.

    Examples:
        >>> why_down(Supervisor.ARMED | Supervisor.CAN_FLY)
        >>> why_down(Supervisor.TUMBLED)
        'it lies on its side: set it upright'
    """
    return next((words for bit, words in _DOWN.items() if info & bit), None)
