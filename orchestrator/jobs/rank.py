"""The work of `nufleet rank`: connect, check the request, run the study, print the result."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import cache, partial

import click
from rich.console import Console

from nufleet.orchestrator.conduct.desired_motion import TimedPath, read_motion
from nufleet.orchestrator.conduct.first_round import outlook
from nufleet.orchestrator.conduct.preflight import ALL_AXES, check_band, check_names
from nufleet.orchestrator.conduct.rank_run import (
    RankRequest,
    ReadyStudy,
    configuration,
    prepare,
)
from nufleet.orchestrator.conduct.recipe import AWAY, Recipe, make_study
from nufleet.orchestrator.conduct.reuse import check_absent, find_stored, oldest_reused
from nufleet.orchestrator.fleet.reach import REACH, FleetChoice
from nufleet.orchestrator.flights.planned import Outlook
from nufleet.orchestrator.jobs.commands import AnyFleetCommand, MovingCommand
from nufleet.orchestrator.jobs.consent import carried_out
from nufleet.orchestrator.jobs.opening import Opening
from nufleet.orchestrator.jobs.study import show_study
from nufleet.orchestrator.repository.records import StudyRecord
from nufleet.orchestrator.runs.rank_result import RunRecord
from nufleet.orchestrator.study.algorithms import OWN, load_algorithm
from nufleet.shared.errors import InvalidInputError


@dataclass(frozen=True, kw_only=True)
class RankCommand(MovingCommand, AnyFleetCommand):
    """The options of one `nufleet rank`."""

    target: str | None = None
    """Name of the robot that needs experience; None for the target that the fleet file names."""
    sources: tuple[str, ...] | None = None
    """Names of the sources; None for all robots but the target."""
    band_rad_s: tuple[float, float] | None = None
    """Lower and upper end of the frequency band W (paper, eq. 6); None for the band of the fleet
    file or of the robots."""
    axis: str | None = None
    """Name of the only axis to test; None for `axes`."""
    axes: tuple[str, ...] | None = None
    """Names of several axes to test, `all` for all that the robots have in common; None for all
    with the adaptive algorithm, and for the target's first axis with others."""
    iterations: int = 7
    """Limit on the number of iterations."""
    precision: float | None = None
    """Width of the selected source's 95 % interval at which the study may end; None for no
    limit."""
    amplitude: float | None = None
    """Amplitude of the task in the unit of the axis; None for what each robot chooses."""
    seed: int = 0
    """Seed of the study."""
    algorithm: str = "adaptive"
    """Algorithm that selects the tests."""
    realtime: float | None = None
    """Speed of the simulated robots relative to real time; None for as fast as possible."""
    wait_s: float = 0.0
    """Time to wait for a running fleet's router and robots."""
    live: bool = False
    """Whether to serve the recording to live viewers."""
    draws: bool = True
    """Whether to draw a recording and plots."""
    rehearses: bool = True
    """Whether the target is asked what error it expects of each way to fly."""
    processes: int | None = 2
    """Number of processes that the robots of a fleet file are spread over; None for one each."""
    trajectory: str | None = None
    """Path or name of the drawing that transfer is to help on; None for no particular one."""
    speed_m_s: float | None = None
    """Largest speed on that drawing; None for the default."""
    reuse_days: float | None = None
    """Largest age of stored responses that replace tests, in days; None to test all sources."""

    def fleet(self) -> FleetChoice:
        """Return the chosen fleet, with the content of its file; raises FleetFileError."""
        if self.fleet_file is None:
            return super().fleet()
        return FleetChoice.started(
            self.fleet_file, realtime=self.realtime, processes=self.processes
        )


def rank_and_print(command: RankCommand) -> None:
    """Rank, with progress on stderr and, if wanted, the document on stdout."""
    record = carried_out(command, rank)
    if record is not None and command.as_json:
        click.echo(record.result.document())


def rank(command: RankCommand, console: Console) -> RunRecord:
    """Rank the sources of a fleet and return the record of the run, as stored in its folder.

    A request that cannot be carried out is refused before anything moves.

    Raises:
        InvalidInputError: The options contradict each other or do not fit the fleet, or real robots
            may not move.
        OnlyPlannedError: The command only plans.
        FleetFileError: The fleet file is not valid.
        LeaseHeldError: A robot belongs to another orchestrator.
        StudyError: The study cannot continue, because the target or every source is gone.
    """
    choice = command.fleet()
    request = _request(command, choice)
    with Opening(command, console) as run:
        # A source whose stored responses are reused need not be there.
        sources = (command.sources or ()) if command.reuse_days is None else ()
        run.reach(choice, (request.target, *sources), wait_s=command.wait_s)
        ready, stored = _ready(command, request, run)
        moves = cache(partial(_first_round, command, ready, stored, run))
        if stored:
            moves()  # raises if stored responses leave nothing to test
        folder = run.keep()
        archive = run.take(
            {robot: one for robot, one in ready.descriptions.items() if one.boot_id != AWAY}, moves
        )
        reached = choice.reach.model_copy(update={"fleet_name": run.connection.name})
        run.configure(
            {
                **configuration(ready, command.seed),
                "algorithm": command.algorithm,
                REACH: reached.model_dump(mode="json"),
            }
        )
        run.record(live=command.live, draws=command.draws)
        run.say_how_to_resume()
        study = archive.begin(
            folder.study_id,
            command.algorithm,
            ready.plan,
            command.seed,
            ready.descriptions,
            stored,
        )
        return show_study(run, ready, study, request.drawing, rehearses=command.rehearses)


def _first_round(
    command: RankCommand,
    ready: ReadyStudy,
    stored: Mapping[str, tuple[str, ...]],
    run: Opening,
) -> Outlook:
    """Return what the robots would do first; raises InvalidInputError if no robot has to move."""
    name = run.connection.name
    parameters = Recipe.of(ready.descriptions, stored).parameters()
    record = StudyRecord("planned", name, command.algorithm, ready.plan, command.seed, parameters)
    question = make_study(record, run.repository.studies).ask()
    if question is None:
        raise InvalidInputError("the stored responses answer the question: no robot has to move")
    specs = {robot: one.spec for robot, one in ready.descriptions.items()}
    return outlook(ready.plan, question, specs)


def _request(command: RankCommand, choice: FleetChoice) -> RankRequest:
    """Return what is requested, checked as far as it can be before a fleet is reached."""
    if command.band_rad_s is not None:
        check_band(command.band_rad_s)
    if command.algorithm not in (*OWN, "match"):
        load_algorithm(command.algorithm)
    if command.reuse_days is not None and command.algorithm != "adaptive":
        raise InvalidInputError("--reuse requires --algorithm adaptive")
    if command.axes is not None and command.algorithm != "adaptive":
        raise InvalidInputError("--axes requires --algorithm adaptive")
    if command.algorithm != "adaptive" and (command.precision or command.amplitude):
        raise InvalidInputError("--precision and --amplitude require --algorithm adaptive")
    request = RankRequest(
        target=choice.target(command.target),
        sources=command.sources,
        band_rad_s=choice.band_rad_s(command.band_rad_s),
        iterations=command.iterations,
        seed=command.seed,
        axes=_axes(command),
        drawing=_drawing(command),
        precision=command.precision,
        amplitude=command.amplitude,
    )
    if choice.file is not None:
        # No process has to be started to refuse names that are not in the file.
        there = tuple(choice.file.robots)
        check_names(request.target, request.sources_among(there), there)
    return request


def _axes(command: RankCommand) -> tuple[str, ...] | None:
    if command.axis is not None and command.axes is not None:
        raise InvalidInputError("give either --axis or --axes")
    if command.axis is not None:
        return (command.axis,)
    if command.axes is None and command.algorithm == "adaptive":
        return (ALL_AXES,)
    return command.axes


def _drawing(command: RankCommand) -> TimedPath | None:
    if command.trajectory is not None:
        return read_motion(command.trajectory, command.speed_m_s)
    if command.speed_m_s is not None:
        raise InvalidInputError("--speed requires --trajectory")
    return None


def _ready(
    command: RankCommand, request: RankRequest, run: Opening
) -> tuple[ReadyStudy, Mapping[str, tuple[str, ...]]]:
    """Return the checked study, and by source the ids of stored goals that replace its tests."""
    fleet, name, there = run.connection
    if command.reuse_days is None:
        return prepare(fleet, request, there), {}
    known = {record.robot: record.spec for record in run.repository.robots.robots(name)}
    ready = prepare(fleet, request, there, known)
    reuse = find_stored(
        run.repository,
        name,
        ready.plan,
        {robot: description.spec for robot, description in ready.descriptions.items()},
        newer_than=oldest_reused(command.reuse_days, datetime.now(UTC)),
    )
    check_absent([robot for robot in ready.plan.sources if robot not in there], reuse, name)
    for robot, reason in reuse.unusable.items():
        run.console.print(f"{robot} flies: {reason}")
    return ready, reuse.known
