"""How many robots a machine has room for, told before any of them starts."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from nufleet.shared.errors import InvalidInputError

ROBOTS_PER_CORE = 500
"""Robots per core of the largest fleet that was ranked without losing one, see `docs/scale.md`."""

PROCESS_BYTES = 75 * 2**20
"""Memory of an agent process without its robots."""

ROBOT_BYTES = 5 * 2**18
"""Memory of a robot in such a process, and of its session in the router."""


@dataclass(frozen=True)
class Machine:
    """What a machine has left for a fleet."""

    cores: int
    """Number of cores that this process may use."""
    memory_bytes: int
    """Memory that is free, or can be freed."""

    @classmethod
    def this(cls) -> Machine:
        """Return what this machine has left."""
        lines = Path("/proc/meminfo").read_text(encoding="ascii").splitlines()
        (available_kib,) = (line.split()[1] for line in lines if line.startswith("MemAvailable:"))
        return cls(len(os.sched_getaffinity(0)), int(available_kib) * 1024)

    def room(self, *, processes: int | None) -> int:
        """Return the number of the simplest robots that fit; those of a simulator need more.

        Args:
            processes: Number of agent processes that they share; None for one each.
        """
        left = self.memory_bytes
        each = ROBOT_BYTES
        if processes is None:
            each += PROCESS_BYTES
        else:
            left -= processes * PROCESS_BYTES
        return max(0, min(self.cores * ROBOTS_PER_CORE, left // each))


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
            f"{robots} robots are too many for this machine: with {machine.cores} cores and "
            f"{machine.memory_bytes / 1e9:.1f} GB of free memory it has room for about {room}. "
            "Serve the others on other machines, with `nufleet agent --robot` and one router for "
            "all"
        )
