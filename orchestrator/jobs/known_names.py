"""The names that commands take and that are known without a fleet, for the shell to complete."""

from __future__ import annotations

from pathlib import Path

from nufleet.orchestrator.runs.folder import list_runs
from nufleet.shared.errors import NufleetError
from nufleet.shared.paths.installed import drawing_names
from nufleet.shared.robots.fleet_file import find_fleet_file, installed_fleets, read_fleet_file

__all__ = ["drawing_names", "installed_fleets", "robot_names", "run_names"]


def run_names(root: Path) -> list[str]:
    """Return `latest` and the names of the runs in the folder of all runs, the newest first."""
    return ["latest", *(folder.name for folder in reversed(list_runs(root)))]


def robot_names(fleet: str) -> list[str]:
    """Return the robots of a fleet file, given by path or name; none if it cannot be read.

    The command that is being typed will say what is wrong with the file.
    """
    try:
        return list(read_fleet_file(find_fleet_file(fleet)).robots)
    except NufleetError:
        return []
