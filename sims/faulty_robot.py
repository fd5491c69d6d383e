"""Another robot with faults of its sensor and driver, for finding out what becomes of them."""

from __future__ import annotations

import json
import os
import threading
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np
from pydantic import Field, ValidationError, model_validator

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import FleetFileError, RobotError
from nufleet.shared.robots.drivers import load_driver
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.strict import Strict, describe_validation
from nufleet.sims.faults import Crash, DriverFault, DropOut, Fault, Hang
from nufleet.sims.faulty_sensor import FaultySensor

EXIT_CODE = 70
"""With which a process ends whose driver crashes."""


class FaultyRobotSettings(Strict):
    """A driver and its settings, as in a fleet file, and what goes wrong, in this order."""

    driver: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,62}$")]
    settings: Annotated[dict[str, Any], Field(default_factory=dict)]
    faults: tuple[Fault, ...]

    @model_validator(mode="after")
    def _can_be_built(self) -> FaultyRobotSettings:
        try:
            driver = load_driver(self.driver)
        except FleetFileError as error:
            raise ValueError(str(error)) from error
        if driver.shares_process or driver.environment:
            raise ValueError(
                f"driver {self.driver!r} needs a process of its own kind; only robots that can "
                "live in any process can be made faulty"
            )
        try:
            driver.settings.model_validate_json(json.dumps(self.settings, default=str))
        except ValidationError as error:
            raise ValueError(f"settings: {describe_validation(error)}") from error
        return self


class FaultyRobot(Robot):
    """A robot behind a faulty sensor and driver; to come to rest it needs neither."""

    def __init__(self, robot: Robot, faults: tuple[Fault, ...], rng: np.random.Generator) -> None:
        """Wrap a robot; what is random about the faults comes from `rng` alone."""
        self._robot = robot
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
        # What `observe` measured of the current sample, which `step` will return.
        self._seen: FloatArray | None = None

    @property
    def spec(self) -> RobotSpec:
        """That of the robot inside."""
        return self._robot.spec

    @property
    def state_names(self) -> tuple[str, ...]:
        """Those of the robot inside."""
        return self._robot.state_names

    def connect(self) -> None:
        """Connect the robot inside; its motions are counted on."""
        self._rested()
        self._robot.connect()

    def measure_output(self) -> FloatArray:
        """Measure the output at rest; faults begin with a motion."""
        return self._robot.measure_output()

    def observe(self) -> FloatArray:
        """Measure the state now: the output with the faulty sensor, its derivatives without."""
        states = self._robot.observe()
        if states.shape[1]:
            self._begin_motion()
            if self._seen is None:
                self._seen = self._measured(states[np.newaxis, :, 0])[0]
            states = states.copy()
            states[:, 0] = self._seen
        return states

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample, if no fault prevents it."""
        output: FloatArray = self.run(reference[np.newaxis])[0]
        return output

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a signal up to the sample at which the driver fails, if it does."""
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
        """Let go of the robot inside."""
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
        """Return at which of the next samples the driver fails, and how, in their order."""
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
            raise RobotError(f"the driver got no sample {sample}")
        case Crash(way="exits"):
            os._exit(EXIT_CODE)
        case Crash():
            raise OSError(f"the driver broke at sample {sample}")
        case Hang(hang_s=hang_s):
            # No robot answers meanwhile; nothing in this process can end it.
            threading.Event().wait(hang_s)


@dataclass(frozen=True)
class FaultyRobotDriver:
    """Builds robots of other drivers with faults; each can live in a process of its own."""

    settings: type[FaultyRobotSettings] = FaultyRobotSettings
    shares_process: bool = False
    environment: Mapping[str, str] = field(default_factory=dict)

    def build(
        self, settings: Mapping[str, FaultyRobotSettings], rng: np.random.Generator
    ) -> Mapping[str, FaultyRobot]:
        """Build the robots, disconnected, by name.

        The robot inside gets the noise that it would have without faults.
        """
        return {name: _built(name, own, rng) for name, own in settings.items()}


def _built(name: str, settings: FaultyRobotSettings, rng: np.random.Generator) -> FaultyRobot:
    driver = load_driver(settings.driver)
    inner = driver.settings.model_validate_json(json.dumps(settings.settings, default=str))
    robot = driver.build({name: inner}, rng)[name]
    return FaultyRobot(robot, settings.faults, rng.spawn(1)[0])


FAULTY = FaultyRobotDriver()
