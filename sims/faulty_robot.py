"""A wrapper that gives another robot faults of its sensor and driver, to test their handling."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from nufleet.robot_agent.robot import Robot, RobotAround
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import FleetFileError, RobotError
from nufleet.shared.robots.drivers import load_driver
from nufleet.shared.strict import Strict, validation_errors_as
from nufleet.sims.faults import Crash, DriverFault, DropOut, Fault, Hang
from nufleet.sims.faulty_sensor import FaultySensor
from nufleet.sims.field import FieldRobot, FieldSettings

EXIT_CODE = 70
"""Exit status of a process whose driver crashes."""


class FaultyRobotSettings(Strict):
    """A robot as in a fleet file, and its faults."""

    driver: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,62}$")]
    """Name of the driver of the robot inside."""

    settings: Annotated[dict[str, Any], Field(default_factory=dict)]
    """Settings of the robot inside."""

    faults: tuple[Fault, ...] = ()
    """Faults, in the order in which they are applied."""

    field: FieldSettings | None = None
    """Conditions under which the robot plays a real one; None for a simulated one."""

    @model_validator(mode="after")
    def _can_be_built(self) -> FaultyRobotSettings:
        try:
            driver = load_driver(self.driver)
        except FleetFileError as error:
            raise ValueError(str(error)) from error
        if driver.shares_process or driver.environment:
            raise ValueError(
                f"driver {self.driver!r} needs a process of a particular kind; only robots that "
                "run in any process can be made faulty"
            )
        with validation_errors_as(ValueError, "settings"):
            driver.settings.model_validate_json(json.dumps(self.settings, default=str))
        return self


class FaultyRobot(RobotAround):
    """A robot behind a faulty sensor and driver; coming to rest is not affected by faults."""

    def __init__(self, robot: Robot, faults: tuple[Fault, ...], rng: np.random.Generator) -> None:
        """Wrap a robot.

        Args:
            robot: The robot inside, disconnected.
            faults: Faults, in the order in which they are applied.
            rng: Generator of everything random about the faults.
        """
        super().__init__(robot)
        sample_time_s = robot.spec.sample_time_s
        self._sensors: list[FaultySensor] = []
        self._failures: list[tuple[DriverFault, np.random.Generator]] = []
        for fault, own in zip(faults, rng.spawn(len(faults)), strict=True):
            if isinstance(fault, DropOut | Crash | Hang):
                self._failures.append((fault, own))
            else:
                self._sensors.append(FaultySensor(fault, sample_time_s, own))
        self._motion, self._sample = 0, 0
        self._resting = True
        # Output that `observe` has measured for the current sample; `step` returns the same.
        self._seen: FloatArray | None = None

    def connect(self) -> None:
        """Connect the robot inside; the count of its motions continues."""
        self._rested()
        self._robot.connect()

    def observe(self) -> FloatArray:
        """Measure the state, shape (axes, states); only the output passes the faulty sensor."""
        states = self._robot.observe()
        if states.shape[1]:
            self._begin_motion()
            if self._seen is None:
                self._seen = self._measured(states[np.newaxis, :, 0])[0]
            states = states.copy()
            states[:, 0] = self._seen
        return states

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference, shape (axes,), for one sample unless the driver fails."""
        output: FloatArray = self.run(reference[np.newaxis])[0]
        return output

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a signal, shape (samples, axes), up to the sample at which the driver fails."""
        self._begin_motion()
        outputs, done = [], 0
        for at, fault in self._failing(len(references)):
            outputs.append(self._follow(references[done:at]))
            done = at
            _fail(fault, self._sample)
        outputs.append(self._follow(references[done:]))
        return np.concatenate(outputs)

    def rest(self) -> None:
        """Bring the robot inside to rest."""
        self._rested()
        self._robot.rest()

    def disconnect(self) -> None:
        """Disconnect the robot inside."""
        self._rested()
        self._robot.disconnect()

    def _begin_motion(self) -> None:
        if self._resting:
            self._resting = False
            self._motion += 1
            self._sample = 0
            for sensor in self._sensors:
                sensor.begin_motion()

    def _rested(self) -> None:
        self._resting = True
        self._seen = None

    def _failing(self, count: int) -> list[tuple[int, DriverFault]]:
        """Return the offsets of the next samples at which the driver fails, in order, and how."""
        found: list[tuple[int, DriverFault]] = []
        for fault, rng in self._failures:
            fails = fault.acts(self._motion, self._sample, count, self.spec.sample_time_s)
            if isinstance(fault, DropOut):
                fails &= rng.random(count) < fault.probability
            found += [(int(at), fault) for at in np.flatnonzero(fails)]
        return sorted(found, key=lambda one: one[0])

    def _follow(self, references: FloatArray) -> FloatArray:
        if not len(references):
            return np.empty_like(references)
        outputs = self._robot.run(references)
        self._sample += len(references)
        seen, self._seen = self._seen, None
        if seen is None:
            return self._measured(outputs)
        return np.concatenate([seen[np.newaxis], self._measured(outputs[1:])])

    def _measured(self, outputs: FloatArray) -> FloatArray:
        for sensor in self._sensors:
            outputs = sensor.measured(outputs)
        return outputs


def _fail(fault: DriverFault, sample: int) -> None:
    match fault:
        case DropOut():
            raise RobotError(f"the driver received no sample {sample}")
        case Crash(way="exits"):
            os._exit(EXIT_CODE)
        case Crash():
            raise OSError(f"the driver failed at sample {sample}")
        case Hang(hang_s=hang_s):
            # The robot does not answer during this time, and nothing in this process can end it.
            threading.Event().wait(hang_s)


class FaultyRobotDriver:
    """Builds robots of other drivers with faults; each can run in a process of its own."""

    settings: type[Strict] = FaultyRobotSettings
    """Settings of one robot in a fleet file."""
    shares_process = False
    """Whether the robots of a fleet have to run in one process."""
    environment: Mapping[str, str] = {}
    """Environment variables that the process of a robot needs."""

    def build(
        self, settings: Mapping[str, FaultyRobotSettings], rng: np.random.Generator
    ) -> Mapping[str, Robot]:
        """Build the robots, disconnected, by name.

        The robot inside has the same noise as it would have without faults.
        """
        return {name: _built(name, own, rng) for name, own in settings.items()}


def _built(name: str, settings: FaultyRobotSettings, rng: np.random.Generator) -> Robot:
    driver = load_driver(settings.driver)
    inner = driver.settings.model_validate_json(json.dumps(settings.settings, default=str))
    robot = driver.build({name: inner}, rng)[name]
    faulty = FaultyRobot(robot, settings.faults, rng.spawn(1)[0])
    if settings.field is None:
        return faulty
    return FieldRobot(faulty, settings.field, rng.spawn(1)[0])


FAULTY = FaultyRobotDriver()
