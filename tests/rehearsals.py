"""The processes in which robots of this process rehearse flights."""

from __future__ import annotations

from contextlib import suppress

import psutil


def rehearsals() -> list[psutil.Process]:
    """Return those that run."""
    return [child for child in psutil.Process().children(recursive=True) if _rehearses(child)]


def _rehearses(process: psutil.Process) -> bool:
    with suppress(psutil.NoSuchProcess):  # it has just ended
        return any("rehearsing" in part for part in process.cmdline())
    return False
