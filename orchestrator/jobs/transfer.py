"""The work of `nufleet transfer`: find the source, transfer its experience, print the result."""

from __future__ import annotations

import json
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import click
from rich.console import Console

from nufleet.orchestrator.conduct.leases import lease_robots
from nufleet.orchestrator.conduct.preflight import check_names, check_robots
from nufleet.orchestrator.experience.transfer import Transferred, read_experience, transfer_file
from nufleet.orchestrator.experience.transfer import transfer as transfer_experience
from nufleet.orchestrator.fleet.connection import running_fleet
from nufleet.orchestrator.history.catalogue import latest_ranking
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.jobs.terminal import stderr_console
from nufleet.orchestrator.runs.folder import make_runs_root
from nufleet.orchestrator.study.verdict import Verdict
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.layout import Architecture


@dataclass(frozen=True)
class TransferCommand:
    """The options of one `nufleet transfer`, with either a source or a file."""

    connect: str
    """Endpoint of the fleet."""
    fleet_name: str | None
    """Name of the fleet; None when only one is running there."""
    target: str
    """Name of the robot that receives the experience."""
    source: str | None
    """Name of the source, `best` for the best of the latest ranking, or `none` to remove the prior
    of the target; None when a file is given."""
    file: Path | None
    """File of an experience; None to take one from a source."""
    architecture: Architecture | None
    """Architecture of the experience to take; None for the only one on offer."""
    runs_root: Path
    """Folder that holds the folders of all runs."""
    repository: str | None
    """Address of the repository; None for the one in `runs_root`."""
    as_json: bool
    """Whether to print the result as JSON on stdout."""


def transfer_and_print(command: TransferCommand) -> None:
    """Transfer an experience, and print which one the target flies with from now on."""
    console = stderr_console()
    payload = None if command.file is None else read_experience(command.file)
    make_runs_root(command.runs_root)
    with (
        Storage(command.runs_root, command.repository).open() as repository,
        running_fleet(command.connect, command.fleet_name) as (fleet, name, there),
        ExitStack() as stack,
    ):
        check_robots((command.target,), there)
        stack.enter_context(lease_robots(repository.leases, fleet, name, (command.target,)))
        if command.source == "none":
            fleet.remove_prior(command.target)
            console.print(f"{command.target} flies without a prior from now on")
            document: dict[str, object] = {"schema": 1, "target": command.target, "source": None}
        else:
            if payload is not None:
                given = transfer_file(fleet, payload, command.target)
            else:
                source = _source(command, name, console)
                check_names(command.target, (source,), there)
                given = transfer_experience(fleet, source, command.target, command.architecture)
            _print(console, given)
            document = _document(given)
    if command.as_json:
        click.echo(json.dumps(document))


def _source(command: TransferCommand, fleet: str, console: Console) -> str:
    if command.source is not None and command.source != "best":
        return command.source
    found = latest_ranking(command.runs_root, fleet, command.target)
    if found is None:
        raise InvalidInputError(
            f"no ranking of {command.target} of fleet {fleet} in {command.runs_root}: rank its "
            f"sources first with `nufleet rank --target {command.target}`, or name a source"
        )
    folder, record = found
    leader = record.result.ranking[0]
    console.print(
        f"best source of {command.target}: [bold]{leader.robot}[/], "
        f"ψ* = {leader.psi:.4f} ± {leader.psi_std:.4f}, from {folder.name}"
    )
    verdict = record.result.verdicts.get(leader.robot)
    if verdict is not None and verdict.verdict is not Verdict.TRANSFER:
        console.print(f"[yellow]the tests say: {verdict.verdict}: {verdict.reason}[/]")
    return record.result.selected


def _print(console: Console, given: Transferred) -> None:
    layout = given.manifest.layout
    console.print(
        f"[green]{given.target} flies with the experience of {given.source} from now on[/]: "
        f"{layout.architecture}, horizon {layout.horizon_s:.2f} s, sha256 {given.sha256[:12]}…"
    )


def _document(given: Transferred) -> dict[str, object]:
    return {
        "schema": 1,
        "target": given.target,
        "source": given.source,
        "sha256": given.sha256,
        "manifest": given.manifest.model_dump(mode="json"),
    }
