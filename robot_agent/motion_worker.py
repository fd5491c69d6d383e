"""The one thread that moves a robot: plays motions, and connects it anew after a fault."""

from __future__ import annotations

import logging
import queue
import threading
import time
from concurrent.futures import Future

import numpy as np

from robot_agent.decisions import Assignment, Decisions
from robot_agent.excitation import reference_of
from robot_agent.flights import performance_of
from robot_agent.memory import Memory
from robot_agent.motion import AxisMotion, Performance, Played, Samples, perform
from robot_agent.online_gp import Correction
from robot_agent.robot import Robot
from robot_agent.telemetry import TelemetryBatcher
from shared.arrays import FloatArray
from shared.codec import Message
from shared.errors import RobotError
from shared.excitation import Excitation, ExcitationPlan
from shared.messages import (
    Done,
    GoalResult,
    Outcome,
    Refusal,
    Telemetry,
    TrackingTelemetry,
)
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
        memory: Memory,
        decisions: Decisions,
        telemetry: Publisher,
        tracking: Publisher,
        *,
        realtime: float | None,
    ) -> None:
        self._boot_id = boot_id
        self._robot = robot
        self._memory = memory
        self._decisions = decisions
        self._telemetry = telemetry
        self._tracking = tracking
        self._realtime = realtime
        self._jobs: queue.SimpleQueue[Assignment | Future[Message] | None] = queue.SimpleQueue()
        self._thread = threading.Thread(target=self._work, name=f"{name}-motions", daemon=True)
        self._thread.start()

    def begin(self, assignment: Assignment) -> None:
        """Play a motion once the one before is over; returns at once."""
        self._jobs.put(assignment)

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
        self._tracking.withdraw()

    def _work(self) -> None:
        while (job := self._jobs.get()) is not None:
            if isinstance(job, Assignment):
                self._perform(job)
            else:
                job.set_result(self._reconnected())

    def _perform(self, assignment: Assignment) -> None:
        try:
            played = self._played(assignment)
        except Exception as error:  # noqa: BLE001 - a goal always ends, and the thread never does
            _log.exception("goal %s", assignment.goal.goal_id)
            reason = f"an unexpected error: {error!r}"
            played = Played(Outcome.FAILED, reason, _nothing(assignment, self._robot), fault=reason)
        result = GoalResult(
            goal_id=assignment.goal.goal_id,
            boot_id=self._boot_id,
            outcome=played.outcome,
            reason=as_reason(played.reason),
            plan=assignment.plan,
            reference=played.samples.reference,
            response=played.samples.response,
            details=played.samples.details,
        )
        self._decisions.ended(result, played.fault)

    def _played(self, assignment: Assignment) -> Played:
        telemetry = self._batcher(assignment)
        played = perform(
            self._robot,
            self._performance(assignment, telemetry),
            assignment.switch,
            on_resting=self._decisions.resting,
        )
        telemetry.flush()
        return played

    def _performance(self, assignment: Assignment, telemetry: TelemetryBatcher) -> Performance:
        def on_samples(first: int, reference: FloatArray, response: FloatArray) -> None:
            telemetry.add(first, reference, response)
            self._decisions.progressed(assignment, first + len(reference))

        def watch(
            sample: int,
            desired: FloatArray,
            actual: FloatArray,
            correction: Correction | None,
            share: float,
        ) -> None:
            none = np.zeros_like(desired)
            learned = (
                (none, none, none)
                if correction is None
                else (correction.prior, correction.mean, correction.variance)
            )
            rows = (row[np.newaxis] for row in (desired, actual, *learned))
            telemetry.add(sample, *rows, np.array([share]))

        plan, motion = assignment.plan, assignment.motion
        if isinstance(motion, Excitation):
            if not isinstance(plan, ExcitationPlan):
                raise TypeError("a frequency test without its plan")
            return AxisMotion(
                self._robot,
                plan.axis,
                reference_of(plan),
                realtime=self._realtime,
                switch=assignment.switch,
                on_samples=on_samples,
            )
        return performance_of(
            motion,
            self._robot,
            self._memory,
            realtime=self._realtime,
            switch=assignment.switch,
            on_played=lambda samples: self._decisions.progressed(assignment, samples),
            watch=watch,
        )

    def _batcher(self, assignment: Assignment) -> TelemetryBatcher:
        goal_id, sample_time_s = assignment.goal.goal_id, assignment.plan.sample_time_s
        if isinstance(assignment.motion, Excitation):
            return TelemetryBatcher(
                self._telemetry,
                lambda first, signals: Telemetry(
                    goal_id=goal_id,
                    first_sample=first,
                    sample_time_s=sample_time_s,
                    reference=signals[0],
                    response=signals[1],
                ),
                clock=time.monotonic,
            )
        return TelemetryBatcher(
            self._tracking,
            lambda first, signals: TrackingTelemetry(
                goal_id=goal_id,
                first_sample=first,
                sample_time_s=sample_time_s,
                desired=signals[0],
                actual=signals[1],
                prior=signals[2],
                mean=signals[3],
                variance=signals[4],
                share=signals[5],
            ),
            clock=time.monotonic,
        )

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


def _nothing(assignment: Assignment, robot: Robot) -> Samples:
    """Return the samples of a motion that did not begin."""
    columns = () if isinstance(assignment.motion, Excitation) else (len(robot.spec.axes),)
    return Samples(np.empty((0, *columns)), np.empty((0, *columns)))
