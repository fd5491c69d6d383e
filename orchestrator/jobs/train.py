"""The work of `nufleet train`: connect, have robots learn, print the experiences they offer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass

import click
from rich.console import Console

from nufleet.orchestrator.conduct.preflight import check_robots
from nufleet.orchestrator.evaluation.flight_documents import TRAINING, TrainResult
from nufleet.orchestrator.experience.learning import check_lessons, planned_lessons
from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.experience.train import Trained, train_robots
from nufleet.orchestrator.experience.training import check_torch
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.orchestrator.flights.planned import Outlook
from nufleet.orchestrator.history.tables import experiences_table
from nufleet.orchestrator.jobs.commands import FleetCommand, MovingCommand
from nufleet.orchestrator.jobs.consent import carried_out
from nufleet.orchestrator.jobs.opening import Opening
from nufleet.orchestrator.jobs.terminal import bars_shown
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.wire.messages import Description


@dataclass(frozen=True, kw_only=True)
class TrainCommand(MovingCommand, FleetCommand):
    """The options of one `nufleet train`."""

    robots: tuple[str, ...]
    """Names of the robots that learn; empty for all."""
    architectures: tuple[Architecture, ...]
    """Architectures of the experiences to learn."""
    duration_s: float
    """Duration of each flight that a robot learns from."""
    seed: int
    """Seed of the flights and of the networks' first weights."""


def train_and_print(command: TrainCommand) -> None:
    """Train, with progress on stderr and, if wanted, the document on stdout."""
    result = carried_out(command, train)
    if result is not None and command.as_json:
        click.echo(result.document())


def train(command: TrainCommand, console: Console) -> TrainResult:
    """Have robots learn experiences, which they then offer and the repository keeps.

    Raises:
        InvalidInputError: Torch is not installed, or a robot is not there, or is real and may not
            move.
        OnlyPlannedError: The command only plans.
        LeaseHeldError: A robot belongs to another orchestrator.
        StudyError: A robot does not respond to steps, or no horizon can be flown on it.
        RobotError: A flight failed.
        RepositoryError: An experience could not be stored; its robot offers it all the same.
    """
    check_torch()
    with Opening(command, console) as run:
        fleet, name, there = run.reach(command.fleet())
        robots = command.robots or there
        check_robots(robots, there)
        fleet.check_may_command()
        descriptions = fleet.describe_all(robots)
        for description in descriptions.values():
            check_lessons(description, command.architectures)
        folder = run.keep("train")
        run.take(descriptions, lambda: _outlook(command, descriptions))
        run.configure({"kind": "train", **asdict(command)})
        pilot = Pilot(fleet, folder.study_id)
        run.guard(pilot.interrupt)
        library = ExperienceLibrary(fleet, run.repository.robots, name)
        keep = library.keeping(descriptions.values(), folder.path.name)

        def on_trained(trained: Trained) -> None:
            keep(trained)
            console.print(f"  [green]{trained.lesson.robot} offers it now[/]")

        with bars_shown(console, "steps at most") as shown:
            trained = train_robots(
                fleet,
                pilot,
                tuple(descriptions.values()),
                command.architectures,
                folder.path / "experiences",
                seed=command.seed,
                duration_s=command.duration_s,
                say=lambda robot, what: console.print(f"  {robot} {what}"),
                on_step=lambda robot, done, most: shown(f"training {robot}", done, most),
                on_trained=on_trained,
            )
        pilot.acknowledge_all()
        result = TrainResult.of(trained, str(folder.path))
        folder.write_document(TRAINING, result)
    run.results.print(experiences_table(result))
    console.print(f"files: {folder.path / 'experiences'}")
    return result


def _outlook(command: TrainCommand, descriptions: Mapping[str, Description]) -> Outlook:
    """Return what the robots are going to fly."""
    return Outlook(
        headline=f"{len(descriptions)} robots fly to learn, all at the same time",
        motions=tuple(
            motion
            for description in descriptions.values()
            for motion in planned_lessons(
                description,
                command.architectures,
                seed=command.seed,
                duration_s=command.duration_s,
            )
        ),
    )
