"""How a command reaches its fleet, stored with its run so that a resumed run can reach it again."""

from __future__ import annotations

from contextlib import AbstractContextManager
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

    @field_serializer("connect")
    def _without_secrets(self, connect: str) -> str:
        return without_secrets(connect)

    @property
    def file(self) -> FleetFile | None:
        """The content of the fleet file; None for a running fleet."""
        return None if self.fleet_file is None else read_fleet_file(Path(self.fleet_file))

    def connection(
        self, console: Console, robots: tuple[str, ...] = (), *, wait_s: float = 0.0
    ) -> AbstractContextManager[Connection]:
        """Return a context manager that starts the fleet, or joins the running one.

        Args:
            console: Console for progress messages.
            robots: Names of the robots that have to be alive in a running fleet.
            wait_s: Longest time to wait for them, in s.
        """
        file = self.file
        if self.fleet_file is None or file is None:
            if self.connect.endswith(f"#{HIDDEN}"):
                raise InvalidInputError(
                    f"the run reached its fleet at {self.connect}, and the secret part of this "
                    "endpoint was not stored; give the whole endpoint with --connect"
                )
            return running_fleet(self.connect, self.fleet_name, robots=robots, wait_s=wait_s)
        console.print(f"starting a router and {len(file.robots)} robots of {self.fleet_file}")
        return started_fleet(
            Path(self.fleet_file), processes=self.processes, realtime=self.realtime
        )

    def lease_scope(self, fleet: str, run_id: str) -> str:
        """Return the name under which the robots are leased.

        A fleet that was started for a run is distinct from all others of the same name, so its
        scope also depends on the run.

        Args:
            fleet: Name of the fleet.
            run_id: Id of the run.
        """
        return fleet if self.fleet_file is None else f"{fleet}/{run_id}"
