"""A robot that writes down each of its motions, so that what moved when is known from its own side.

The logbook is a file that every process of a robot appends to, one line for each event, each line
in one write: a process that is killed leaves whole lines. Times are of `time.monotonic`, which on
one machine is the same clock for all processes.
"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from nufleet.robot_agent.robot import Robot, RobotAround
from nufleet.shared.arrays import FloatArray
from nufleet.shared.robots.drivers import load_driver
from nufleet.shared.strict import NonNegative, Strict

CONNECTED, MOVES, TOLD_TO_REST, RESTS = "connected", "moves", "told to rest", "rests"
HALF_WAY = "is half way"
"""Written in no logbook: a moment to die at, a second of the robot's time into a motion."""

_LOOK_S = 0.01
"""Interval between two looks for the file that a robot awaits."""


class LoggedRobotSettings(Strict):
    """A driver and its settings, as in a fleet file, and what the robot does beside them."""

    driver: str
    """Name of the driver."""

    settings: dict[str, Any]
    """Settings of the driver."""

    logbook: str
    """Path of the logbook."""

    rest_s: NonNegative = 0.0
    """Time that the robot takes to come to rest."""

    rest_awaits: str | None = None
    """Path of a file that must exist before the robot comes to rest; None to wait for none."""


@dataclass(frozen=True)
class Entry:
    """One line of a logbook."""

    time_s: float
    robot: str
    pid: int
    what: str


def read_logbook(path: Path) -> list[Entry]:
    """Return what is written in a logbook, oldest first; nothing where there is none yet."""
    if not path.exists():
        return []
    return [Entry(**json.loads(line)) for line in path.read_text().splitlines()]


@dataclass(frozen=True)
class Stretch:
    """A robot's motion from its first sample to the order to rest; None if its process died."""

    robot: str
    began_s: float
    ended_s: float | None


def die_at(logbook: Path, moment: str) -> None:
    """Have a robot's process be killed, once, when its robot next comes to a moment."""
    _fate(logbook).write_text(moment)


def _fate(logbook: Path) -> Path:
    return logbook.with_suffix(".fate")


def motions(entries: list[Entry]) -> list[Stretch]:
    """Return every motion of a logbook, in the order in which they began."""
    found: list[Stretch] = []
    open_since: dict[str, float] = {}
    for entry in sorted(entries, key=lambda e: e.time_s):
        began_s = open_since.get(entry.robot)
        if entry.what == MOVES:
            open_since[entry.robot] = entry.time_s
        elif began_s is not None and entry.what in (TOLD_TO_REST, CONNECTED):
            ended_s = entry.time_s if entry.what == TOLD_TO_REST else None
            found.append(Stretch(entry.robot, began_s, ended_s))
            del open_since[entry.robot]
    found += [Stretch(robot, began_s, None) for robot, began_s in open_since.items()]
    return sorted(found, key=lambda stretch: stretch.began_s)


class LoggedRobot(RobotAround):
    """A wrapper of another robot that moves it exactly to its origin at the end of each rest.

    Equal motions then measure equally: without noise, a test gives the same samples no matter what
    happened before it.
    """

    def __init__(self, name: str, robot: Robot, settings: LoggedRobotSettings) -> None:
        super().__init__(robot)
        self._name = name
        self._rest_s = settings.rest_s
        self._awaited = None if settings.rest_awaits is None else Path(settings.rest_awaits)
        logbook = Path(settings.logbook)
        self._file = os.open(logbook, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
        self._fate = _fate(logbook)
        self._moving = False
        self._played = 0

    def connect(self) -> None:
        """Connect the robot inside."""
        self._write(CONNECTED)
        self._robot.connect()

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample."""
        return np.asarray(self.run(reference[np.newaxis])[0])

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a whole reference signal."""
        if not self._moving:
            self._moving, self._played = True, 0
            self._write(MOVES)
        before, self._played = self._played, self._played + len(references)
        if before * self.spec.sample_time_s < 1.0 <= self._played * self.spec.sample_time_s:
            self._meet_fate(HALF_WAY)
        return self._robot.run(references)

    def rest(self) -> None:
        """Bring the robot inside to rest, and put it exactly to its origin."""
        self._write(TOLD_TO_REST)
        if self._rest_s:
            time.sleep(self._rest_s)
        while self._awaited is not None and not self._awaited.exists():
            time.sleep(_LOOK_S)
        self._robot.rest()
        self._robot.connect()
        self._moving = False
        self._write(RESTS)

    def _write(self, what: str) -> None:
        line = {"time_s": time.monotonic(), "robot": self._name, "pid": os.getpid(), "what": what}
        os.write(self._file, json.dumps(line).encode() + b"\n")
        self._meet_fate(what)

    def _meet_fate(self, moment: str) -> None:
        if self._fate.exists() and self._fate.read_text() == moment:
            self._fate.unlink()
            os.kill(os.getpid(), signal.SIGKILL)


@dataclass(frozen=True)
class LoggedRobotDriver:
    """Builds robots of other drivers that keep logbooks."""

    settings: type[LoggedRobotSettings] = LoggedRobotSettings
    shares_process: bool = False
    environment: Mapping[str, str] = field(default_factory=dict)

    def build(
        self, settings: Mapping[str, LoggedRobotSettings], rng: np.random.Generator
    ) -> Mapping[str, LoggedRobot]:
        """Build the robots, disconnected, by name."""
        return {name: _built(name, own, rng) for name, own in settings.items()}


def _built(name: str, settings: LoggedRobotSettings, rng: np.random.Generator) -> LoggedRobot:
    driver = load_driver(settings.driver)
    inner = driver.settings.model_validate_json(json.dumps(settings.settings, default=str))
    robot = driver.build({name: inner}, rng)[name]
    return LoggedRobot(name, robot, settings)


LOGGED = LoggedRobotDriver()


def install_driver(folder: Path) -> None:
    """Make the driver `logged` known to processes that have `folder` on their PYTHONPATH."""
    metadata = folder / "nufleet_faults-1.dist-info"
    metadata.mkdir(parents=True, exist_ok=True)
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: nufleet-faults\nVersion: 1\n")
    (metadata / "entry_points.txt").write_text(f"[nufleet.robots]\nlogged = {__name__}:LOGGED\n")
