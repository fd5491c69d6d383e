"""A copy of a simulated robot in this process, which plays tests with other settings."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from nufleet.orchestrator.study.settings_fit import Setting
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import FleetFileError, InvalidInputError
from nufleet.shared.frequency_test.excitation import ExcitationPlan
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.shared.robots.drivers import load_driver, settings_of
from nufleet.shared.robots.fleet_file import FleetFile, validated_settings
from nufleet.shared.robots.spec import RobotSpec

PlayedTest = tuple[ExcitationPlan, FloatArray]
"""A test of one axis as a robot played it: its plan, and its reference of shape (samples,)."""


class _Simulated(Protocol):
    """What is used of `nufleet.robot_agent.robot.Robot`."""

    @property
    def spec(self) -> RobotSpec: ...
    def connect(self) -> None: ...
    def begin(self) -> None: ...
    def run(self, references: FloatArray) -> FloatArray: ...
    def record(self) -> object | None: ...
    def rest(self) -> None: ...
    def end(self) -> None: ...
    def disconnect(self) -> None: ...


class SimulatorCopy:
    """A simulated robot of a fleet file, of which some settings can be varied."""

    robot: str
    """Name of the robot."""

    def __init__(self, fleet: FleetFile, path: Path, robot: str, names: Sequence[str]) -> None:
        """Find the settings; nothing is built.

        Args:
            fleet: Contents of the fleet file.
            path: Path of the fleet file.
            robot: Name of the robot.
            names: Names of the settings that are varied, or the ends of their paths, such as
                `mass_kg` for `vehicle.mass_kg`.

        Raises:
            FleetFileError: The driver cannot be loaded.
            InvalidInputError: A setting does not exist, is ambiguous, or is no number.
        """
        entry = fleet.robots[robot]
        self._driver, self._path, self.robot = load_driver(entry.driver), path, robot
        self._seed = fleet.seed
        validated = settings_of(fleet, path, [robot], self._driver)[robot]
        self._document = json.loads(validated.model_dump_json(by_alias=True))
        # The document would not tell 1.0 from 1, and a whole number cannot be varied.
        self._leaves = dict(_leaves(validated.model_dump(by_alias=True)))
        self._starts = dict(self._found(name) for name in names)

    @property
    def environment(self) -> Mapping[str, str]:
        """Environment variables that this process needs from its start."""
        return self._driver.environment

    def settings(self) -> dict[str, Setting]:
        """Return the settings that are varied, by path."""
        return {
            path: Setting(start, negative=start < 0 or self._accepts({path: -1e-9}))
            for path, start in self._starts.items()
        }

    def check(self) -> None:
        """Build the robot once; raises InvalidInputError if it is real or cannot be built."""
        if not self._built({}).spec.simulated:
            raise InvalidInputError(
                f"--fit varies the settings of a simulated robot, and {self.robot} is real; "
                "name its simulator with --simulators"
            )

    def responses(
        self, values: Mapping[str, float], tests: Sequence[PlayedTest]
    ) -> list[FrequencyResponse]:
        """Play tests on a new robot, with the same noise each time.

        Args:
            values: Values of settings, by path; the fleet file holds the others.
            tests: Tests of one axis each.

        Raises:
            FleetFileError: The driver refuses these values.
            InvalidInputError: The robot has another sample time with them, or records its outputs
                apart.
            RobotError: The robot cannot play a test with them.
        """
        robot = self._built(values)
        names = [axis.name for axis in robot.spec.axes]
        found = []
        robot.connect()
        try:
            robot.begin()
            for plan, reference in tests:
                if robot.spec.sample_time_s != plan.sample_time_s:
                    raise InvalidInputError(
                        f"the tests of {self.robot} have samples of {plan.sample_time_s:g} s, "
                        "which --fit cannot vary"
                    )
                whole = np.zeros((len(reference), len(names)))
                column = names.index(plan.axis)
                whole[:, column] = reference
                outputs = robot.run(whole)[:, column]
                if robot.record() is not None:
                    raise InvalidInputError(
                        f"--fit cannot simulate the link over which {self.robot} records its "
                        "outputs; give the simulator a driver without one"
                    )
                found.append(estimate_frequency_response(reference, outputs, plan))
                robot.rest()
            robot.end()
        finally:
            robot.disconnect()
        return found

    def lines(self, values: Mapping[str, float]) -> str:
        """Return the lines of the fleet file that give the robot these settings."""
        changed = self._changed({path: float(f"{value:.5g}") for path, value in values.items()})
        lines = {}
        for path in values:
            keys = path.split(".")
            value: Any = changed
            for depth, key in enumerate(keys):  # a list is written as a whole
                value = value[key]
                if isinstance(value, list) or depth == len(keys) - 1:
                    lines[".".join(keys[: depth + 1])] = json.dumps(value)
                    break
        return "\n".join(
            [f"[robots.{self.robot}.settings]", *(f"{key} = {text}" for key, text in lines.items())]
        )

    def _built(self, values: Mapping[str, float]) -> _Simulated:
        settings = self._validated(values)
        # Not the noise that the robot had when its agent played the tests.
        rng = np.random.default_rng([self._seed, *b"fit"])
        robot: _Simulated = self._driver.build({self.robot: settings}, rng)[self.robot]
        return robot

    def _validated(self, values: Mapping[str, float]) -> Any:
        document = self._changed(values)
        return validated_settings(self._driver.settings, self._path, self.robot, document)

    def _accepts(self, values: Mapping[str, float]) -> bool:
        try:
            self._validated(values)
        except FleetFileError:
            return False
        return True

    def _changed(self, values: Mapping[str, float]) -> dict[str, Any]:
        document: dict[str, Any] = json.loads(json.dumps(self._document))
        for path, value in values.items():
            *parents, last = path.split(".")
            place: Any = document
            for key in parents:
                place = place[int(key) if isinstance(place, list) else key]
            place[int(last) if isinstance(place, list) else last] = value
        return document

    def _found(self, name: str) -> tuple[str, float]:
        paths = [name] if name in self._leaves else []
        paths = paths or [path for path in self._leaves if path.endswith(f".{name}")]
        if len(paths) > 1:
            raise InvalidInputError(
                f"--fit: {self.robot} has several settings {name}: give one of {', '.join(paths)}"
            )
        numbers = ", ".join(p for p, value in self._leaves.items() if isinstance(value, float))
        if not paths:
            raise InvalidInputError(
                f"--fit: {self.robot} has no setting {name}; its settings that are numbers: "
                f"{numbers or 'none'}"
            )
        value = self._leaves[paths[0]]
        if not isinstance(value, float):
            raise InvalidInputError(
                f"--fit: setting {paths[0]} of {self.robot} is {json.dumps(value, default=str)}, "
                f"and only numbers with a decimal point can be fitted: {numbers or 'none'}"
            )
        return paths[0], value


def _leaves(document: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Yield the path and value of everything in a document that holds nothing else."""
    if isinstance(document, dict):
        inside = document.items()
    elif isinstance(document, list | tuple) and document:
        inside = {str(place): one for place, one in enumerate(document)}.items()
    else:
        yield path, document
        return
    for key, one in inside:
        yield from _leaves(one, f"{path}.{key}" if path else str(key))
