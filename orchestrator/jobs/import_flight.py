"""The work of `nufleet import`: read a log, estimate the response, store it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import click
from rich.console import Console

from nufleet.orchestrator.conduct.preflight import check_robots, chosen_axes
from nufleet.orchestrator.jobs.commands import AnyFleetCommand
from nufleet.orchestrator.jobs.terminal import results_console, stderr_console
from nufleet.orchestrator.logs.alignment import align
from nufleet.orchestrator.logs.flown_response import response_of_log
from nufleet.orchestrator.logs.formats import list_channels, read_signals
from nufleet.orchestrator.logs.keeping import flight_record
from nufleet.orchestrator.logs.report import ImportResult, ListResult, SignalReport
from nufleet.orchestrator.logs.signals import LogError
from nufleet.orchestrator.repository.records import Origin, RobotRecord
from nufleet.orchestrator.repository.repository import Repository
from nufleet.orchestrator.runs.folder import make_runs_root
from nufleet.shared.errors import InvalidInputError, NoRouterError
from nufleet.shared.wire.messages import Description

EARLIEST_S = datetime(2000, 1, 1, tzinfo=UTC).timestamp()
"""Time stamps before this, in s since 1970, count from the start of the device, not of an era."""


@dataclass(frozen=True, kw_only=True)
class ImportCommand(AnyFleetCommand):
    """The options of one `nufleet import`."""

    log: Path
    """The log."""
    robot: str
    """Name of the robot that flew."""
    axis: str | None
    """Name of the axis; None for the robot's first."""
    reference: str | None
    """Name of the reference in the log; None for the format's usual one."""
    output: str | None
    """Name of the output in the log; None for the format's usual one."""
    time: str | None
    """Column of times of a table, with its unit."""
    begin_s: float
    """Time from the beginning of the log at which to begin."""
    end_s: float | None
    """Time from the beginning of the log at which to end; None for its end."""


def list_and_print(log: Path, *, as_json: bool) -> None:
    """Print the signals that a log offers."""
    result = ListResult(signals=list_channels(log))
    if as_json:
        click.echo(result.document())
    else:
        for channel in result.signals:
            count = "" if channel.samples is None else f"  {channel.samples} samples"
            click.echo(f"{channel.name}{count}")


def import_and_print(command: ImportCommand) -> None:
    """Import a log, and print a report or, if wanted, the document."""
    console = stderr_console()
    make_runs_root(command.runs_root)
    with command.storage.open() as repository:
        fleet, robot = _robot(command, repository, console)
        result = import_log(command, repository, fleet, robot)
        unit = robot.spec.axis(result.axis).unit
    results = results_console(console, as_json=command.as_json)
    for line in result.lines(unit):
        results.print(line)
    if command.as_json:
        click.echo(result.document())


def import_log(
    command: ImportCommand, repository: Repository, fleet: str, robot: Description
) -> ImportResult:
    """Read a log, estimate the response of an axis and store it.

    Args:
        command: Log, signals and trims.
        repository: Repository to store the response in.
        fleet: Name of the fleet.
        robot: Description of the robot that flew.

    Raises:
        LogError: The log cannot be read, or nothing can be claimed from it; the message says why.
        RepositoryError: The response cannot be stored.
    """
    end_s = math.inf if command.end_s is None else command.end_s
    if end_s <= command.begin_s:
        raise InvalidInputError(
            f"--to {end_s:g} must be later than --from {command.begin_s:g}, both in s from the "
            "beginning of the log"
        )
    wanted = None if command.axis is None else (command.axis,)
    axis, log = chosen_axes(wanted, robot)[0], command.log
    names = [one.name for one in robot.spec.axes]
    if axis not in names:
        raise InvalidInputError(
            f"robot {robot.robot} has no axis {axis}: choose one of {', '.join(names)} with --axis"
        )
    reference, output = read_signals(log, axis, command.reference, command.output, command.time)
    aligned = align(
        reference, output, robot.spec.sample_time_s, begin_s=command.begin_s, end_s=end_s
    )
    found = response_of_log(reference, output, aligned, robot.spec)
    measured_at = _measured_at(aligned.began_s, log)
    record = flight_record(
        found,
        fleet,
        robot,
        axis,
        origin=Origin.LOG,
        came_from=log.name,
        measured_at=measured_at,
    )
    quality = found.response.quality
    if record is None or record.flown is None:
        raise LogError(f"{log}: nothing is claimed of {robot.robot}, axis {axis}: {quality}")
    repository.robots.describe(RobotRecord.of(fleet, robot))
    new = repository.flights.add(record)
    return ImportResult(
        fleet=fleet,
        robot=robot.robot,
        axis=axis,
        response=record.goal_id,
        new=new,
        measured_at=measured_at.isoformat(timespec="seconds"),
        duration_s=record.flown.duration_s,
        band_rad_s=record.flown.band_rad_s,
        frequencies=len(record.response.z),
        speed=record.flown.flight.speed,
        amplitude=record.response.amplitude or 0.0,
        noise_std=record.flown.flight.noise_std,
        delay_std_s=aligned.delay_std_s,
        reference=SignalReport.of(reference.name, aligned.reference),
        output=SignalReport.of(output.name, aligned.output),
        findings=quality.warnings,
    )


def _robot(
    command: ImportCommand, repository: Repository, console: Console
) -> tuple[str, Description]:
    """Return the fleet's name and the robot, as it is stored or else as it describes itself.

    Where no fleet is named, that which runs is asked first, since several may have such a robot.
    """
    choice, stored = command.fleet(), repository.robots.named(command.robot)
    for known in stored:
        if known.fleet == choice.name:
            return _stored(known)
    list_channels(command.log)  # a log that cannot be read needs no router
    try:
        with choice.connection(console) as (fleet, name, there):
            check_robots((command.robot,), there)
            return name, fleet.describe(command.robot)
    except NoRouterError as error:
        if choice.name is not None or not stored:
            raise
        if len(stored) == 1:
            return _stored(stored[0])
        fleets = ", ".join(known.fleet for known in stored)
        raise InvalidInputError(
            f"the repository has a robot {command.robot} in each of the fleets {fleets}, and none "
            "of them runs: name one with --fleet-name"
        ) from error


def _stored(known: RobotRecord) -> tuple[str, Description]:
    found = Description(robot=known.robot, boot_id=known.boot_id, spec=known.spec)
    return known.fleet, found


def _measured_at(began_s: float, log: Path) -> datetime:
    now = datetime.now(UTC)
    if EARLIEST_S <= began_s <= now.timestamp():
        return datetime.fromtimestamp(began_s, UTC)
    return min(now, datetime.fromtimestamp(log.stat().st_mtime, UTC))
