"""The work of `nufleet demo`: rank an installed fleet, then test the prediction in flight."""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import click
from rich.console import Console

from nufleet.orchestrator.conduct.rank_run import RankRequest, configuration, prepare
from nufleet.orchestrator.evaluation.demo_table import demo_parts
from nufleet.orchestrator.evaluation.demonstration import demonstrate
from nufleet.orchestrator.evaluation.flight_documents import DemoResult
from nufleet.orchestrator.experience.training import check_torch
from nufleet.orchestrator.fleet.reach import FleetChoice
from nufleet.orchestrator.flights.legs import legs_of, read_drawings
from nufleet.orchestrator.jobs.commands import StoredCommand
from nufleet.orchestrator.jobs.consent import only_simulated
from nufleet.orchestrator.jobs.flying import FlyingRun, KeptFlights
from nufleet.orchestrator.jobs.study import follow_study
from nufleet.orchestrator.jobs.terminal import stderr_console
from nufleet.orchestrator.runs.console import ranking_table
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.robots.fleet_file import find_fleet_file

ITERATIONS = 7
DRAWING = "clover"
SPEED = 0.6
FLIGHT_S = 60.0
ARCHITECTURES: dict[str, Architecture] = {"weak_source": "preview", "paper_quadrotors": "state"}
"""Architecture of the experiences by fleet. The quadrotors use the paper's own inverse. The linear
fleet uses the filter whose effect the tests predict: there an inverse fed with the state forms a
feedback loop, which orders the sources differently."""


@dataclass(frozen=True, kw_only=True)
class DemoCommand(StoredCommand):
    """The options of one `nufleet demo`."""

    quadrotors: bool = False
    """Whether the fleet consists of simulated quadrotors instead of linear robots."""
    seed: int = 0
    """Seed of the study, the learning flights and the networks."""
    live: bool = False
    """Whether to serve the recording to live viewers."""


def demo_and_print(command: DemoCommand) -> None:
    """Run the demonstration, with progress on stderr and, if wanted, the document on stdout."""
    result = demo(command, stderr_console())
    if command.as_json:
        click.echo(result.document())


def demo(command: DemoCommand, console: Console) -> DemoResult:
    """Run the demonstration and return its result, as stored in the folder of the run.

    Raises:
        InvalidInputError: Torch is not installed.
        StudyError: The study cannot continue, because the target or every source is gone.
    """
    if command.quadrotors:  # linear robots have linear inverses, which need no network
        check_torch()
    began_s = time.monotonic()
    fleet_name = "paper_quadrotors" if command.quadrotors else "weak_source"
    choice = FleetChoice.started(find_fleet_file(fleet_name))
    request = RankRequest(
        target=choice.target(None),
        sources=None,
        band_rad_s=choice.band_rad_s(None),
        iterations=ITERATIONS,
        seed=command.seed,
        axes=None,
    )
    drawing: list[Future[None]] = []
    # The plots of the ranking are drawn while robots fly. The run is left first, so that an
    # interrupt brings the robots to rest before it waits for the plots.
    with ThreadPoolExecutor(1, "plots") as beside, FlyingRun(command, console) as run:
        fleet, _, there = run.reach(choice)
        ready = prepare(fleet, request, there)
        run.fly("demo", ready.descriptions, only_simulated, live=command.live)
        run.configure({**configuration(ready, command.seed), "kind": "demo"})
        study = run.archive.begin(
            run.folder.study_id, "adaptive", ready.plan, command.seed, ready.descriptions
        )
        record = follow_study(
            run, ready, study, draw=lambda plots: drawing.append(beside.submit(plots))
        )
        run.results.print(ranking_table(record.result.ranking, record.closed_form))
        target = ready.descriptions[request.target]
        (leg,) = legs_of(read_drawings((DRAWING,)), (SPEED,), target)
        result = demonstrate(
            fleet,
            run.pilot,
            target,
            record,
            leg,
            ARCHITECTURES[fleet_name],
            run.folder,
            seed=command.seed,
            flight_s=FLIGHT_S,
            say=console.print,
            observers=[KeptFlights(run)],
        )
        for plots in drawing:
            plots.result()
    for part in demo_parts(result):
        run.results.print(part)
    console.print(f"{time.monotonic() - began_s:.0f} s")
    return result
