"""What `nufleet train` does: reach robots, have them learn, print what they offer now."""

from __future__ import annotations

import json
import math
from contextlib import ExitStack
from dataclasses import asdict, dataclass
from pathlib import Path

import click
from rich.table import Table

from orchestrator.cli.storage import Storage
from orchestrator.connection import running_fleet
from orchestrator.console import stderr_console
from orchestrator.pilot import Pilot
from orchestrator.preflight import check_robots
from orchestrator.robot_leases import lease_robots
from orchestrator.run_folder import RunFolder, make_runs_root
from orchestrator.train_run import Trained, check_torch, train_robots
from shared.inverse_layout import Architecture


@dataclass(frozen=True)
class TrainCommand:
    """The command line of one training."""

    connect: str
    fleet_name: str | None
    robots: tuple[str, ...]
    architectures: tuple[Architecture, ...]
    duration_s: float
    seed: int
    runs_root: Path
    repository: str | None
    as_json: bool


def train_and_print(command: TrainCommand) -> None:
    """Train, with progress on stderr and, when asked for, the document on stdout."""
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
        folder.write_configuration({"kind": "train", **configuration})
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
    if command.as_json:
        document = {
            "schema": 1,
            "experiences": [_document(one) for one in trained],
            "run": str(folder.path),
        }
        click.echo(json.dumps(document))
    console.print(_table(trained))
    console.print(f"files: {folder.path / 'experiences'}")


def _document(trained: Trained) -> dict[str, object]:
    return {
        "robot": trained.lesson.robot,
        "sha256": trained.sha256,
        "training_time_s": trained.training_time_s,
        "horizon_trials": [
            {
                "horizon_samples": trial.horizon_samples,
                "rms_error": trial.rms_error if math.isfinite(trial.rms_error) else None,
            }
            for trial in trained.lesson.choice.trials
        ],
        "manifest": trained.experience.manifest.model_dump(mode="json"),
    }


def _table(trained: tuple[Trained, ...]) -> Table:
    table = Table(title="experiences on offer", title_justify="left")
    for heading in ("robot", "architecture"):
        table.add_column(heading)
    for heading in ("horizon, s", "relative degree", "error held back", "s"):
        table.add_column(heading, justify="right")
    for one in trained:
        manifest = one.experience.manifest
        table.add_row(
            one.lesson.robot,
            manifest.layout.architecture,
            f"{manifest.layout.horizon_s:.2f}",
            str(manifest.relative_degree),
            f"{100 * manifest.validation_rms / manifest.output_scale:.1f} %",
            f"{one.training_time_s:.1f}",
        )
    return table
