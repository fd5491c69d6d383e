"""Starts a router and the agents of a fleet file as processes, and makes sure that all end."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import IO

from nufleet.shared.errors import EndpointInUseError, NufleetError
from nufleet.shared.interrupts import Interrupts, postponed
from nufleet.shared.robots.drivers import load_driver, shared_thing
from nufleet.shared.robots.fleet_file import FleetFile, validated_settings
from nufleet.shared.wire.identity import IDENTITY_VARIABLE
from nufleet.shared.wire.openness import OPEN_VARIABLE
from nufleet.shared.wire.transport import open_client

GRACE_S = 90.0
"""Time in s that a process has to bring its robots to rest before it is killed.

It is longer than an agent needs to detect a hanging driver, so that the agent can report that
itself.
"""

ROUTER = "router"
LANDING = "landing: the robots of this fleet are coming to rest, then this process ends by itself"

_log = logging.getLogger(__name__)


@dataclass
class _Child:
    what: str
    process: subprocess.Popen[bytes]
    log: IO[bytes]

    def last_words(self) -> str:
        """The last lines that the process printed."""
        # The child shares the file offset for writing, so the file is read without moving it.
        size = os.fstat(self.log.fileno()).st_size
        start = max(0, size - 4000)
        return os.pread(self.log.fileno(), 4000, start).decode(errors="replace").strip()


class FleetProcesses:
    """A context manager that runs a router and agents as child processes and leaves none behind.

    Each child holds the other end of a pipe and ends when the pipe closes, so that even a killed
    parent leaves nothing running.
    """

    def __init__(self) -> None:
        self._children: list[_Child] = []

    def __enter__(self) -> FleetProcesses:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def start_router(self, endpoint: str, *, timeout_s: float = 20.0) -> None:
        """Start a router and wait until it answers.

        Args:
            endpoint: Endpoint at which the router is to listen.
            timeout_s: Longest time to wait for its first answer, in s.

        Raises:
            EndpointInUseError: The endpoint is taken.
        """
        child = self._start(ROUTER, ["router"], {"NUFLEET_LISTEN": endpoint})
        deadline = time.monotonic() + timeout_s
        while "router listening on" not in child.last_words():
            if child.process.poll() is not None:
                raise EndpointInUseError(child.last_words().removeprefix("error: "))
            if time.monotonic() > deadline:
                raise NufleetError(f"the router did not start within {timeout_s:g} s")
            time.sleep(0.01)
        with open_client(endpoint, timeout_s=timeout_s):
            pass

    def start_agents(
        self,
        path: Path,
        groups: list[tuple[str, ...]],
        endpoint: str,
        realtime: float | None,
        *,
        state_folder: Path | None = None,
    ) -> None:
        """Start one process for each group of robots; the robots appear once they are ready.

        Args:
            path: Path of the fleet file.
            groups: Names of the robots in each process.
            endpoint: Endpoint of the router.
            realtime: Multiple of real time at which simulated robots play; None plays as fast as
                possible.
            state_folder: Folder for the persistent state of the agents; None takes their default
                folder.
        """
        for group in groups:
            arguments = ["agent", str(path)]
            arguments += [part for robot in group for part in ("--robot", robot)]
            if realtime is not None:
                arguments += ["--realtime", str(realtime)]
            if state_folder is not None:
                arguments += ["--state", str(state_folder)]
            reached = {"NUFLEET_ROUTER": endpoint}
            self._start(f"agent of {', '.join(group)}", arguments, reached)

    def dead(self) -> list[str]:
        """Return the name and the last output of each process that ended on its own."""
        return [
            f"{child.what} ended with exit code {child.process.returncode}: {child.last_words()}"
            for child in self._children
            if child.process.poll() is not None
        ]

    def stop(self) -> None:
        """End all processes, agents first, so that robots come to rest while the router still runs.

        An interruption prints that the robots are landing, and does not stop the procedure.
        """
        with Interrupts(LANDING, held=True):
            self._stop()

    def _stop(self) -> None:
        agents = [child for child in self._children if child.what != ROUTER]
        routers = [child for child in self._children if child.what == ROUTER]
        try:
            for children in (agents, routers):
                _end(children)
        finally:
            for child in self._children:
                child.process.kill()  # does nothing to one that has ended
                child.process.wait()
                child.log.close()
            self._children.clear()

    def _start(self, what: str, arguments: list[str], environment: dict[str, str]) -> _Child:
        """Start a process; secrets are passed in its environment, which other users cannot read."""
        log = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the child
        with postponed():
            process = subprocess.Popen(
                [sys.executable, "-P", "-m", "nufleet", *arguments, "--until-stdin-closes"],
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                # Its endpoint was chosen and accepted here; an identity would name another one.
                env={**_without_identity(), OPEN_VARIABLE: "1", **environment},
                # A Ctrl-C is for the parent, which ends the children in order.
                start_new_session=True,
            )
            child = _Child(what, process, log)
            self._children.append(child)
        return child


def _without_identity() -> dict[str, str]:
    return {name: value for name, value in os.environ.items() if name != IDENTITY_VARIABLE}


def _end(children: list[_Child]) -> None:
    """Ask all processes to end at the same time, and kill those still running after `GRACE_S`."""
    for child in children:
        if child.process.stdin is not None:
            child.process.stdin.close()
    deadline = time.monotonic() + GRACE_S
    for child in children:
        try:
            child.process.wait(max(0.0, deadline - time.monotonic()))
        except subprocess.TimeoutExpired:
            _log.warning(
                "%s did not end within %g s and was killed: if it moves real robots, make sure "
                "that they are at rest",
                child.what,
                GRACE_S,
            )
            child.process.kill()
            child.process.wait()


def grouped(fleet: FleetFile, *, processes: int) -> list[tuple[str, ...]]:
    """Distribute a fleet's robots over processes, and keep together those that must share one.

    Args:
        fleet: Fleet file with the robots.
        processes: Largest number of processes, at least 1.

    Returns:
        The names of the robots in each process.

    Raises:
        ValueError: The number of processes is less than 1.
    """
    if processes < 1:
        raise ValueError(f"a fleet needs at least one process, got {processes}")
    together: dict[str, list[str]] = {}
    alone: list[str] = []
    drivers = {name: load_driver(name) for name in {e.driver for e in fleet.robots.values()}}
    for robot, entry in fleet.robots.items():
        driver = drivers[entry.driver]
        place = Path(fleet.name)
        settings = partial(validated_settings, driver.settings, place, robot, entry.settings)
        shared = shared_thing(driver, settings)
        if shared is None:
            alone.append(robot)
        else:
            together.setdefault(f"{entry.driver} {shared}", []).append(robot)
    dealt = [tuple(alone[start::processes]) for start in range(min(processes, len(alone)))]
    return [tuple(members) for members in together.values()] + dealt


def private_folder() -> tempfile.TemporaryDirectory[str]:
    """Return a new temporary folder that no other user may look into; leaving it deletes it."""
    return tempfile.TemporaryDirectory(prefix="nufleet-", ignore_cleanup_errors=True)
