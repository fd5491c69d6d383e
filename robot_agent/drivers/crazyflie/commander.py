"""Commands to a Crazyflie that may get lost: each is repeated until the drone shows its effect."""

from __future__ import annotations

import time
from collections.abc import Callable

from nufleet.robot_agent.drivers.crazyflie.link import Link
from nufleet.robot_agent.drivers.crazyflie.supervisor import Supervisor
from nufleet.robot_agent.drivers.crazyflie.telemetry import Telemetry
from nufleet.shared.errors import RobotDownError, RobotError

ARMING_MAX_S = 3.0
"""Time in which the drone arms."""

AGAIN_S = 0.5
"""Time after which a command that shows no effect is given again."""

STARTS_WITH_M = 0.05
"""Change of height that shows that a climb or a landing has begun."""

ARRIVES_WITHIN_M = 0.1
"""Distance from a commanded height within which the drone has arrived there."""


class Commander:
    """Has one drone arm, climb, land and disarm; gives no command any more once `cut` is set."""

    def __init__(
        self, name: str, link: Link, telemetry: Telemetry, down: Callable[[], str | None]
    ) -> None:
        """Command nothing yet.

        Args:
            name: Name of the robot, for errors.
            link: Link to it, open.
            telemetry: What it logs.
            down: Function that returns why it no longer responds; None while it does.
        """
        self._name, self._link, self._telemetry, self._down = name, link, telemetry, down
        self.cut = False
        """Whether its motors were cut."""

    def says(self, bits: Supervisor) -> bool:
        """Return whether its supervisor says all of these."""
        status = self._telemetry.status
        return status is not None and status.supervisor & bits == bits

    def raise_if_cut(self) -> None:
        """Raise RobotDownError if its motors were cut."""
        if self.cut:
            raise RobotDownError(f"{self._name}: its motors were cut")

    def arm(self) -> None:
        """Arm; raises RobotError if it does not."""

        def arm() -> None:
            if not self.says(Supervisor.ARMS_ITSELF):
                self._link.arm(armed=True)

        ready = Supervisor.ARMED | Supervisor.CAN_FLY
        if not self._insist(arm, lambda: self.says(ready), ARMING_MAX_S, AGAIN_S):
            status = self._telemetry.status
            info = "nothing" if status is None else f"{Supervisor(status.supervisor)!r}"
            raise RobotError(
                self._telemetry.fault or f"{self._name} does not arm: its supervisor says {info}"
            )

    def disarm(self) -> None:
        """Stop its motors and disarm; raises RobotError if it does not."""

        def disarm() -> None:
            self._link.stop_motors()
            self._link.arm(armed=False)

        def off() -> bool:
            return not self.says(Supervisor.ARMED) or self.says(Supervisor.ARMS_ITSELF)

        if not self._insist(disarm, off, ARMING_MAX_S, AGAIN_S):
            raise RobotError(f"{self._name} does not disarm: keep away from it")

    def climb_to(
        self, height_m: float, takes_s: float, patience_s: float, command: Callable[[], None]
    ) -> bool:
        """Have it climb or descend; return whether it arrives, or True when it is down.

        Args:
            height_m: Height to arrive at, in the estimator's frame.
            takes_s: Time that the firmware takes for it.
            patience_s: Time beyond that in which the drone has to arrive.
            command: Function that gives the command.
        """
        telemetry = self._telemetry

        def height() -> float:
            newest = telemetry.newest
            return float("nan") if newest is None else float(newest.position_m[2])

        from_m = height()  # however old: a drone that is not measured has to land, too

        def moved() -> bool:
            return self._down() is not None or abs(height() - from_m) > STARTS_WITH_M

        def there() -> bool:
            return self._down() is not None or abs(height() - height_m) < ARRIVES_WITHIN_M

        far = abs(height_m - from_m) > ARRIVES_WITHIN_M
        again_s = max(AGAIN_S, 0.6 * takes_s)
        began_s = time.monotonic()
        arrived = self._insist(command, moved if far else there, takes_s + patience_s, again_s)
        arrived = arrived and telemetry.wait_for(there, takes_s + patience_s)
        # It is there when it is near, and the firmware has finished with it.
        time.sleep(max(0.0, began_s + takes_s - time.monotonic()) if arrived else 0.0)
        return arrived

    def _insist(
        self,
        command: Callable[[], None],
        condition: Callable[[], bool],
        timeout_s: float,
        again_s: float,
    ) -> bool:
        """Give a command, again and again since it may get lost; return whether it is obeyed.

        Raises:
            RobotDownError: The motors were cut; a command might start them again.
        """
        deadline_s = time.monotonic() + timeout_s
        while True:
            self.raise_if_cut()
            command()
            left_s = deadline_s - time.monotonic()
            if self._telemetry.wait_for(condition, min(again_s, max(0.0, left_s))):
                return True
            if left_s <= 0 or self._telemetry.fault is not None:
                return False
