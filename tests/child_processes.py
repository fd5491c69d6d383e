"""Processes that a test has started, itself or through others."""

from __future__ import annotations

import time
from contextlib import suppress

import psutil


def children_of(pid: int | None = None, *, named: str = "") -> list[psutil.Process]:
    """Return the descendants of a process, by default this one; of those, the named ones."""
    with suppress(psutil.NoSuchProcess):
        found = psutil.Process(pid).children(recursive=True)
        return [child for child in found if not named or named in _names(child)]
    return []


def rehearsals() -> list[psutil.Process]:
    """Return the processes in which robots of this process rehearse flights."""
    return children_of(named="nufleet.robot_agent.flight.rehearsing")


def _names(process: psutil.Process) -> list[str]:
    """Return the names of a process's program and of its arguments.

    A process that has just begun has no arguments yet when its parent already continues.
    """
    with suppress(psutil.NoSuchProcess):  # it has just ended
        while not (arguments := process.cmdline()):
            if process.status() == psutil.STATUS_ZOMBIE:
                break
            time.sleep(0.001)
        return [process.name(), *arguments]
    return []
