"""The latest known state of one robot, and ways to wait for its changes."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from nufleet.orchestrator.fleet.goal_events import Heard, Sighting, TokenBack, TokenLost
from nufleet.shared.wire.messages import RobotState

OnSign = Callable[[Heard | TokenBack | TokenLost], None]

HEARTBEAT_LOST_S = 2.5
"""Time in s, five heartbeats, after which a silent robot counts as lost."""


class RobotWatch:
    """The latest known state of one robot; network threads set it, other threads read it."""

    def __init__(self, robot: str) -> None:
        self.robot = robot
        self._changed = threading.Condition()
        self._alive = False
        self._state: RobotState | None = None
        self._heard_s = 0.0
        self._followers: list[OnSign] = []

    @property
    def alive(self) -> bool:
        """Whether the robot's liveliness token is present."""
        return self._alive

    @property
    def state(self) -> RobotState | None:
        """The last state received; None before the first."""
        return self._state

    @property
    def silent_s(self) -> float:
        """Time in s since the robot was last heard, measured by this process's clock."""
        return time.monotonic() - self._heard_s

    def set_alive(self, alive: bool) -> None:
        """Record that the liveliness token appeared or disappeared."""
        with self._changed:
            self._alive = alive
            self._heard_s = time.monotonic()
            self._tell(TokenBack() if alive else TokenLost())

    def set_state(self, state: RobotState) -> bool:
        """Record a state and return True; do neither if it is no later one of the same boot."""
        with self._changed:
            last = self._state
            same_boot = last is not None and last.boot_id == state.boot_id
            if last is not None and same_boot and state.sequence <= last.sequence:
                return False
            self._state = state
            self._heard_s = time.monotonic()
            self._tell(Heard(state))
            return True

    def wait_until(self, condition: Callable[[RobotWatch], bool], *, timeout_s: float) -> bool:
        """Wait until a condition on this watch holds.

        Args:
            condition: Predicate, evaluated after every change.
            timeout_s: Longest time to wait, in s.

        Returns:
            Whether the condition holds.
        """
        with self._changed:
            return self._changed.wait_for(lambda: condition(self), timeout_s)

    def follow(self, follower: OnSign) -> tuple[Sighting, Callable[[], None]]:
        """Call a follower, on network threads, with every sign of the robot from now on.

        Returns:
            What is known of the robot now, and a function that removes the follower.
        """
        with self._changed:
            self._followers.append(follower)
            sighting = Sighting(self._alive, self._heard_s)
        return sighting, lambda: self._unfollow(follower)

    def _unfollow(self, follower: OnSign) -> None:
        with self._changed:
            if follower in self._followers:
                self._followers.remove(follower)

    def _tell(self, sign: Heard | TokenBack | TokenLost) -> None:
        self._changed.notify_all()
        for follower in self._followers:
            follower(sign)
