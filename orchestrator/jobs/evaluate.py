"""The work of `nufleet evaluate`: connect, evaluate one target or all, print the result."""

from __future__ import annotations

import json
import shutil
import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from itertools import pairwise
from pathlib import Path

import click
from pydantic import TypeAdapter
from rich.console import Console

from nufleet.orchestrator.conduct.preflight import ALL_AXES, check_robots
from nufleet.orchestrator.conduct.rank_run import RankRequest, prepare
from nufleet.orchestrator.evaluation.pairs import PAIRS, PairsResult, compare_pairs
from nufleet.orchestrator.evaluation.planned import planned_evaluation
from nufleet.orchestrator.evaluation.report import (
    evaluation_table,
    pairs_table,
    paper_table,
    ways_table,
    write_figures,
    write_scatter,
)
from nufleet.orchestrator.evaluation.results import EvaluationRecord, EvaluationResult
from nufleet.orchestrator.evaluation.run import EvaluationPlan, prepare_robots, run_evaluation
from nufleet.orchestrator.experience.learning import FLIGHT_S
from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.experience.training import check_torch
from nufleet.orchestrator.experience.transfer import check_would_fit
from nufleet.orchestrator.fleet.reach import REACH, FleetChoice, Reach
from nufleet.orchestrator.flights.legs import legs_of, read_drawings
from nufleet.orchestrator.history.catalogue import read_run
from nufleet.orchestrator.jobs.commands import AnyFleetCommand, MovingCommand
from nufleet.orchestrator.jobs.consent import carried_out
from nufleet.orchestrator.jobs.flying import FlyingRun, KeptFlights
from nufleet.orchestrator.runs.folder import CONFIGURATION, read_configuration
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.paths.installed import drawing_names, find_drawing
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.strict import validation_errors_as
from nufleet.shared.wire.messages import Description

Drawings = dict[str, FloatArray]
"""Points of each drawing in m, shape (n, 2), by the drawing's name."""

SPEEDS = (0.3, 0.6, 0.9)
"""Largest speeds in m/s of the paper's trajectories (Section VI)."""

OWN_FLIGHT_S = (0.0, 5.0, 15.0, 30.0, 60.0, 120.0)
"""Durations in s of the target's own flying beyond its tests, unless the command says otherwise."""

STUDIES = 10
"""Number of repeated studies of one target, unless the command says otherwise."""

PAPERS_FLEET = "paper-quadrotors"
"""Name of the fleet that models the paper's own, so that its Table I can be compared."""

ROBOTS = "robots"
"""Subfolder of the run in which the robots of a fleet that was started for it remember."""

# The settings of --quick.
QUICK_DRAWINGS = 2
QUICK_SPEED = 0.6
QUICK_STUDIES = 2
QUICK_FLIGHT_S = 60.0
QUICK_OWN_FLIGHT_S = (0.0, 15.0, 30.0)


@dataclass(frozen=True, kw_only=True)
class ResumedCommand(MovingCommand):
    """The options of an evaluation that may differ when it is resumed."""

    live: bool
    """Whether to serve the recording to live viewers."""


@dataclass(frozen=True, kw_only=True)
class EvaluateCommand(MovingCommand, AnyFleetCommand):
    """The options of one `nufleet evaluate`."""

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
    own_flight_s: tuple[float, ...] | None
    """Durations in s of the target's own flying beyond its tests, after each of which it flies with
    its model of itself; None for the default."""
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

    @property
    def kind(self) -> str:
        """Kind of the run."""
        return "pairs" if self.all_pairs else "evaluate"

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
    def chosen_own_flight_s(self) -> tuple[float, ...]:
        """Durations in s of the target's own flying beyond its tests, rising from 0."""
        if self.own_flight_s is not None:
            return tuple(sorted({0.0, *self.own_flight_s}))
        if self.all_pairs:
            return (0.0,)
        return QUICK_OWN_FLIGHT_S if self.quick else OWN_FLIGHT_S

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
    """Evaluate, with progress on stderr and, if wanted, the document on stdout."""
    result = carried_out(command, evaluate)
    if result is not None and command.as_json:
        click.echo(result.document())


def evaluate(command: EvaluateCommand, console: Console) -> EvaluationResult | PairsResult:
    """Evaluate one target, or every robot as the target of all others, and return the result.

    Raises:
        InvalidInputError: The options contradict each other or do not fit the fleet, or torch is
            not installed.
        LeaseHeldError: A robot belongs to another orchestrator.
    """
    check_torch()
    if command.all_pairs and (command.target is not None or command.sources is not None):
        raise InvalidInputError(
            "--all-pairs takes every robot as target and source: leave --target and --sources out"
        )
    choice = command.fleet()
    one = () if command.all_pairs else (choice.target(command.target),)
    drawings = read_drawings(command.chosen_drawings)
    with FlyingRun(command, console) as run:
        if choice.file is not None:
            # Its robots remember what they learn, so that the run can be resumed.
            choice = choice.remembering(run.keep(command.kind, choice.name).path / ROBOTS)
        plans, descriptions = _planned(command, run, choice, drawings, one)
        moves = partial(planned_evaluation, plans)
        run.fly(command.kind, descriptions, moves, live=command.live)
        files = [find_drawing(drawing).resolve() for drawing in command.chosen_drawings]
        reached = choice.reach.model_copy(update={"fleet_name": run.connection.name})
        run.configure(
            {
                **asdict(command),
                "kind": command.kind,
                "drawings": [str(file) for file in files],
                REACH: reached.model_dump(mode="json"),
            }
        )
        result = _conducted(command, run, plans, descriptions)
    _forget_robots(run.folder.path)
    return result


def resume_evaluation(
    path: Path, reach: Reach, resumed: ResumedCommand, console: Console
) -> EvaluationResult | PairsResult:
    """Resume an interrupted evaluation where it stopped, and return its result.

    Args:
        path: Folder of the run.
        reach: How to reach its fleet.
        resumed: Options that may differ from those of the interrupted command.
        console: Console for progress.

    Raises:
        InvalidInputError: It is complete, its folder is damaged, or a robot is missing.
        LeaseHeldError: A robot belongs to another orchestrator.
    """
    check_torch()
    with validation_errors_as(InvalidInputError, str(path / CONFIGURATION)):
        stored: EvaluateCommand = TypeAdapter(EvaluateCommand).validate_json(
            json.dumps(read_configuration(path))
        )
    command = replace(stored, **asdict(resumed))
    if read_run(path).result is not None:
        raise InvalidInputError(f"{path.name} is complete: `nufleet runs show {path.name}`")
    one = () if command.all_pairs else (command.target or FleetChoice.again(reach).target(None),)
    drawings = read_drawings(command.chosen_drawings)
    with FlyingRun(command, console) as run:
        console.print(f"resuming {path.name}")
        plans, descriptions = _planned(command, run, FleetChoice.again(reach), drawings, one)
        moves = partial(planned_evaluation, plans, resumed=True)
        run.fly_on(path, descriptions, moves, live=command.live)
        result = _conducted(command, run, plans, descriptions)
    _forget_robots(path)
    return result


def _planned(
    command: EvaluateCommand,
    run: FlyingRun,
    choice: FleetChoice,
    drawings: Drawings,
    targets: tuple[str, ...],
) -> tuple[list[EvaluationPlan], dict[str, Description]]:
    """Reach the fleet; return the checked plan of every target, and all robots that fly."""
    _, _, there = run.reach(choice)
    targets = targets or there
    check_robots(targets, there)
    # Check all targets first, so that no robot learns for minutes before a plan is refused.
    plans = [_plan(command, run, drawings, target) for target in targets]
    return plans, {
        robot: description
        for plan in plans
        for robot, description in plan.ready.descriptions.items()
    }


def _conducted(
    command: EvaluateCommand,
    run: FlyingRun,
    plans: Sequence[EvaluationPlan],
    descriptions: Mapping[str, Description],
) -> EvaluationResult | PairsResult:
    began_s = time.monotonic()
    run.say_how_to_resume()
    library = _library(command, run)
    if command.all_pairs:
        prepare_robots(
            run.connection.fleet,
            run.pilot,
            library,
            plans[0],
            tuple(descriptions),
            run.folder,
            say=run.console.print,
        )
        results = [_evaluated(run, library, plan).result for plan in plans]
        pairs = compare_pairs(results, str(run.folder.path))
        run.folder.write_document(PAIRS, pairs)
        write_scatter(run.folder.path, pairs)
        run.results.print(pairs_table(pairs))
        result: EvaluationResult | PairsResult = pairs
    else:
        record = _evaluated(run, library, plans[0])
        write_figures(run.folder.path, record, run.table.path)
        result = record.result
        run.results.print(evaluation_table(result))
        run.results.print(ways_table(result))
        if run.connection.name == PAPERS_FLEET:
            run.results.print(paper_table(result))
    run.console.print(f"{time.monotonic() - began_s:.0f} s")
    return result


def _forget_robots(folder: Path) -> None:
    """Remove what a fleet started for a run remembered, since nothing is left to resume."""
    shutil.rmtree(folder / ROBOTS, ignore_errors=True)


def _plan(
    command: EvaluateCommand, run: FlyingRun, drawings: Drawings, target: str
) -> EvaluationPlan:
    """Return the checked plan for one target; raises InvalidInputError when it cannot be flown."""
    fleet, _, there = run.connection
    request = RankRequest(
        target=target,
        sources=command.sources,
        band_rad_s=run.choice.band_rad_s(None),
        iterations=command.iterations,
        seed=command.seed,
        axes=(ALL_AXES,),
    )
    ready = prepare(fleet, request, there)
    # A target that flies no paths is refused for that, and not for the experiences of its sources.
    legs = legs_of(drawings, command.chosen_speeds, ready.descriptions[target], scale=command.scale)
    for source in ready.plan.sources:
        check_would_fit(
            ready.descriptions[source], ready.descriptions[target], command.architecture
        )
    check_own_flights(command.chosen_own_flight_s, ready.descriptions[target].spec, target)
    return EvaluationPlan(
        ready=ready,
        legs=legs,
        architecture=command.architecture,
        seeds=command.seeds,
        seed=command.seed,
        guarded=command.guarded,
        flight_s=command.flight_s,
        own_flight_s=command.chosen_own_flight_s,
        forget=command.fleet_file is not None,
    )


def check_own_flights(own_flight_s: Sequence[float], spec: RobotSpec, robot: str) -> None:
    """Check that a robot may fly for as long as each rich flight of an evaluation takes.

    Args:
        own_flight_s: Durations of its own flying, rising, between which it flies without a break.
        spec: Description of the robot.
        robot: Name of the robot, for error messages.

    Raises:
        InvalidInputError: It may not.
    """
    longest_s = max((after - before for before, after in pairwise(own_flight_s)), default=0.0)
    allowed_s = spec.duration_max_s - spec.settling_time_s
    if longest_s > allowed_s:
        raise InvalidInputError(
            f"--own-flight has robot {robot} fly for {longest_s:g} s at once, and it may fly for "
            f"{allowed_s:g} s: add a duration in between"
        )


def _library(command: EvaluateCommand, run: FlyingRun) -> ExperienceLibrary:
    """Return the experiences of the fleet, without stored ones if it is started for this run."""
    store = run.repository.robots if command.fleet_file is None else None
    return ExperienceLibrary(run.connection.fleet, store, run.connection.name)


def _evaluated(
    run: FlyingRun, library: ExperienceLibrary, plan: EvaluationPlan
) -> EvaluationRecord:
    study = plan.ready.plan
    run.console.print(
        f"[bold]target {study.target}[/]: {len(plan.legs)} paths with "
        f"{len(study.sources) + 4} inverses, and with its model of itself again after "
        f"{' and '.join(f'{s:g}' for s in plan.own_flight_s[1:]) or 0} s"
    )
    return run_evaluation(
        run.connection.fleet,
        run.pilot,
        library,
        plan,
        run.folder,
        run.archive,
        say=run.console.print,
        observers=[KeptFlights(run)],
    )
