"""Stops robots, all at once, and finds out which of them did not confirm."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

from orchestrator.fleet import Fleet
from shared.errors import NufleetError


def stop_robots(fleet: Fleet, robots: tuple[str, ...], reason: str) -> dict[str, str]:
    """Send a stop to every robot named; return why each that did not confirm it did not."""

    def stop_one(robot: str) -> str | None:
        try:
            fleet.stop(robot, reason)
        except NufleetError as error:
            return str(error)
        return None

    with ThreadPoolExecutor(max(1, min(32, len(robots)))) as pool:
        answers = dict(zip(robots, pool.map(stop_one, robots), strict=True))
    return {robot: why for robot, why in answers.items() if why is not None}
