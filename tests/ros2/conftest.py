"""Robots that a node of ROS 2 plays in another process, each test in a domain of its own."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from nufleet.robot_agent.driver_kit import statements
from nufleet.robot_agent.drivers.ros2 import robot
from nufleet.robot_agent.motion import resampling

ROOT = Path(__file__).parents[2]
_numbers = count()


class Plant:
    """The process of one robot."""

    def __init__(self, settings: dict[str, Any]) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "benchmarks.ros2_plant", json.dumps(settings)],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        assert self._process.stdout is not None
        self.said: list[str] = []
        ready = threading.Event()
        lines = self._process.stdout

        def read() -> None:
            for line in lines:
                self.said.append(line.strip())
                ready.set()
            ready.set()

        self._reader = threading.Thread(target=read)
        self._reader.start()
        ready.wait()
        assert self.said == ["ready"]

    def close(self) -> list[str]:
        """End the robot; return all that it said."""
        if self._process.returncode is not None:
            return self.said
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        self._process.wait()
        self._reader.join()
        self._process.stdout.close()
        return self.said


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """A robot's process that gets no processor for a while is no robot that is lost."""
    for module in (robot, resampling):
        monkeypatch.setattr(module, "LOST_MAX_S", 5.0)
    monkeypatch.setattr(robot, "GAP_MAX_S", 20.0)
    # How exactly samples keep their time is stated in virtual time.
    monkeypatch.setattr(statements, "PERIOD_ERROR", 3.0)


@pytest.fixture
def domain() -> int:
    """A ROS domain that no other test of this run uses."""
    return 1 + (7 * os.getpid() + next(_numbers)) % 100


@pytest.fixture
def start_plant(domain: int) -> Iterator[Callable[..., Plant]]:
    """A function that starts a robot; it ends with the test."""
    with ExitStack() as running:

        def start(**settings: Any) -> Plant:
            given = {"namespace": "/cf1", "domain_id": domain, **settings}
            plant = Plant(given)
            running.callback(plant.close)
            return plant

        yield start
