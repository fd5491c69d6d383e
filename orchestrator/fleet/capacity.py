"""How many robots a machine has room for, told before any of them starts."""

from __future__ import annotations

import os
import resource
import sys
from dataclasses import dataclass
from pathlib import Path

from nufleet.shared.errors import InvalidInputError

ROBOTS_PER_CORE = 500
"""Robots per core of the largest fleet that was ranked without losing one, see `docs/scale.md`."""

PROCESS_BYTES = 75 * 2**20
"""Memory of an agent process without its robots."""

ROBOT_BYTES = 5 * 2**18
"""Memory of a robot in such a process, and of its session in the router."""

PROCESS_FILES = 100
ROBOT_FILES = 4
"""Files that an agent process may have open without its robots, and for each of them, which keeps
three open while it is at rest."""


@dataclass(frozen=True)
class Machine:
    """What a machine has left for a fleet."""

    cores: int
    """Number of cores that this process may use."""
    memory_bytes: int
    """Memory that is free, or can be freed."""
    open_files: int
    """Number of files that a process may open."""

    @classmethod
    def this(cls) -> Machine:
        """Return what this machine has left."""
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        (available_kib,) = (line.split()[1] for line in lines if line.startswith("MemAvailable:"))
        _, files = resource.getrlimit(resource.RLIMIT_NOFILE)
        files = sys.maxsize if files == resource.RLIM_INFINITY else files
        return cls(len(os.sched_getaffinity(0)), int(available_kib) * 1024, files)

    def room(self, *, processes: int | None) -> int:
        """Return the number of the simplest robots that fit; those of a simulator need more.

        Args:
            processes: Number of agent processes that they share; None for one each.
        """
        left = self.memory_bytes
        each, most = ROBOT_BYTES, self.cores * ROBOTS_PER_CORE
        if processes is None:
            each += PROCESS_BYTES
        else:
            left -= processes * PROCESS_BYTES
            most = min(most, processes * ((self.open_files - PROCESS_FILES) // ROBOT_FILES))
        return max(0, min(most, left // each))


def check_room(robots: int, *, processes: int | None, machine: Machine) -> None:
    """Check that a machine has room for a fleet.

    Args:
        robots: Number of robots.
        processes: Number of agent processes that they share; None for one each.
        machine: Machine that is to run the fleet.

    Raises:
        InvalidInputError: It has none; the message says how many robots fit.
    """
    room = machine.room(processes=processes)
    if robots > room:
        raise InvalidInputError(
            f"{robots} robots are too many for this machine: with {machine.cores} cores, "
            f"{machine.memory_bytes / 1e9:.1f} GB of free memory and {machine.open_files} open "
            f"files per process (`ulimit -Hn`) it has room for about {room}. "
            "Serve the others on other machines, with `nufleet agent --robot` and one router for "
            "all"
        )
