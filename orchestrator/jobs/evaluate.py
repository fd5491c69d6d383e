"""The work of `nufleet evaluate`: connect, evaluate one target or all, print the result."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import click

from nufleet.orchestrator.conduct.rank_run import RankRequest, prepare
from nufleet.orchestrator.evaluation.pairs import PAIRS, PairsResult, compare_pairs
from nufleet.orchestrator.evaluation.report import (
    evaluation_table,
    pairs_table,
    paper_table,
    write_figures,
    write_scatter,
)
from nufleet.orchestrator.evaluation.results import EvaluationRecord
from nufleet.orchestrator.evaluation.run import EvaluationPlan, run_evaluation
from nufleet.orchestrator.experience.learning import FLIGHT_S
from nufleet.orchestrator.experience.train import check_torch, train_robots
from nufleet.orchestrator.experience.transfer import check_would_fit
from nufleet.orchestrator.fleet.reach import Reach
from nufleet.orchestrator.flights.legs import legs_of, read_drawings
from nufleet.orchestrator.jobs.flying import KeptFlights, OpenRun, flying
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.jobs.terminal import stderr_console
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.paths.installed import drawing_names

Drawings = dict[str, FloatArray]
"""Points of each drawing in m, shape (n, 2), by the drawing's name."""

SPEEDS = (0.3, 0.6, 0.9)
"""Largest speeds in m/s of the paper's trajectories (Section VI)."""

STUDIES = 10
"""Number of repeated studies of one target, unless the command says otherwise."""

# The settings of --quick.
QUICK_DRAWINGS = 2
QUICK_SPEED = 0.6
QUICK_STUDIES = 2
QUICK_FLIGHT_S = 60.0


@dataclass(frozen=True)
class EvaluateCommand:
    """The options of one `nufleet evaluate`."""

    fleet_file: Path | None
    """Path of the fleet file to start; None for a running fleet."""
    connect: str
    """Endpoint of a running fleet."""
    fleet_name: str | None
    """Name of the running fleet; None when only one is running there."""
    target: str | None
    """Name of the robot that flies; None for the fleet file's target."""
    sources: tuple[str, ...] | None
    """Names of the sources; None for all robots but the target."""
    architecture: Architecture
    """Architecture of the experiences to compare."""
    drawings: tuple[str, ...] | None
    """Paths or names of the drawings to fly; None for the installed ones."""
    speeds: tuple[float, ...] | None
    """Largest speeds on the paths, in the unit of the target's axes per second; None for those of
    the paper."""
    scale: float
    """Factor on the points of the drawings."""
    studies: int | None
    """Number of repeated studies of each target; None for the default."""
    iterations: int
    """Number of iterations of each study."""
    quick: bool
    """Whether to shorten the evaluation: fewer drawings, speeds and studies, shorter flights."""
    all_pairs: bool
    """Whether to evaluate every robot as the target of all others."""
    guarded: bool
    """Whether the guard may withdraw an inverse in flight."""
    seed: int
    """Seed of the first study, of the flights and of the networks."""
    live: bool
    """Whether to serve the recording to live viewers."""
    runs_root: Path
    """Folder that holds the folders of all runs."""
    repository: str | None
    """Address of the repository; None for the one in `runs_root`."""
    as_json: bool
    """Whether to print the result as JSON on stdout."""

    @property
    def reach(self) -> Reach:
        """Way to connect to the fleet."""
        file = None if self.fleet_file is None else str(self.fleet_file)
        return Reach(connect=self.connect, fleet_name=self.fleet_name, fleet_file=file)

    @property
    def chosen_drawings(self) -> tuple[str, ...]:
        """Paths or names of the drawings that are flown."""
        if self.drawings is not None:
            return self.drawings
        names = drawing_names()
        return names[:QUICK_DRAWINGS] if self.quick else names

    @property
    def chosen_speeds(self) -> tuple[float, ...]:
        """Largest speeds on the paths, in the unit of the target's axes per second."""
        if self.speeds is not None:
            return self.speeds
        return (QUICK_SPEED,) if self.quick else SPEEDS

    @property
    def flight_s(self) -> float:
        """Duration of each flight that a robot learns from."""
        return QUICK_FLIGHT_S if self.quick else FLIGHT_S

    @property
    def seeds(self) -> range:
        """Seeds of the repeated studies of each target."""
        default = 1 if self.all_pairs else QUICK_STUDIES if self.quick else STUDIES
        count = self.studies or default
        return range(self.seed, self.seed + count)


def evaluate_and_print(command: EvaluateCommand) -> None:
    """Evaluate one target or all, with progress on stderr and, if wanted, the document on stdout.

    Raises:
        InvalidInputError: The options contradict each other or do not fit the fleet, or torch is
            not installed.
    """
    check_torch()
    if command.all_pairs and (command.target is not None or command.sources is not None):
        raise InvalidInputError(
            "--all-pairs takes every robot as target and source: leave --target and --sources out"
        )
    console = stderr_console()
    began_s = time.monotonic()
    kind = "pairs" if command.all_pairs else "evaluate"
    drawings = read_drawings(command.chosen_drawings)
    storage = Storage(command.runs_root, command.repository)

    def robots(there: tuple[str, ...]) -> tuple[str, ...]:
        if command.all_pairs or command.sources is None:
            return there
        return (_target(command), *command.sources)

    with flying(command.reach, kind, storage, console, live=command.live, robots=robots) as session:
        targets = session.connection.robots if command.all_pairs else (_target(command),)
        # Check all targets first, so that no robot learns for minutes before a plan is refused.
        plans = [_plan(command, session, drawings, target) for target in targets]
        configuration = {
            **asdict(command),
            "fleet_file": str(command.fleet_file),
            **storage.document(),
        }
        session.folder.write_configuration(
            {"kind": kind, "fleet": session.connection.name, **configuration}
        )
        if command.all_pairs:
            pairs = _all_pairs(command, session, plans)
            document = pairs.document()
        else:
            record = _evaluated(session, plans[0])
            session.table.close()
            write_figures(session.folder.path, record, session.table.path)
            console.print(evaluation_table(record.result))
            if _is_papers(session):
                console.print(paper_table(record.result))
            document = record.result.document()
    if command.all_pairs:
        console.print(pairs_table(pairs))
    console.print(f"{time.monotonic() - began_s:.0f} s")
    if command.as_json:
        click.echo(document)


def _all_pairs(
    command: EvaluateCommand, session: OpenRun, plans: Sequence[EvaluationPlan]
) -> PairsResult:
    fleet, _, there = session.connection
    session.console.print(f"{len(there)} robots learn what they would pass on")
    train_robots(
        fleet,
        session.pilot,
        [fleet.describe(robot) for robot in there],
        (command.architecture,),
        session.folder.path / "experiences",
        seed=command.seed,
        duration_s=command.flight_s,
        say=lambda robot, what: None,
        on_trained=lambda done: session.console.print(f"  {done.lesson.robot} has learned"),
    )
    results = [_evaluated(session, plan).result for plan in plans]
    pairs = compare_pairs(results, str(session.folder.path))
    session.folder.write_document(PAIRS, pairs)
    write_scatter(session.folder.path, pairs)
    return pairs


def _plan(
    command: EvaluateCommand, session: OpenRun, drawings: Drawings, target: str
) -> EvaluationPlan:
    """Return the checked plan for one target; raises InvalidInputError when it cannot be flown."""
    fleet, _, there = session.connection
    file = command.reach.file
    request = RankRequest(
        target=target,
        sources=command.sources,
        band_rad_s=None if file is None or file.study is None else file.study.band_rad_s,
        iterations=command.iterations,
        seed=command.seed,
        axis=None,
    )
    ready = prepare(fleet, request, there)
    for source in ready.plan.sources:
        check_would_fit(
            ready.descriptions[source], ready.descriptions[target], command.architecture
        )
    return EvaluationPlan(
        ready=ready,
        legs=legs_of(
            drawings, command.chosen_speeds, ready.descriptions[target], scale=command.scale
        ),
        architecture=command.architecture,
        seeds=command.seeds,
        seed=command.seed,
        guarded=command.guarded,
        flight_s=command.flight_s,
    )


def _evaluated(session: OpenRun, plan: EvaluationPlan) -> EvaluationRecord:
    study = plan.ready.plan
    session.console.print(
        f"[bold]target {study.target}[/]: {len(plan.legs)} paths with "
        f"{len(study.sources) + 2} inverses"
    )
    return run_evaluation(
        session.connection.fleet,
        session.pilot,
        plan,
        session.folder,
        session.archive,
        say=session.console.print,
        observers=[KeptFlights(session)],
    )


def _target(command: EvaluateCommand) -> str:
    file = command.reach.file
    if command.target is not None:
        return command.target
    if file is not None and file.study is not None:
        return file.study.target
    raise InvalidInputError("which robot is to be evaluated? Name it with --target")


def _is_papers(session: OpenRun) -> bool:
    """Return whether the fleet models the paper's own, so that its Table I can be compared."""
    return session.connection.name == "paper-quadrotors"
