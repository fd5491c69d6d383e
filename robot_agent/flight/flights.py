"""Performs every motion but frequency tests: step tests, rich flights and tracked paths."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from nufleet.robot_agent.flight.baseline_model import (
    check_explained,
    identify_baseline,
    needed_correction,
)
from nufleet.robot_agent.flight.guard import Guard
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.mixture_learner import experts_of, mixture_learner
from nufleet.robot_agent.flight.online_gp import WINDOW_POINTS, OnlineGp
from nufleet.robot_agent.flight.rich_flight import (
    FlightRecord,
    fly_record,
    rich_references,
    step_references,
)
from nufleet.robot_agent.flight.tracking import STOPPED, Learner, TrackingRecord, Watch, track
from nufleet.robot_agent.motion.monitored_robot import MonitoredRobot
from nufleet.robot_agent.motion.pace import HaltSwitch, Pace
from nufleet.robot_agent.motion.paced_robot import PacedRobot
from nufleet.robot_agent.motion.perform import Performance, Samples
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import NufleetError, RobotError
from nufleet.shared.wire.messages import Outcome
from nufleet.shared.wire.motions import (
    Flight,
    RichFlight,
    RichFlightDetails,
    StepTest,
    Tracking,
    TrackingDetails,
)


def performance_of(
    motion: Flight,
    robot: Robot,
    memory: Memory,
    *,
    realtime: float | None,
    switch: HaltSwitch,
    on_played: Callable[[int], None],
    watch: Watch,
) -> Performance:
    """Return the performance of an accepted flight.

    Args:
        motion: Flight to perform.
        robot: The robot, connected and at rest.
        memory: Memory of the robot: source of its prior, and store for the baseline model that a
            rich flight yields.
        realtime: Multiple of real time that a simulated robot keeps; None for as fast as it can.
        switch: Switch that ends the motion early.
        on_played: Callback that receives the number of samples played until now.
        watch: Callback that receives every sample along a tracked path.
    """
    monitored = MonitoredRobot(robot)
    paced = PacedRobot(monitored, Pace(robot.spec, realtime, switch), switch, on_played)
    match motion:
        case StepTest(axis=axis):
            return _Steps(paced, axis, monitored)
        case RichFlight():
            return _Rich(paced, motion, memory, monitored)
        case Tracking():
            return _Path(paced, motion, memory, watch, switch, monitored)


class _Steps:
    """Performs small steps on one axis."""

    def __init__(self, robot: Robot, axis: str, monitored: MonitoredRobot) -> None:
        self._robot, self._monitored = robot, monitored
        column = [known.name for known in robot.spec.axes].index(axis)
        self._references = step_references(robot.spec, column)
        self._outputs = np.empty((0, len(robot.spec.axes)))

    def play(self) -> tuple[Outcome, str]:
        self._monitored.begin(self._references)
        self._outputs = self._robot.run(self._references)
        return Outcome.COMPLETED, ""

    def measured(self) -> Samples:
        return Samples(self._references[: len(self._outputs)], self._outputs)


class _Rich:
    """Performs a persistently exciting flight, from which the robot learns its baseline models."""

    def __init__(
        self, robot: Robot, motion: RichFlight, memory: Memory, monitored: MonitoredRobot
    ) -> None:
        self._robot, self._motion, self._memory = robot, motion, memory
        self._monitored = monitored
        axes, states = len(robot.spec.axes), max(1, len(robot.state_names))
        self._record = FlightRecord(np.empty((0, axes)), np.empty((0, axes, states)))

    def play(self) -> tuple[Outcome, str]:
        spec = self._robot.spec
        rng = np.random.default_rng(self._motion.seed)
        references = rich_references(spec, self._motion.duration_s, rng)
        self._monitored.begin(references)
        self._record = fly_record(self._robot, references)
        outputs = self._record.states[:, :, 0]
        try:
            models = {
                axis.name: identify_baseline(
                    [(references[:, i], outputs[:, i])], spec.sample_time_s, spec.settling_time_s
                )
                for i, axis in enumerate(spec.axes)
            }
            for i, axis in enumerate(spec.axes):
                noise_std = float(self._monitored.noise_std[i])
                check_explained(models[axis.name], references[:, i], noise_std, axis)
            self._memory.keep_baseline(models)
        except NufleetError as error:
            # The robot works and is at rest: the disk failed, or the record allows no model.
            return Outcome.FAILED, f"its baseline was not learned: {error}"
        return Outcome.COMPLETED, ""

    def measured(self) -> Samples:
        states = self._record.states
        names = self._robot.state_names or ("output",)
        details = RichFlightDetails(state_names=names, states=states)
        return Samples(self._record.references, states[:, :, 0].copy(), details)


class _Path:
    """Tracks a path, with the baseline alone or with an inverse model in front of it."""

    def __init__(
        self,
        robot: Robot,
        motion: Tracking,
        memory: Memory,
        watch: Watch,
        switch: HaltSwitch,
        monitored: MonitoredRobot,
    ) -> None:
        self._robot, self._motion, self._monitored = robot, motion, monitored
        self._watch, self._switch, self._memory = watch, switch, memory
        self._learner = learner_for(motion, robot, memory)
        self._guard = None
        if self._learner is not None and motion.guarded:
            self._guard = guard_for(motion.desired, robot, memory)
        self._record: TrackingRecord | None = None

    def play(self) -> tuple[Outcome, str]:
        limits = self._robot.spec.tracking
        if limits is None:
            raise RobotError("the robot does not track")
        # The approach to the path's start begins at rest, too.
        origin = np.zeros((1, len(self._robot.spec.axes)))
        self._monitored.begin(np.concatenate([origin, self._motion.desired]))
        self._record = track(
            self._robot,
            self._motion.desired,
            limits,
            self._learner,
            self._guard,
            watch=self._watch,
            stopped=lambda: self._switch.order is not None,
        )
        if self._record.failure is None:
            return Outcome.COMPLETED, ""
        if self._record.failure == STOPPED and self._switch.order is not None:
            return self._switch.order
        return Outcome.FAILED, self._record.failure

    def measured(self) -> Samples:
        record = self._record
        if record is None:
            nothing = np.empty((0, len(self._robot.spec.axes)))
            return Samples(nothing, nothing)
        details = TrackingDetails(
            desired=record.desired,
            prior=record.prior,
            mean=record.mean,
            variance=record.variance,
            share=record.share,
            limited=record.limited.astype(np.float64),
            step_time_s=record.step_time_s,
            dropped_pairs=record.dropped_pairs,
            taken_back=record.taken_back,
            experts=experts_of(self._motion, self._memory),
            weights=record.weights if self._motion.mixture else None,
        )
        return Samples(record.reference, record.actual, details)


def learner_for(motion: Tracking, robot: Robot, memory: Memory) -> Learner | None:
    """Return the inverse model that a flight asks for, compiled and ready.

    Axes on which the prior was not learned begin with a zero prior.

    Args:
        motion: Flight requested.
        robot: The robot that flies it.
        memory: Memory of the robot, with its prior.

    Returns:
        The learner; None for the baseline alone.

    Raises:
        RobotError: The flight asks for a prior that the robot no longer has.
    """
    if motion.inverse == "baseline":
        return None
    window = WINDOW_POINTS if motion.learn else 0
    axes = robot.spec.axes
    if motion.mixture:
        return mixture_learner(motion, tuple(axis.name for axis in axes), memory, window)
    prior = next((p for p in memory.priors if p.sha256 == motion.prior_sha256), None)
    if prior is None:
        if motion.layout is None:
            raise RobotError("the robot has no prior any more")
        process = OnlineGp(motion.layout, (None,) * len(axes), window=window)
        return Learner(motion.layout, process)
    layout = prior.manifest.layout
    inverses = tuple(prior.inverse if a.name in prior.manifest.axes else None for a in axes)
    return Learner(layout, OnlineGp(layout, inverses, window=window))


def guard_for(desired: FloatArray, robot: Robot, memory: Memory) -> Guard:
    """Return the guard of one flight along a path.

    Args:
        desired: Path, shape (samples, axes), in the axes' units.
        robot: The robot that flies it.
        memory: Memory of the robot, with a baseline model for every axis.

    Raises:
        RobotError: The robot has no tracking limits.
    """
    models = [memory.baseline[axis.name] for axis in robot.spec.axes]
    error = np.stack([m.error(desired[:, i]) for i, m in enumerate(models)], axis=1)
    needed = np.stack([needed_correction(m, desired[:, i]) for i, m in enumerate(models)], axis=1)
    noise_variance = sum(model.residual_std**2 for model in models)
    limits = robot.spec.tracking
    if limits is None:
        raise RobotError("the robot does not track")
    return Guard(
        error,
        noise_variance,
        robot.spec.sample_time_s,
        limits.acceleration_max,
        needed,
        correction_speed_max=limits.correction_speed_max,
    )
