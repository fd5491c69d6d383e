"""Performs every motion but frequency tests: step tests, rich flights and tracked paths."""

from __future__ import annotations

import logging
from collections.abc import Callable

import numpy as np

from nufleet.robot_agent.flight.equipment import equipment_for
from nufleet.robot_agent.flight.forecast import forecast_of
from nufleet.robot_agent.flight.learning import (
    learn,
    learn_unexplained,
    learned_from,
    states_in,
)
from nufleet.robot_agent.flight.memory import Memory, MemoryFolderError
from nufleet.robot_agent.flight.mixture_learner import experts_of
from nufleet.robot_agent.flight.own_model import check_explained
from nufleet.robot_agent.flight.rich_flight import FlightRecord, fly_record
from nufleet.robot_agent.flight.tracking import Watch, track
from nufleet.robot_agent.flight.tracking_record import STOPPED, TrackingRecord
from nufleet.robot_agent.motion.monitored_robot import MonitoredRobot
from nufleet.robot_agent.motion.pace import HaltSwitch, Pace
from nufleet.robot_agent.motion.paced_robot import PacedRobot
from nufleet.robot_agent.motion.perform import Performance, Samples
from nufleet.robot_agent.robot import Robot
from nufleet.shared.errors import NufleetError, RobotError
from nufleet.shared.paths.references import rich_references, step_references
from nufleet.shared.wire.messages import Outcome
from nufleet.shared.wire.motions import (
    Flight,
    PredictedError,
    RichFlight,
    RichFlightDetails,
    StepTest,
    Tracking,
    TrackingDetails,
)

_log = logging.getLogger(__name__)


def performance_of(
    motion: Flight,
    robot: Robot,
    memory: Memory,
    *,
    realtime: float | None,
    switch: HaltSwitch,
    on_played: Callable[[int], None],
    watch: Watch,
    foretold: PredictedError | None = None,
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
        foretold: Error that was predicted for it before; None if it was not.
    """
    monitored = MonitoredRobot(robot)
    paced = PacedRobot(monitored, Pace(robot.spec, realtime, switch), switch, on_played)
    match motion:
        case StepTest(axis=axis):
            return _Steps(paced, axis, monitored)
        case RichFlight():
            return _Rich(paced, motion, memory, monitored)
        case Tracking():
            return _Path(paced, motion, memory, watch, switch, monitored, foretold)


class _Steps:
    """Performs small steps on one axis."""

    def __init__(self, robot: Robot, axis: str, monitored: MonitoredRobot) -> None:
        self._robot, self._monitored = robot, monitored
        column = [known.name for known in robot.spec.axes].index(axis)
        self._references = step_references(robot.spec, column)
        self._outputs = np.empty((0, len(robot.spec.axes)))

    def play(self) -> tuple[Outcome, str]:
        self._monitored.begin_motion(self._references)
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
        self._monitored.begin_motion(references)
        self._record = fly_record(self._robot, references)
        outputs = self._record.states[:, :, 0]
        try:
            evidence, crosses = learned_from(spec, references, outputs)
            for axis, noise_std in zip(spec.axes, self._monitored.noise_std, strict=True):
                check_explained(evidence[axis.name], spec, axis, float(noise_std))
            self._memory.learn(
                evidence,
                states_in(self._robot, self._record.states),
                crosses,
            )
            learn_unexplained(self._memory, spec, references, outputs, self._monitored.noise_std)
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
        foretold: PredictedError | None,
    ) -> None:
        self._robot, self._motion, self._monitored = robot, motion, monitored
        self._watch, self._switch, self._memory = watch, switch, memory
        self._foretold = foretold
        self._forecast = forecast_of(memory.own_model(robot.spec).model, motion.desired)
        self._equipment = equipment_for(motion, robot, memory, self._forecast)
        self._record: TrackingRecord | None = None
        self._findings: tuple[str, ...] = ()

    def play(self) -> tuple[Outcome, str]:
        limits = self._robot.spec.tracking
        if limits is None:
            raise RobotError("the robot does not track")
        # The approach to the path's start begins at rest, too.
        origin = np.zeros((1, len(self._robot.spec.axes)))
        self._monitored.begin_motion(np.concatenate([origin, self._motion.desired]))
        self._record = track(
            self._robot,
            self._motion.desired,
            limits,
            self._equipment.learner,
            self._equipment.guard,
            fallback=self._equipment.fallback,
            watch=self._watch,
            stopped=lambda: self._switch.order is not None,
        )
        if self._record.failure is None:
            if self._motion.remember:
                self._learn(self._record)
            return Outcome.COMPLETED, ""
        if self._record.failure == STOPPED and self._switch.order is not None:
            return self._switch.order
        self._monitored.raise_again()
        return Outcome.FAILED, self._record.failure

    def _learn(self, record: TrackingRecord) -> None:
        """Add the flight to the robot's model of itself, and compare it with that."""
        spec, noise_std = self._robot.spec, self._monitored.noise_std
        references, outputs = record.reference, record.actual
        try:
            learn(
                self._memory, spec, references, outputs, before=self._memory.own_model(spec).model
            )
            self._findings = learn_unexplained(self._memory, spec, references, outputs, noise_std)
        except MemoryFolderError as error:
            _log.warning("%s", error)

    @property
    def _own(self) -> bool:
        return self._motion.inverse == "own"

    @property
    def _predicted(self) -> PredictedError | None:
        if self._forecast is None:
            return None
        match self._motion.inverse:
            case "baseline":
                return self._forecast.baseline
            case "own":
                return self._forecast.own
            case _:
                return self._foretold

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
            predicted=self._predicted,
            way=self._forecast.way.reason if self._forecast and self._own else None,
            findings=self._findings,
        )
        return Samples(record.reference, record.actual, details)
