"""The one thread that moves a robot: plays motions, and connects it anew after a fault."""

from __future__ import annotations

import logging
import queue
import threading
import time
from concurrent.futures import Future

import numpy as np

from robot_agent.decisions import Decisions, Motion
from robot_agent.excitation import reference_of
from robot_agent.motion import Played, play
from robot_agent.robot import Robot
from robot_agent.telemetry import TelemetryBatcher
from shared.arrays import FloatArray
from shared.codec import Message
from shared.errors import RobotError
from shared.messages import Done, GoalResult, Outcome, Refusal
from shared.strict import as_reason
from shared.transport import Publisher

_log = logging.getLogger(__name__)


class MotionWorker:
    """Plays what is begun, one motion after the other, and reports each end to the decisions."""

    def __init__(
        self,
        name: str,
        boot_id: str,
        robot: Robot,
        decisions: Decisions,
        telemetry: Publisher,
        *,
        realtime: float | None,
    ) -> None:
        self._boot_id = boot_id
        self._robot = robot
        self._decisions = decisions
        self._telemetry = telemetry
        self._realtime = realtime
        self._jobs: queue.SimpleQueue[Motion | Future[Message] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name=f"{name}-motions", daemon=True)
        self._thread.start()

    def begin(self, motion: Motion) -> None:
        """Play a motion once the one before is over; returns at once."""
        self._jobs.put(motion)

    def reconnect(self) -> Future[Message]:
        """Connect a robot with a fault anew; the answer comes when that has worked, or not."""
        answer: Future[Message] = Future()
        self._jobs.put(answer)
        return answer

    def close(self) -> None:
        """Do what was begun and end; the decisions must have been shut down before."""
        self._jobs.put(None)
        self._thread.join()
        self._telemetry.withdraw()

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            if isinstance(job, Motion):
                self._perform(job)
            else:
                job.set_result(self._reconnected())

    def _perform(self, motion: Motion) -> None:
        try:
            played = self._played(motion)
        except Exception as error:  # noqa: BLE001 - a goal always ends, and the thread never does
            _log.exception("goal %s", motion.goal.goal_id)
            reason = f"an unexpected error: {error!r}"
            played = Played(Outcome.FAILED, reason, np.empty(0), np.empty(0), fault=reason)
        result = GoalResult(
            goal_id=motion.goal.goal_id,
            boot_id=self._boot_id,
            outcome=played.outcome,
            reason=as_reason(played.reason),
            plan=motion.plan,
            reference=played.reference,
            response=played.response,
        )
        self._decisions.ended(result, played.fault)

    def _played(self, motion: Motion) -> Played:
        telemetry = TelemetryBatcher(
            self._telemetry,
            motion.goal.goal_id,
            motion.plan.sample_time_s,
            clock=time.monotonic,
        )

        def on_samples(first: int, reference: FloatArray, response: FloatArray) -> None:
            telemetry.add(first, reference, response)
            self._decisions.progressed(motion, first + len(reference))

        played = play(
            self._robot,
            motion.plan.axis,
            reference_of(motion.plan),
            realtime=self._realtime,
            switch=motion.switch,
            on_samples=on_samples,
            on_resting=self._decisions.resting,
        )
        telemetry.flush()
        return played

    def _reconnected(self) -> Message:
        if self._decisions.fault is None:
            return Done()  # another release came first
        fault = None
        try:
            try:
                self._robot.disconnect()
            except RobotError as error:
                _log.warning("disconnecting a robot with a fault: %s", error)
            self._robot.connect()
        except Exception as error:  # noqa: BLE001 - a driver's mistake must not end the thread
            _log.exception("a robot could not be connected anew")
            fault = f"could not be connected anew: {error}"
        self._decisions.reconnected(fault)
        return Done() if fault is None else Refusal(code="fault", reason=as_reason(fault))
