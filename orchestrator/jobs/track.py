"""The work of `nufleet track`: check the paths, fly them, report the errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import click
from rich.console import Console

from nufleet.orchestrator.conduct.preflight import check_robots
from nufleet.orchestrator.evaluation.flight_documents import TRACKING, TrackResult
from nufleet.orchestrator.evaluation.fly_target import flight_record
from nufleet.orchestrator.evaluation.results import FlightRecord
from nufleet.orchestrator.experience.learning import FIRST_FLIGHT_S, know_itself
from nufleet.orchestrator.flights.labels import BASELINE, BY_AXIS, MIXTURE, NO_PRIOR, OWN
from nufleet.orchestrator.flights.legs import Leg, legs_of, read_drawings
from nufleet.orchestrator.flights.planned import Outlook, path_motion, rich_motion
from nufleet.orchestrator.flights.start_weights import mixture_of
from nufleet.orchestrator.history.rankings import Ranking, latest_ranking
from nufleet.orchestrator.jobs.commands import FleetCommand, MovingCommand
from nufleet.orchestrator.jobs.consent import carried_out
from nufleet.orchestrator.jobs.flying import FlyingRun, KeptFlights
from nufleet.orchestrator.jobs.foresight import say_expected
from nufleet.orchestrator.jobs.held_way import held_way
from nufleet.orchestrator.logs.keeping import keep_flight_responses
from nufleet.orchestrator.study.source_by_axis import way_by_axis
from nufleet.shared.errors import InvalidInputError, RobotError
from nufleet.shared.experience.layout import HORIZON_SAMPLES_MAX, InverseLayout
from nufleet.shared.wire.messages import Description, ForeseenWay

InverseChoice = Literal["auto", "prior", "by-axis", "mixture", "own", "zero-prior", "baseline"]
"""Inverse models to fly with."""


@dataclass(frozen=True, kw_only=True)
class TrackCommand(MovingCommand, FleetCommand):
    """The options of one `nufleet track`."""

    target: str
    """Name of the robot that flies."""
    drawings: tuple[str, ...]
    """Paths or names of the drawings to fly."""
    speed: float
    """Largest speed on the paths, in the unit of the robot's axes per second."""
    scale: float
    """Factor on the points of the drawings."""
    inverse: InverseChoice
    """Inverse to fly with; `auto` takes what suits the robot's priors (see `held_way`), and its
    baseline if it has none."""
    horizon_s: float
    """Horizon of the inverse model that is learned from a zero prior."""
    learn: bool
    """Whether the online Gaussian process learns in flight."""
    guarded: bool
    """Whether the guard may withdraw the inverse in flight."""
    rich_flight_s: float | None
    """Duration of a rich flight before the drawings, from which the robot learns more of itself;
    None for none, unless nothing is known of it and its guard needs to know."""
    live: bool
    """Whether to serve the recording to live viewers."""
    rehearses: bool = True
    """Whether the robot is asked what error it expects of each path before it flies."""


def track_and_print(command: TrackCommand) -> None:
    """Track the drawings, with progress on stderr and, if wanted, the document on stdout.

    Raises:
        RobotError: The robot did not finish a path.
    """
    result = carried_out(command, track)
    if result is None:
        return
    if command.as_json:
        click.echo(result.document())
    failed = next((flight for flight in result.flights if flight.failure is not None), None)
    if failed is not None:
        raise RobotError(f"{command.target} did not finish {failed.drawing}: {failed.failure}")


def track(command: TrackCommand, console: Console) -> TrackResult:
    """Track the drawings and return the flights, as stored in the run's folder.

    A path that the robot did not finish is in the result, with the reason.

    Raises:
        InvalidInputError: A drawing cannot be flown, the robot does not have that inverse, or it is
            real and may not move.
        OnlyPlannedError: The command only plans.
        LeaseHeldError: The robot belongs to another orchestrator.
    """
    drawings = read_drawings(command.drawings)
    with FlyingRun(command, console) as run:
        fleet, name, there = run.reach(command.fleet())
        check_robots((command.target,), there)
        target = fleet.describe(command.target)
        legs = legs_of(drawings, (command.speed,), target, scale=command.scale)
        ranking = latest_ranking(command.runs_root, run.repository.studies, name, command.target)
        inverse = _inverse(command, target, ranking)
        run.fly(
            "track",
            {target.robot: target},
            lambda: _outlook(command, target, inverse, legs),
            live=command.live,
        )
        run.configure({"kind": "track", **asdict(command)})
        for leg in legs:
            run.console.print(f"{command.target} will fly {leg.extent_text(target.spec)}")
        _learn_first(inverse, command, run)
        records = [_flown(run, command, target, inverse, leg) for leg in legs]
        result = TrackResult(flights=tuple(records), run=str(run.folder.path))
        run.folder.write_document(TRACKING, result)
    return result


@dataclass(frozen=True)
class _Inverse:
    """An inverse to fly paths with."""

    name: str
    """Source of the prior, BASELINE, NO_PRIOR, OWN or MIXTURE."""
    corrects: bool
    """Whether it corrects the references of the baseline controller."""
    way: ForeseenWay
    """What the robot is asked for along every path."""


def _flown(
    run: FlyingRun, command: TrackCommand, target: Description, inverse: _Inverse, leg: Leg
) -> FlightRecord:
    kept, label = KeptFlights(run), leg.label(inverse.name)
    kept.begins(target.robot, label, target.spec)
    known_s = run.connection.fleet.describe(target.robot).least_known_s
    if command.rehearses:
        say_expected(run, target, inverse.way, leg, inverse.name)
    flight = run.pilot.along(target.robot, inverse.way, leg.desired, label)
    kept.ended(flight)
    # A reference that follows the measured output carries its noise, which would bias a response.
    known_ahead = inverse.name in (BASELINE, OWN) and not flight.details.mean.any()
    if known_ahead and flight.details.taken_back is None:
        fleet, came_from = run.connection.name, run.folder.path.name
        keep_flight_responses(run.repository, fleet, target, flight, came_from)
    if flight.details.way is not None:
        run.console.print(f"{target.robot}: {flight.details.way}")
    for finding in flight.details.findings:
        run.console.print(f"[yellow]{target.robot}: {finding}[/]")
    return flight_record(flight, inverse.name, leg, known_s)


def _outlook(
    command: TrackCommand, target: Description, inverse: _Inverse, legs: Sequence[Leg]
) -> Outlook:
    """Return what the robot is going to fly."""
    first_s = command.rich_flight_s
    if first_s is None and inverse.corrects and command.guarded and not target.baseline_known:
        first_s = FIRST_FLIGHT_S
    first = () if first_s is None else (rich_motion(target, duration_s=first_s, seed=0),)
    along = (path_motion(target, leg, corrected=inverse.corrects) for leg in legs)
    return Outlook(headline=f"{target.robot} flies with {inverse.name}", motions=(*first, *along))


def _learn_first(inverse: _Inverse, command: TrackCommand, run: FlyingRun) -> None:
    """Have the robot fly what was asked for, or what its guard must know, before the drawings."""
    if command.rich_flight_s is not None:
        run.console.print(f"{command.target} flies for {command.rich_flight_s:.0f} s first")
        run.pilot.rich(command.target, duration_s=command.rich_flight_s, seed=0)
    elif inverse.corrects and command.guarded:
        know_itself(run.connection.fleet, run.pilot, command.target, seed=0, say=run.console.print)


def _inverse(command: TrackCommand, target: Description, ranking: Ranking | None) -> _Inverse:
    """Return the inverse to fly with; raises InvalidInputError when the target does not have it."""
    robot, guarded = target.robot, command.guarded
    wanted, estimates = command.inverse, () if ranking is None else ranking.result.ranking
    if wanted == "auto" and target.priors:
        name, way = held_way(target.priors, ranking)
        flown = way.model_copy(update={"guarded": guarded, "learn": command.learn})
        return _Inverse(name, True, flown)
    if wanted in ("auto", "baseline"):
        return _Inverse(BASELINE, False, ForeseenWay(inverse="baseline"))
    if wanted == "own":
        return _Inverse(OWN, True, ForeseenWay(inverse="own", guarded=guarded))
    if wanted == "zero-prior":
        layout = _layout(command.horizon_s, target)
        way = ForeseenWay(inverse="zero-prior", layout=layout, guarded=guarded)
        return _Inverse(NO_PRIOR, True, way)
    prior = target.prior
    if prior is None:
        raise InvalidInputError(
            f"{robot} has no prior; give it one with `nufleet transfer --target {robot} "
            "--source best`"
        )
    learn = command.learn
    if wanted == "by-axis":
        by_axis = way_by_axis(target.priors, estimates)
        if by_axis is None:
            raise InvalidInputError(
                f"{robot} does not hold the experience of the closest source of every axis, or "
                "axes agree on it: rank over all axes, then use `nufleet transfer --source best`"
            )
        way = by_axis.model_copy(update={"guarded": guarded, "learn": learn})
        return _Inverse(BY_AXIS, True, way)
    if wanted == "mixture":
        psi = {one.robot: one.psi for one in estimates} or None
        mixture = mixture_of(target.priors, psi)
        way = ForeseenWay(inverse="mixture", mixture=mixture, guarded=guarded, learn=learn)
        return _Inverse(MIXTURE, True, way)
    way = ForeseenWay(inverse="prior", prior_sha256=prior.sha256, guarded=guarded, learn=learn)
    return _Inverse(prior.manifest.robot, True, way)


def _layout(horizon_s: float, target: Description) -> InverseLayout:
    """Return the layout of a feedback inverse with a horizon in seconds.

    Raises:
        InvalidInputError: The robot measures no states, or the horizon is too long for it.
    """
    if not target.state_names:
        raise InvalidInputError(
            f"robot {target.robot} measures its output alone, and learning from nothing needs its "
            "states: fly it with its model of itself, --inverse own, or transfer a preview to it"
        )
    sample_time_s = target.spec.sample_time_s
    longest_s = HORIZON_SAMPLES_MAX * sample_time_s
    if horizon_s > longest_s:
        raise InvalidInputError(
            f"a horizon of {horizon_s:g} s is too long for robot {target.robot}, whose sample is "
            f"{sample_time_s:g} s: choose at most {longest_s:g} s"
        )
    return InverseLayout(
        architecture="state",
        states=target.state_names,
        sample_time_s=sample_time_s,
        horizon_samples=max(1, round(horizon_s / sample_time_s)),
    )
