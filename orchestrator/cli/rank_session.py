"""What `nufleet rank` does: reach a fleet, check the request, run the study, print the result."""

from __future__ import annotations

import time
from contextlib import AbstractContextManager, ExitStack
from dataclasses import dataclass
from pathlib import Path

import click
from rich.console import Console

from orchestrator.connection import Connection, running_fleet, started_fleet
from orchestrator.console import ConsoleObserver, ranking_table, stderr_console
from orchestrator.desired_motion import Drawing, read_motion
from orchestrator.live_view import LiveView
from orchestrator.preflight import check_band, check_names
from orchestrator.rank_run import Algorithm, RankRequest, prepare, run_study
from orchestrator.results import RunRecord
from orchestrator.run_folder import RunFolder, make_runs_root
from orchestrator.study_clock import StudyClock
from orchestrator.verdict_table import print_verdicts
from orchestrator.viewer.ports import GRPC_PORT, WEB_PORT
from orchestrator.viewer.writer import RerunWriter, ServeOptions
from shared.command_line import invocation
from shared.errors import InvalidInputError
from shared.fleet_file import FleetFile, read_fleet_file
from shared.transport import DEFAULT_ENDPOINT


@dataclass(frozen=True)
class RankCommand:
    """The command line of one ranking."""

    runs_root: Path
    fleet_file: Path | None = None
    connect: str = DEFAULT_ENDPOINT
    fleet_name: str | None = None
    target: str | None = None
    sources: tuple[str, ...] | None = None
    band_rad_s: tuple[float, float] | None = None
    axis: str | None = None
    iterations: int = 7
    seed: int = 0
    algorithm: Algorithm = "paper"
    realtime: float | None = None
    wait_s: float = 0.0
    live: bool = False
    as_json: bool = False
    processes: int | None = 2
    trajectory: str | None = None
    speed_m_s: float | None = None


def rank_and_print(command: RankCommand) -> None:
    """Rank, with progress on stderr and, when asked for, the document on stdout."""
    console = stderr_console()
    record = rank(command, console)
    if command.as_json:
        click.echo(record.result.document())


def rank(command: RankCommand, console: Console) -> RunRecord:
    """Rank a fleet and return the stored record; raises before anything moves when it cannot."""
    if command.band_rad_s is not None:
        check_band(command.band_rad_s)
    drawing = _drawing(command)
    make_runs_root(command.runs_root)
    with ExitStack() as stack:
        fleet, name, robots = stack.enter_context(_connection(command, console))
        ready = prepare(fleet, _request(command, drawing), robots)
        folder = stack.enter_context(RunFolder(command.runs_root, name))
        serve = ServeOptions(grpc_port=GRPC_PORT, web_port=WEB_PORT) if command.live else None
        writer = stack.enter_context(
            RerunWriter(folder.path.name, recording=folder.recording, serve=serve)
        )
        if command.live:
            console.print(f"live: `nufleet view --live`, or {writer.web_url} in a browser")
        unit = ready.descriptions[ready.plan.target].spec.axis(ready.plan.axis).unit
        live = LiveView(ready.plan, unit, StudyClock(time.monotonic), writer.emit)
        live.watch(fleet)
        stack.callback(live.stop_watching)
        record = run_study(
            fleet,
            ready,
            seed=command.seed,
            algorithm=command.algorithm,
            folder=folder,
            observers=[ConsoleObserver(console, command.iterations), live],
        )
    console.print(ranking_table(record.result.ranking, record.closed_form))
    print_verdicts(console, record.result)
    console.print(
        f"selected: [bold green]{record.result.selected}[/]  "
        f"({record.result.robot_time_s:.0f} robot-seconds, {record.wall_time_s:.1f} s)"
    )
    if writer.dropped:
        console.print(f"[yellow]the recording and its viewers missed {writer.dropped} events[/]")
    console.print(f"open the recording with:  {invocation()} view {folder.path}")
    return record


def _connection(command: RankCommand, console: Console) -> AbstractContextManager[Connection]:
    if command.fleet_file is None:
        return running_fleet(
            command.connect,
            command.fleet_name,
            robots=(_target(command), *(command.sources or ())),
            wait_s=command.wait_s,
        )
    file = read_fleet_file(command.fleet_file)
    _check_against_file(command, file)
    console.print(f"starting a router and {len(file.robots)} robots of {command.fleet_file}")
    return started_fleet(command.fleet_file, processes=command.processes, realtime=command.realtime)


def _check_against_file(command: RankCommand, file: FleetFile) -> None:
    """Find what cannot be right before any process is started."""
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


def _drawing(command: RankCommand) -> Drawing | None:
    if command.trajectory is not None:
        return read_motion(command.trajectory, command.speed_m_s)
    if command.speed_m_s is not None:
        raise InvalidInputError("--speed is that of a trajectory: name one with --trajectory")
    return None


def _request(command: RankCommand, drawing: Drawing | None) -> RankRequest:
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
