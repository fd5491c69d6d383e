"""The options that several commands share, as fields of what their jobs are asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nufleet.orchestrator.fleet.reach import FleetChoice
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.shared.wire.transport import DEFAULT_ENDPOINT


@dataclass(frozen=True, kw_only=True)
class StoredCommand:
    """The options of a command that stores what it does."""

    runs_root: Path
    """Folder that holds the folders of all runs."""
    repository: str | None = None
    """Address of the repository; None for the one in `runs_root`."""
    as_json: bool = False
    """Whether to print the result as JSON on stdout."""

    @property
    def storage(self) -> Storage:
        """Places where the command stores its run."""
        return Storage(self.runs_root, self.repository)


@dataclass(frozen=True, kw_only=True)
class MovingCommand(StoredCommand):
    """The options of a command that moves robots."""

    plans: bool = False
    """Whether to print what the robots would do, and move none."""
    picture: Path | None = None
    """File for a picture of what they would do; None for no picture."""
    yes: bool | None = None
    """Whether the robots may move without asking the person at the terminal: False to ask even if
    they are simulated, None to ask if one of them is real."""


@dataclass(frozen=True, kw_only=True)
class FleetCommand(StoredCommand):
    """The options of a command for a running fleet."""

    connect: str = DEFAULT_ENDPOINT
    """Endpoint of the fleet."""
    fleet_name: str | None = None
    """Name of the fleet; None when only one is running there."""

    def fleet(self) -> FleetChoice:
        """Return the chosen fleet."""
        return FleetChoice.running(self.connect, self.fleet_name)


@dataclass(frozen=True, kw_only=True)
class AnyFleetCommand(FleetCommand):
    """The options of a command for a running fleet, or for that of a file."""

    fleet_file: Path | None = None
    """Path of the fleet file to start; None for a running fleet."""

    def fleet(self) -> FleetChoice:
        """Return the chosen fleet, with the content of its file; raises FleetFileError."""
        return FleetChoice.given(self.fleet_file, self.connect, self.fleet_name)
