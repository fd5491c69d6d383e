"""The medium between the driver and one vehicle, real or simulated."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Protocol

OWN_COMPONENT = 191
"""MAVLink component id under which the driver sends: an onboard computer."""


class Ear(Protocol):
    """What a line calls, from whichever thread it likes, one call at a time for each method."""

    def receive(self, message: Any, source: object, arrived_s: float) -> None:
        """Take a message of the vehicle's autopilot; it came from the address `source`."""

    def beat(self, now_s: float) -> float:
        """Send what is due now; return when to call again."""


class Line(Protocol):
    """Carries messages to one vehicle and back; its clock is the driver's.

    `send` may be called from any thread.
    """

    def open(self, ear: Ear) -> None:
        """Begin to carry messages.

        Raises:
            RobotError: The address cannot be used.
        """

    def close(self) -> None:
        """Carry nothing any more; a second call does nothing."""

    def now_s(self) -> float:
        """Return the present time on a clock that never goes back."""

    def send(self, message: Any) -> None:
        """Send a message; one that cannot be sent is lost."""

    def wait(self, until_s: float, condition: Callable[[], bool] | None = None) -> bool:
        """Wait until a time, or until a condition holds after a message; return whether it does."""

    @property
    def failure(self) -> str:
        """Why nothing is carried any more; empty as long as it is."""

    def heard_systems(self) -> tuple[int, ...]:
        """Return the system ids of all autopilots that were heard, also those of others."""
