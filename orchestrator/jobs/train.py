"""The work of `nufleet train`: connect, have robots learn, print the experiences they offer."""

from __future__ import annotations

from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from nufleet.orchestrator.conduct.leases import lease_robots
from nufleet.orchestrator.conduct.preflight import check_robots
from nufleet.orchestrator.evaluation.flight_documents import TRAINING, TrainResult
from nufleet.orchestrator.experience.train import check_torch, train_robots
from nufleet.orchestrator.fleet.connection import running_fleet
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.orchestrator.history.tables import experiences_table
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.jobs.terminal import stderr_console
from nufleet.orchestrator.runs.folder import RunFolder, make_runs_root
from nufleet.shared.experience.layout import Architecture


@dataclass(frozen=True)
class TrainCommand:
    """The options of one `nufleet train`."""

    connect: str
    """Endpoint of the fleet."""
    fleet_name: str | None
    """Name of the fleet; None when only one is running there."""
    robots: tuple[str, ...]
    """Names of the robots that learn; empty for all."""
    architectures: tuple[Architecture, ...]
    """Architectures of the experiences to learn."""
    duration_s: float
    """Duration of each flight that a robot learns from."""
    seed: int
    """Seed of the flights and of the networks' first weights."""
    runs_root: Path
    """Folder that holds the folders of all runs."""
    repository: str | None
    """Address of the repository; None for the one in `runs_root`."""
    as_json: bool
    """Whether to print the result as JSON on stdout."""


def train_and_print(command: TrainCommand) -> None:
    """Train, with progress on stderr and, if wanted, the document on stdout."""
    check_torch()
    make_runs_root(command.runs_root)
    console = stderr_console()
    storage = Storage(command.runs_root, command.repository)
    with (
        storage.open() as repository,
        running_fleet(command.connect, command.fleet_name) as (fleet, name, there),
        RunFolder(command.runs_root, f"{name}-train") as folder,
        ExitStack() as stack,
    ):
        robots = command.robots or there
        check_robots(robots, there)
        leases = stack.enter_context(lease_robots(repository.leases, fleet, name, robots))
        descriptions = [fleet.describe(robot) for robot in robots]
        configuration = asdict(command) | storage.document()
        folder.write_configuration({"kind": "train", "fleet": name, **configuration})
        pilot = Pilot(fleet, folder.study_id)
        stack.enter_context(leases.guarding(pilot.interrupt))
        trained = train_robots(
            fleet,
            pilot,
            descriptions,
            command.architectures,
            folder.path / "experiences",
            seed=command.seed,
            duration_s=command.duration_s,
            say=lambda robot, what: console.print(f"  {robot} {what}"),
            on_trained=lambda done: console.print(f"  [green]{done.lesson.robot} offers it now[/]"),
        )
        pilot.acknowledge_all()
        result = TrainResult.of(trained, str(folder.path))
        folder.write_document(TRAINING, result)
    if command.as_json:
        click.echo(result.document())
    console.print(experiences_table(result))
    console.print(f"files: {folder.path / 'experiences'}")
