"""The work of `nufleet rank`: connect, check the request, run the study, print the result."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import ExitStack
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import click
from rich.console import Console

from nufleet.orchestrator.conduct.archive import AWAY, Archive
from nufleet.orchestrator.conduct.desired_motion import TimedPath, read_motion
from nufleet.orchestrator.conduct.leases import lease_robots
from nufleet.orchestrator.conduct.preflight import check_band, check_names
from nufleet.orchestrator.conduct.rank_run import (
    Algorithm,
    RankRequest,
    ReadyStudy,
    configuration,
    prepare,
)
from nufleet.orchestrator.conduct.reuse import check_absent, find_stored, oldest_reused
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.reach import REACH, Reach
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.jobs.study import show_study
from nufleet.orchestrator.repository.repository import Repository
from nufleet.orchestrator.runs.console import stderr_console
from nufleet.orchestrator.runs.folder import RunFolder, make_runs_root
from nufleet.orchestrator.runs.rank_result import RunRecord
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.fleet_file import FleetFile, read_fleet_file
from nufleet.shared.wire.transport import DEFAULT_ENDPOINT


@dataclass(frozen=True)
class RankCommand:
    """The options of one `nufleet rank`."""

    runs_root: Path
    """Folder that holds the folders of all runs."""
    fleet_file: Path | None = None
    """Path of the fleet file to start; None for a running fleet."""
    connect: str = DEFAULT_ENDPOINT
    """Endpoint of a running fleet."""
    fleet_name: str | None = None
    """Name of the running fleet; None when only one is running there."""
    target: str | None = None
    """Name of the robot that needs experience; None for the target that the fleet file names."""
    sources: tuple[str, ...] | None = None
    """Names of the sources; None for all robots but the target."""
    band_rad_s: tuple[float, float] | None = None
    """Lower and upper end of the frequency band W (paper, eq. 6); None for the band of the fleet
    file or of the robots."""
    axis: str | None = None
    """Name of the axis to test; None for the target's first."""
    iterations: int = 7
    """Limit on the number of iterations."""
    seed: int = 0
    """Seed of the study."""
    algorithm: Algorithm = "adaptive"
    """Algorithm that selects the tests."""
    realtime: float | None = None
    """Speed of the simulated robots relative to real time; None for as fast as possible."""
    wait_s: float = 0.0
    """Time to wait for a running fleet's router and robots."""
    live: bool = False
    """Whether to serve the recording to live viewers."""
    as_json: bool = False
    """Whether to print the result as JSON on stdout."""
    processes: int | None = 2
    """Number of processes that the robots of a fleet file are spread over; None for one each."""
    trajectory: str | None = None
    """Path or name of the drawing that transfer is to help on; None for no particular one."""
    speed_m_s: float | None = None
    """Largest speed on that drawing; None for the default."""
    repository: str | None = None
    """Address of the repository; None for the one in `runs_root`."""
    reuse_days: float | None = None
    """Largest age of stored responses that replace tests, in days; None to test all sources."""


def rank_and_print(command: RankCommand) -> None:
    """Rank, with progress on stderr and, if wanted, the document on stdout."""
    console = stderr_console()
    record = rank(command, console)
    if command.as_json:
        click.echo(record.result.document())


def rank(command: RankCommand, console: Console) -> RunRecord:
    """Rank the sources of a fleet and return the record of the run, as stored in its folder.

    A request that cannot be carried out is refused before anything moves.

    Raises:
        InvalidInputError: The options contradict each other, or do not fit the fleet.
        FleetFileError: The fleet file is not valid.
        LeaseHeldError: A robot belongs to another orchestrator.
        StudyError: The study cannot continue, because the target or every source is gone.
    """
    if command.band_rad_s is not None:
        check_band(command.band_rad_s)
    drawing = _drawing(command)
    if command.reuse_days is not None and command.algorithm != "adaptive":
        raise InvalidInputError("--reuse is that of --algorithm adaptive, not of paper")
    make_runs_root(command.runs_root)
    storage = Storage(command.runs_root, command.repository)
    with ExitStack() as stack:
        repository = stack.enter_context(storage.open())
        reach = _reach(command)
        sources = command.sources if command.reuse_days is None else None
        wanted = (_target(command), *(sources or ()))
        fleet, name, robots = stack.enter_context(
            reach.connection(console, wanted, wait_s=command.wait_s)
        )
        ready, stored = _ready(command, drawing, fleet, name, robots, repository, console)
        folder = stack.enter_context(RunFolder(command.runs_root, name))
        leases = stack.enter_context(
            lease_robots(
                repository.leases,
                fleet,
                reach.lease_scope(name, folder.study_id),
                (name for name, one in ready.descriptions.items() if one.boot_id != AWAY),
            )
        )
        archive = Archive(repository, name, leases)
        reached = reach.model_copy(update={"fleet_name": name})
        folder.write_configuration(
            {
                **configuration(ready, command.seed),
                "fleet": name,
                "algorithm": command.algorithm,
                **storage.document(),
                REACH: reached.model_dump(mode="json"),
            }
        )
        stack.enter_context(storage.saying_how_to_resume(console, folder.path.name))
        return show_study(
            fleet,
            ready,
            lambda: archive.begin(
                folder.study_id,
                command.algorithm,
                ready.plan,
                command.seed,
                ready.descriptions,
                stored,
            ),
            archive,
            folder=folder,
            live=command.live,
            console=console,
        )


def _ready(
    command: RankCommand,
    drawing: TimedPath | None,
    fleet: Fleet,
    name: str,
    there: tuple[str, ...],
    repository: Repository,
    console: Console,
) -> tuple[ReadyStudy, Mapping[str, tuple[str, ...]]]:
    """Return the checked study, and by source the ids of stored goals that replace its tests."""
    request = _request(command, drawing)
    if command.reuse_days is None:
        return prepare(fleet, request, there), {}
    known = {record.robot: record.spec for record in repository.robots.robots(name)}
    ready = prepare(fleet, request, there, known)
    reuse = find_stored(
        repository,
        name,
        ready.plan,
        {robot: description.spec for robot, description in ready.descriptions.items()},
        newer_than=oldest_reused(command.reuse_days, datetime.now(UTC)),
    )
    check_absent([robot for robot in ready.plan.sources if robot not in there], reuse, name)
    for robot, reason in reuse.unusable.items():
        console.print(f"{robot} flies: {reason}")
    return ready, reuse.known


def _reach(command: RankCommand) -> Reach:
    if command.fleet_file is None:
        return Reach(connect=command.connect, fleet_name=command.fleet_name)
    file = read_fleet_file(command.fleet_file)
    _check_against_file(command, file)
    return Reach(
        connect=command.connect,
        fleet_file=str(command.fleet_file.resolve()),
        realtime=command.realtime,
        processes=command.processes,
    )


def _check_against_file(command: RankCommand, file: FleetFile) -> None:
    """Raise InvalidInputError for names that are not in the file, before any process starts."""
    there = tuple(file.robots)
    target = _target(command)
    sources = command.sources or tuple(robot for robot in there if robot != target)
    check_names(target, sources, there)


def _target(command: RankCommand) -> str:
    if command.target is not None:
        return command.target
    if command.fleet_file is not None:
        study = read_fleet_file(command.fleet_file).study
        if study is not None:
            return study.target
    raise InvalidInputError("which robot needs experience? Name it with --target")


def _drawing(command: RankCommand) -> TimedPath | None:
    if command.trajectory is not None:
        return read_motion(command.trajectory, command.speed_m_s)
    if command.speed_m_s is not None:
        raise InvalidInputError("--speed is that of a trajectory: name one with --trajectory")
    return None


def _request(command: RankCommand, drawing: TimedPath | None) -> RankRequest:
    band = command.band_rad_s
    if band is None and command.fleet_file is not None:
        study = read_fleet_file(command.fleet_file).study
        band = None if study is None else study.band_rad_s
    return RankRequest(
        target=_target(command),
        sources=command.sources,
        band_rad_s=band,
        iterations=command.iterations,
        seed=command.seed,
        axis=command.axis,
        drawing=drawing,
    )
