"""The work of `nufleet demo`: rank an installed fleet, then test the prediction in flight."""

from __future__ import annotations

import time
from pathlib import Path

import click

from nufleet.orchestrator.conduct.rank_run import RankRequest, configuration, prepare, run_study
from nufleet.orchestrator.evaluation.demonstration import demo_table, demonstrate
from nufleet.orchestrator.evaluation.flight_documents import DemoResult
from nufleet.orchestrator.experience.train import check_torch
from nufleet.orchestrator.fleet.reach import Reach
from nufleet.orchestrator.flights.legs import legs_of, read_drawings
from nufleet.orchestrator.jobs.flying import KeptFlights, OpenRun, flying
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.jobs.terminal import stderr_console
from nufleet.orchestrator.runs.console import ConsoleObserver, ranking_table
from nufleet.orchestrator.runs.rank_result import RunRecord
from nufleet.orchestrator.viewer.study_feed import LiveView
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.robots.fleet_file import find_fleet_file

ITERATIONS = 7
DRAWING = "clover"
SPEED = 0.6
FLIGHT_S = 60.0
ARCHITECTURES: dict[str, Architecture] = {"paper_linear": "preview", "paper_quadrotors": "state"}
"""Architecture of the experiences by fleet. The quadrotors use the paper's own inverse. The linear
fleet uses the filter whose effect the tests predict: there an inverse fed with the state forms a
feedback loop, which orders the sources differently."""


def demo_and_print(
    fleet_name: str,
    *,
    seed: int,
    live: bool,
    runs_root: Path,
    repository: str | None,
    as_json: bool,
) -> None:
    """Run the demonstration, with progress on stderr and, if wanted, the document on stdout.

    Args:
        fleet_name: Name of an installed fleet, a key of `ARCHITECTURES`.
        seed: Seed of the study, the learning flights and the networks.
        live: Whether to serve the recording to live viewers.
        runs_root: Folder that holds the folders of all runs.
        repository: Address of the repository; None for the one in `runs_root`.
        as_json: Whether to print the result as JSON on stdout.
    """
    check_torch()
    console = stderr_console()
    began_s = time.monotonic()
    reach = Reach(connect="", fleet_file=str(find_fleet_file(fleet_name)))
    storage = Storage(runs_root, repository)
    with flying(reach, "demo", storage, console, live=live, robots=lambda there: there) as session:
        record = _ranked(session, reach, storage, seed)
        console.print(ranking_table(record.result.ranking, record.closed_form))
        result = _demonstrated(session, record, ARCHITECTURES[fleet_name], seed)
    console.print(demo_table(result.flights))
    console.print(f"{time.monotonic() - began_s:.0f} s")
    if as_json:
        click.echo(result.document())


def _ranked(session: OpenRun, reach: Reach, storage: Storage, seed: int) -> RunRecord:
    study = None if reach.file is None else reach.file.study
    if study is None:
        raise InvalidInputError(f"{reach.fleet_file} names no target")
    fleet, _, there = session.connection
    request = RankRequest(
        target=study.target,
        sources=None,
        band_rad_s=study.band_rad_s,
        iterations=ITERATIONS,
        seed=seed,
        axis=None,
    )
    ready = prepare(fleet, request, there)
    session.folder.write_configuration(
        configuration(ready, seed)
        | {"kind": "demo", "fleet": session.connection.name, **storage.document()}
    )
    unit = ready.descriptions[ready.plan.target].spec.axis(ready.plan.axis).unit
    live = LiveView(ready.plan, unit, session.clock, session.writer.emit)
    live.watch(fleet)
    try:
        return run_study(
            fleet,
            ready,
            session.archive.begin(
                session.folder.study_id, "paper", ready.plan, seed, ready.descriptions
            ),
            session.archive,
            folder=session.folder,
            observers=[ConsoleObserver(session.console, ITERATIONS), live],
        )
    finally:
        live.stop_watching()


def _demonstrated(
    session: OpenRun, record: RunRecord, architecture: Architecture, seed: int
) -> DemoResult:
    fleet = session.connection.fleet
    target = fleet.describe(record.result.target)
    return demonstrate(
        fleet,
        session.pilot,
        target,
        record.result,
        legs_of(read_drawings((DRAWING,)), (SPEED,), target),
        architecture,
        session.folder,
        seed=seed,
        flight_s=FLIGHT_S,
        say=session.console.print,
        observers=[KeptFlights(session)],
    )
