"""The work of `nufleet train`: connect, have robots learn, print the experiences they offer."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from pathlib import Path

import click
from rich.console import Console

from nufleet.orchestrator.conduct.preflight import check_robots
from nufleet.orchestrator.evaluation.flight_documents import TRAINING, TrainResult
from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.experience.train import Trained, check_torch, train_robots
from nufleet.orchestrator.fleet.reach import FleetChoice
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.orchestrator.history.tables import experiences_table
from nufleet.orchestrator.jobs.opening import Opening
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.jobs.terminal import stderr_console
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

    def fleet(self) -> FleetChoice:
        """Return the fleet whose robots learn."""
        return FleetChoice.running(self.connect, self.fleet_name)


def train_and_print(command: TrainCommand) -> None:
    """Train, with progress on stderr and, if wanted, the document on stdout."""
    result = train(command, stderr_console())
    if command.as_json:
        click.echo(result.document())


def train(command: TrainCommand, console: Console) -> TrainResult:
    """Have robots learn experiences, which they then offer and the repository keeps.

    Raises:
        InvalidInputError: Torch is not installed, or a robot is not there.
        LeaseHeldError: A robot belongs to another orchestrator.
        StudyError: A robot does not respond to steps, or no horizon can be flown on it.
        RobotError: A flight failed.
        RepositoryError: An experience could not be stored; its robot offers it all the same.
    """
    check_torch()
    with Opening(Storage(command.runs_root, command.repository), console) as run:
        fleet, name, there = run.reach(command.fleet())
        robots = command.robots or there
        check_robots(robots, there)
        descriptions = fleet.describe_all(robots)
        folder = run.keep("train")
        run.take(descriptions)
        run.configure({"kind": "train", **asdict(command)})
        pilot = Pilot(fleet, folder.study_id)
        run.guard(pilot.interrupt)
        library = ExperienceLibrary(fleet, run.repository.robots, name)
        keep = library.keeping(descriptions.values(), folder.path.name)

        def on_trained(trained: Trained) -> None:
            keep(trained)
            console.print(f"  [green]{trained.lesson.robot} offers it now[/]")

        trained = train_robots(
            fleet,
            pilot,
            tuple(descriptions.values()),
            command.architectures,
            folder.path / "experiences",
            seed=command.seed,
            duration_s=command.duration_s,
            say=lambda robot, what: console.print(f"  {robot} {what}"),
            on_trained=on_trained,
        )
        pilot.acknowledge_all()
        result = TrainResult.of(trained, str(folder.path))
        folder.write_document(TRAINING, result)
    console.print(experiences_table(result))
    console.print(f"files: {folder.path / 'experiences'}")
    return result
