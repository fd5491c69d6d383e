"""Which fleet a command reaches and how, kept with its run so that it can be reached again."""

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
"""Its key in a run's configuration."""


class Reach(Strict):
    """A running fleet at a router's endpoint, or that of a file, started for one run alone.

    It is stored without what may be secret in the endpoint, and then needs it again to be reached.
    `processes` says to how many processes the robots of a file are dealt, None gives each its own;
    `realtime` at which multiple of real time they play, None as fast as they can.
    """

    connect: str
    fleet_name: Name | None = None
    fleet_file: str | None = None
    realtime: Positive | None = None
    processes: Annotated[int, Field(ge=1)] | None = 2

    @field_serializer("connect")
    def _without_secrets(self, connect: str) -> str:
        return without_secrets(connect)

    @property
    def file(self) -> FleetFile | None:
        """The fleet file, read; None for a running fleet."""
        return None if self.fleet_file is None else read_fleet_file(Path(self.fleet_file))

    def connection(
        self, console: Console, robots: tuple[str, ...] = (), *, wait_s: float = 0.0
    ) -> AbstractContextManager[Connection]:
        """Start the fleet, or join it and wait so long for these robots; enter what is returned."""
        file = self.file
        if self.fleet_file is None or file is None:
            if self.connect.endswith(f"#{HIDDEN}"):
                raise InvalidInputError(
                    f"the run reached its fleet at {self.connect}, and what may be secret there "
                    "was not stored; name the whole endpoint with --connect"
                )
            return running_fleet(self.connect, self.fleet_name, robots=robots, wait_s=wait_s)
        console.print(f"starting a router and {len(file.robots)} robots of {self.fleet_file}")
        return started_fleet(
            Path(self.fleet_file), processes=self.processes, realtime=self.realtime
        )

    def lease_scope(self, fleet: str, run_id: str) -> str:
        """Return the name of the fleet whose robots are leased.

        A fleet that was started for a run is another one than all others of that name.
        """
        return fleet if self.fleet_file is None else f"{fleet}/{run_id}"
