"""What a robot needs of ROS 2."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from nufleet.robot_agent.drivers.ros2.clocks import Arrivals
from nufleet.robot_agent.drivers.ros2.messages import SetPoint


class Link(Protocol):
    """What a robot needs of ROS 2. Times are in s on one clock; simulated time if there is one."""

    arrivals: Arrivals
    """Measurements."""

    def now_s(self) -> float:
        """Return the time."""

    def wait_until(self, due_s: float) -> None:
        """Wait; raises RobotError if the clock stands still."""

    def send(self, point: SetPoint) -> float:
        """Send a set-point now, and return when."""

    def keep_sending(self, resend: Callable[[], None] | None) -> None:
        """Call a function whenever one and a half samples pass without a set-point; None stops."""

    def call(self, role: str, engage: bool, timeout_s: float, requests: int = 1) -> None:
        """Call a service by what it does, and wait for its answer; raises RobotError.

        Any thread may call; `engage` is what a SetBool is given. A request that is not answered is
        repeated until there are `requests`, evenly over the time.
        """

    def problem(self) -> str | None:
        """Return what is wrong with topics and services now; None if nothing is."""

    def charge(self) -> float | None:
        """Return the newest charge of the battery, 0 to 1; None if it is not known yet.

        Raises:
            RobotError: The charge is wrong or too old, or the link itself has failed.
        """

    def close(self) -> None:
        """Leave ROS 2."""
