"""Publishes a robot's state at every change, and twice a second while nothing changes."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from nufleet.robot_agent.network.joint_heartbeat import JointHeartbeat
from nufleet.shared.errors import NufleetError
from nufleet.shared.wire.codec import encode
from nufleet.shared.wire.messages import RobotState
from nufleet.shared.wire.requests import Publisher

HEARTBEAT_S = 0.5
"""Interval between two states while nothing changes."""

LEAST_S = 0.004
"""Least interval between two states. The router of a closed fleet drops states that come more than
twice as fast (`orchestrator.authority.access.STATES_HZ`), and the last of several must arrive."""

_log = logging.getLogger(__name__)


class Heartbeat:
    """A thread that publishes a robot's state; changes in quick succession share one message."""

    def __init__(
        self,
        robot: str,
        publisher: Publisher,
        state: Callable[[], RobotState],
        changed: threading.Event,
        joint: JointHeartbeat | None = None,
    ) -> None:
        """Begin to publish.

        Args:
            robot: Name of the robot.
            publisher: Publisher of the states; withdrawn at the end.
            state: Function that returns the present state.
            changed: Event to set after a change of the state, so that it is published soon.
            joint: Heartbeat of the robots that share a session; None for a robot with its own.
        """
        self._robot = robot
        self._joint = joint
        self._said: RobotState | None = None
        self._publisher = publisher
        self._state = state
        self._changed = changed
        self._closing = False
        self._thread = threading.Thread(target=self._beat, name=f"{robot}-heartbeat", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Publish the final state and end the thread."""
        self._closing = True
        self._changed.set()
        self._thread.join()
        self._publisher.withdraw()

    def _publish(self, state: RobotState, *, final: bool) -> None:
        payload = encode(state)
        if self._joint is None:
            self._publisher.put(payload)
            return
        # These two fields of a state change with time alone.
        said = state.model_copy(update={"sequence": 0, "robot_time_s": 0.0})
        if final or said != self._said:
            self._joint.overtake(self._robot, self._publisher, payload)
            self._said = said
        else:
            self._joint.hand_in(self._robot, payload)

    def _beat(self) -> None:
        closing = False
        while not closing:
            self._changed.clear()
            closing = self._closing  # read before the state, so that the final one is published
            try:
                self._publish(self._state(), final=closing)
            except NufleetError as error:
                _log.warning("a heartbeat could not be sent: %s", error)
            if not closing:
                time.sleep(LEAST_S)
                self._changed.wait(HEARTBEAT_S - LEAST_S)
