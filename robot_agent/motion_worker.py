"""The only thread that moves a robot: it plays motions, and reconnects the robot after a fault."""

from __future__ import annotations

import logging
import queue
import threading
import time
from collections.abc import Callable
from concurrent.futures import Executor, Future
from contextlib import AbstractContextManager, nullcontext
from enum import Enum, auto
from functools import partial

import numpy as np

from nufleet.robot_agent.decisions import Assignment, Decisions
from nufleet.robot_agent.flight.flights import performance_of
from nufleet.robot_agent.flight.memory import Memory, MemoryFolderError
from nufleet.robot_agent.flight.mixture_learner import experts_of
from nufleet.robot_agent.flight.online_gp import Correction
from nufleet.robot_agent.flight.unread import unread_test
from nufleet.robot_agent.motion.excitation import reference_of
from nufleet.robot_agent.motion.perform import AxisMotion, Performance, Played, Samples, performed
from nufleet.robot_agent.motion.sortie import Sortie
from nufleet.robot_agent.motion.steps import Steps, make
from nufleet.robot_agent.motion.watched_robot import WatchedRobot
from nufleet.robot_agent.network.telemetry import TelemetryBatcher
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan
from nufleet.shared.wire.codec import Message
from nufleet.shared.wire.messages import (
    Done,
    GoalResult,
    Outcome,
    Refusal,
    Telemetry,
    TrackingTelemetry,
)
from nufleet.shared.wire.motions import PredictedError, Tracking
from nufleet.shared.wire.requests import Publisher

CLOSING_LOOK_S = 0.1
"""Interval between checks on the robot while the worker is closing."""

_log = logging.getLogger(__name__)


class _Job(Enum):
    """What the thread does between motions."""

    LAND = auto()
    CLOSE = auto()


class MotionWorker:
    """Plays the motions it is given, one after the other, and reports each end to `Decisions`."""

    def __init__(
        self,
        name: str,
        boot_id: str,
        robot: WatchedRobot,
        memory: Memory,
        decisions: Decisions,
        telemetry: Publisher,
        tracking: Publisher,
        clerks: Executor,
        *,
        realtime: float | None,
        prompt: Callable[[], AbstractContextManager[None]] = nullcontext,
        foretold: Callable[[Tracking], PredictedError | None] = lambda motion: None,
        hindrance: Callable[[], str | None] = lambda: None,
        unfit: Callable[[], str | None] = lambda: None,
    ) -> None:
        self._boot_id = boot_id
        self._foretold, self._hindrance, self._unfit = foretold, hindrance, unfit
        self._robot = robot
        self._sortie = Sortie(robot)
        self._memory = memory
        self._decisions = decisions
        self._telemetry = telemetry
        self._tracking = tracking
        self._clerks = clerks
        self._realtime = realtime
        self._prompt = prompt
        self._late_before = 0
        self._jobs: queue.SimpleQueue[Assignment | Future[Message] | _Job] = queue.SimpleQueue()
        self._lock = threading.Lock()
        self._performing: tuple[Assignment, Performance | None] | None = None
        self._not_ended: str | None = None
        self._thread = threading.Thread(target=self._work, name=f"{name}-motions", daemon=True)
        self._thread.start()

    def begin(self, assignment: Assignment) -> None:
        """Play a motion as soon as the previous one is over; returns at once."""
        with self._lock:
            self._performing = (assignment, None)
        self._jobs.put(assignment)

    def reconnect(self) -> Future[Message]:
        """Reconnect a robot with a fault; returns at once.

        Returns:
            The answer to come: `Done` once the robot is reconnected, or a refusal if that fails.
        """
        answer: Future[Message] = Future()
        if self._robot.hangs:
            answer.set_result(Refusal(code="fault", reason="its driver hangs; restart its agent"))
        else:
            self._jobs.put(answer)
        return answer

    def look_after_robot(self) -> None:
        """Check the driver, and report the motion as failed if it hangs; to be called regularly.

        A robot that is in the air without a motion, and may not begin one, lands at once.
        """
        hang = self._robot.look()
        if hang is None:
            with self._lock:
                idle = self._performing is None
            if idle and self._sortie.begun and self._unfit() is not None:
                self._jobs.put(_Job.LAND)
            return
        reason = f"{hang}: the robot may be moving and cannot be brought to rest from here"
        with self._lock:
            performing, self._performing = self._performing, None
        if performing is None:
            if self._decisions.fault is None:
                self._decisions.broke(reason)
            return
        assignment, performance = performing
        _log.error("goal %s: %s", assignment.goal.goal_id, reason)
        # If the driver returns after all, the thrown switch brings the robot to rest.
        assignment.switch.halt(Outcome.FAILED, reason)
        nothing = _nothing(assignment, self._robot)
        samples = nothing if performance is None else performance.measured()
        self._report(assignment, Played(Outcome.FAILED, reason, samples, fault=reason))

    def close(self) -> None:
        """Finish the motions that were begun, and end; `Decisions` must have been shut down before.

        Raises:
            RobotError: The driver hangs or cannot end, so the robot cannot be left at rest.
        """
        self._jobs.put(_Job.CLOSE)
        try:
            while self._thread.is_alive():
                self._thread.join(CLOSING_LOOK_S)
                hang = self._robot.look()
                if hang is not None:
                    raise RobotError(f"{hang}; the robot may not be at rest")
            if self._not_ended is not None:
                raise RobotError(f"{self._not_ended}; the robot may not be at rest")
        finally:
            self._telemetry.withdraw()
            self._tracking.withdraw()

    def _work(self) -> None:
        while True:
            try:
                job = self._jobs.get(
                    timeout=self._robot.spec.idle_s if self._sortie.begun else None
                )
            except queue.Empty:
                self._end()
                continue
            if job is _Job.LAND:
                if self._unfit() is not None:
                    self._end()
            elif job is _Job.CLOSE:
                self._not_ended = self._end()
                return
            elif isinstance(job, Assignment):
                self._perform(job)
            else:
                job.set_result(make(reconnected(self._sortie, self._decisions)))

    def _end(self) -> str | None:
        """Land a robot that no motion keeps in the air; return why that failed."""
        failed = make(self._sortie.end())
        if failed is not None:
            _log.error("%s", failed)
            self._decisions.broke(failed)
        return failed

    def _perform(self, assignment: Assignment) -> None:
        with self._lock:
            if self._performing is None:
                return  # the driver hung before this goal's turn came, which has been reported
        self._late_before = self._robot.late_samples
        nothing = _nothing(assignment, self._robot)
        steps = partial(self._performed, assignment)
        played = make(self._sortie.move(assignment.switch, self._hindrance, nothing, steps))
        with self._lock:
            given_up, self._performing = self._performing is None, None
        if given_up:
            _log.warning(
                "goal %s: the driver has returned after all; the robot %s",
                assignment.goal.goal_id,
                "is at rest" if played.fault is None else f"has a fault: {played.fault}",
            )
            return
        self._report(assignment, played)

    def _report(self, assignment: Assignment, played: Played) -> None:
        result = GoalResult(
            goal_id=assignment.goal.goal_id,
            boot_id=self._boot_id,
            outcome=played.outcome,
            reason=played.reason,
            plan=assignment.plan,
            reference=played.samples.reference,
            response=played.samples.response,
            timing=played.samples.timing,
            details=played.samples.details,
            late_samples=self._robot.late_samples - self._late_before,
        )
        if played.fault is None:
            self._decisions.at_rest()
        # The clerks are few. When hundreds of robots stop at the same time, those that still move
        # wait for Python's interpreter behind a few that are at rest, not behind all of them.
        self._clerks.submit(self._decisions.ended, result, played.fault).result()

    def _performed(self, assignment: Assignment) -> Steps[Played]:
        telemetry = self._batcher(assignment)
        performance = self._performance(assignment, telemetry)
        with self._lock:
            if self._performing is not None:  # it is if the driver hung in its `begin`
                self._performing = (assignment, performance)
        with self._prompt():
            played = yield from performed(
                self._robot,
                performance,
                assignment.switch,
                on_resting=self._decisions.resting,
            )
        telemetry.flush()
        if isinstance(assignment.plan, ExcitationPlan) and played.outcome is Outcome.COMPLETED:
            self._keep_test(assignment.plan, played.samples)
        return played

    def _keep_test(self, plan: ExcitationPlan, samples: Samples) -> None:
        """Keep a frequency test, which the robot learns from when it is asked about itself."""
        if self._robot.spec.tracking is None:
            return  # it flies no paths, and needs no model of itself
        count, states = len(samples.reference), samples.states
        try:
            self._memory.keep_test(
                unread_test(
                    self._robot.spec,
                    self._robot.state_names,
                    {one.axis: max(t.omega_rad_s for t in one.tones) for one in plan.played},
                    samples.reference.reshape(count, -1),
                    samples.response.reshape(count, -1),
                    states,
                )
            )
        except MemoryFolderError as error:
            _log.warning("a test taught nothing: %s", error)

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
            weights = np.empty(0) if correction is None else correction.weights
            rows = (row[np.newaxis] for row in (desired, actual, *learned))
            telemetry.add(sample, *rows, np.array([share]), weights[np.newaxis])

        plan, motion = assignment.plan, assignment.motion
        if isinstance(motion, Excitation):
            if not isinstance(plan, ExcitationPlan):
                raise TypeError("a frequency test needs the plan of an excitation")
            return AxisMotion(
                self._robot,
                [played.axis for played in plan.played],
                reference_of(plan),
                realtime=self._realtime,
                switch=assignment.switch,
                on_samples=on_samples,
                watched=lambda: telemetry.heard,
            )
        return performance_of(
            motion,
            self._robot,
            self._memory,
            realtime=self._realtime,
            switch=assignment.switch,
            on_played=lambda samples: self._decisions.progressed(assignment, samples),
            watch=watch,
            foretold=self._foretold(motion) if isinstance(motion, Tracking) else None,
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
        experts = experts_of(assignment.motion, self._memory)
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
                experts=experts,
                weights=signals[6] if experts else None,
            ),
            clock=time.monotonic,
        )


def reconnected(sortie: Sortie, decisions: Decisions) -> Steps[Message]:
    """Disconnect and connect a robot with a fault; return the answer to its release."""
    if decisions.fault is None:
        return Done()  # another release came first
    if decisions.stopped:
        return Refusal(code="stopped", reason="it has just been stopped again")
    fault, stops = None, decisions.stops
    try:
        yield from sortie.reconnect(lambda: decisions.stops == stops)
    except Exception as error:  # noqa: BLE001 - a driver's mistake must not end the thread
        _log.exception("a robot could not be reconnected")
        fault = f"could not be reconnected: {error}"
    fault = decisions.reconnected(fault, stops=stops)
    return Done() if fault is None else Refusal(code="fault", reason=fault)


def _nothing(assignment: Assignment, robot: Robot) -> Samples:
    """Return the samples of a motion that did not begin, in the shape that its result has."""
    plan = assignment.plan
    columns = plan.columns if isinstance(plan, ExcitationPlan) else (len(robot.spec.axes),)
    return Samples(np.empty((0, *columns)), np.empty((0, *columns)))
