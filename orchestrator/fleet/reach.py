"""The fleet that a command is for, and how a run stores it to reach it again when it is resumed."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from pydantic import Field, field_serializer
from rich.console import Console

from nufleet.orchestrator.fleet.connection import Connection, running_fleet, started_fleet
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.redaction import HIDDEN, without_secrets
from nufleet.shared.robots.fleet_file import FleetFile, read_fleet_file
from nufleet.shared.strict import Name, Positive, Strict

REACH = "reach"
"""Key of the stored `Reach` in a run's configuration."""


class Reach(Strict):
    """A running fleet at a router, or the fleet of a file, started for one run alone.

    Secrets in the endpoint are not stored, so they have to be supplied again to reach the fleet.
    """

    connect: str
    """Endpoint of the router of a running fleet."""
    fleet_name: Name | None = None
    """Name of the running fleet; None takes the only one at the router."""
    fleet_file: str | None = None
    """Path of the fleet file; None for a running fleet."""
    realtime: Positive | None = None
    """Multiple of real time at which robots of the file play; None plays as fast as possible."""
    processes: Annotated[int, Field(ge=1)] | None = 2
    """Number of processes that share the robots of the file; None gives each its own."""
    state_folder: str | None = None
    """Folder in which the robots of the file keep what they learn, until a resumed run starts them
    again; None if they begin with nothing whenever they are started."""

    @field_serializer("connect")
    def _without_secrets(self, connect: str) -> str:
        return without_secrets(connect)

    def lease_scope(self, fleet: str, run_id: str) -> str:
        """Return the name under which the robots are leased.

        A fleet that was started for a run is distinct from all others of the same name, so its
        scope also depends on the run.

        Args:
            fleet: Name of the fleet.
            run_id: Id of the run.
        """
        return fleet if self.fleet_file is None else f"{fleet}/{run_id}"


@dataclass(frozen=True)
class FleetChoice:
    """The fleet that a command is for: a running one, or that of a file, which is read once."""

    reach: Reach
    """How to reach the fleet, as it is stored with a run."""
    file: FleetFile | None = None
    """Content of the fleet file; None for a running fleet."""

    @classmethod
    def running(cls, endpoint: str, name: str | None) -> FleetChoice:
        """Choose the fleet of that name at a router; None takes the only one that runs there."""
        return cls(Reach(connect=endpoint, fleet_name=name))

    @classmethod
    def started(
        cls, path: Path, *, realtime: float | None = None, processes: int | None = 2
    ) -> FleetChoice:
        """Choose the fleet of a file, to be started for this command alone.

        Args:
            path: Path of the fleet file.
            realtime: Multiple of real time at which simulated robots play; None plays as fast as
                possible.
            processes: Number of processes that share the robots; None gives each its own.

        Raises:
            FleetFileError: The file cannot be read, or is wrong.
        """
        file = str(path.resolve())
        return cls.again(Reach(connect="", fleet_file=file, realtime=realtime, processes=processes))

    @classmethod
    def given(cls, path: Path | None, endpoint: str, name: str | None) -> FleetChoice:
        """Choose the fleet of a file, or the running one if there is no file; see both."""
        return cls.running(endpoint, name) if path is None else cls.started(path)

    @classmethod
    def again(cls, reach: Reach) -> FleetChoice:
        """Choose the fleet that an earlier run reached.

        Args:
            reach: Stored way in which that run reached it.

        Raises:
            FleetFileError: See `started`.
            InvalidInputError: The file now describes another fleet.
        """
        if reach.fleet_file is None:
            return cls(reach)
        file = read_fleet_file(Path(reach.fleet_file))
        if reach.fleet_name not in (None, file.name):
            raise InvalidInputError(
                f"the run is of fleet {reach.fleet_name}, and {reach.fleet_file} is the file of "
                f"fleet {file.name} now; restore its name to resume the run"
            )
        return cls(reach, file)

    def remembering(self, state_folder: Path) -> FleetChoice:
        """Return the same fleet, with robots that keep in a folder what they learn.

        A running fleet keeps it anyway.
        """
        if self.file is None:
            return self
        kept = self.reach.model_copy(update={"state_folder": str(state_folder.resolve())})
        return FleetChoice(kept, self.file)

    @property
    def name(self) -> str | None:
        """Name of the fleet; None for the only one that runs at the router."""
        return self.reach.fleet_name if self.file is None else self.file.name

    def target(
        self, named: str | None, asked: str = "which robot needs experience? Name it with --target"
    ) -> str:
        """Return the target: the robot that was named, or the one that the fleet file names.

        Args:
            named: Name that was given; None without one.
            asked: What a person is asked if neither of them names one.

        Raises:
            InvalidInputError: Neither of them names one.
        """
        if named is not None:
            return named
        if self.file is None or self.file.study is None:
            where = "`nufleet fleet status` lists the robots"
            if self.file is not None:
                where = f"there are {', '.join(self.file.robots)}"
            raise InvalidInputError(f"{asked}; {where}")
        return self.file.study.target

    def band_rad_s(self, given: tuple[float, float] | None) -> tuple[float, float] | None:
        """Return the frequency band that was given, or that of the fleet file; None without one."""
        if given is not None or self.file is None or self.file.study is None:
            return given
        return self.file.study.band_rad_s

    def connection(
        self,
        console: Console,
        robots: tuple[str, ...] = (),
        *,
        wait_s: float = 0.0,
        appeared: Callable[[int, int], None] = lambda there, of: None,
    ) -> AbstractContextManager[Connection]:
        """Return a context manager that starts the fleet, or joins the running one.

        Args:
            console: Console for progress messages.
            robots: Names of the robots that have to be alive in a running fleet.
            wait_s: Longest time to wait for them, in s.
            appeared: Callback that receives how many robots of a fleet that is started are there,
                and of how many.

        Raises:
            InvalidInputError: The endpoint was stored without its secrets.
        """
        reach = self.reach
        if reach.fleet_file is None or self.file is None:
            if reach.connect.endswith(f"#{HIDDEN}"):
                raise InvalidInputError(
                    f"the run reached its fleet at {reach.connect}, and the secret part of this "
                    "endpoint was not stored; give the whole endpoint with --connect"
                )
            return running_fleet(reach.connect, reach.fleet_name, robots=robots, wait_s=wait_s)
        console.print(f"starting a router and {len(self.file.robots)} robots of {reach.fleet_file}")
        return started_fleet(
            self.file,
            Path(reach.fleet_file),
            processes=reach.processes,
            realtime=reach.realtime,
            state_folder=None if reach.state_folder is None else Path(reach.state_folder),
            appeared=appeared,
        )
