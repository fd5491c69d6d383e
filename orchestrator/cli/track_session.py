"""What `nufleet track` does: check the paths, fly them, say how well."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import click

from orchestrator.cli.reach import KeptFlights, Reach, Session, flying
from orchestrator.console import stderr_console
from orchestrator.evaluation import flight_record
from orchestrator.evaluation_results import FlightRecord
from orchestrator.experience_learning import FLIGHT_S
from orchestrator.flight_labels import BASELINE, NO_PRIOR
from orchestrator.paths import Leg, legs_of
from orchestrator.pilot import PathFlight
from orchestrator.preflight import check_robots
from shared.arrays import FloatArray
from shared.errors import InvalidInputError, RobotError
from shared.inverse_layout import InverseLayout
from shared.messages import Description


@dataclass(frozen=True)
class TrackCommand:
    """The command line of one tracking."""

    connect: str
    fleet_name: str | None
    target: str
    drawings: tuple[str, ...]
    speed: float
    scale: float
    inverse: Literal["auto", "prior", "zero-prior", "baseline"]
    horizon_s: float
    learn: bool
    guarded: bool
    live: bool
    runs_root: Path
    as_json: bool


def track_and_print(command: TrackCommand) -> None:
    """Track, with progress on stderr and, when asked for, the document on stdout."""
    console = stderr_console()
    reach = Reach(None, command.connect, command.fleet_name)
    with flying(reach, "track", command.runs_root, console, live=command.live) as session:
        check_robots((command.target,), session.connection.robots)
        target = session.connection.fleet.describe(command.target)
        legs = legs_of(command.drawings, (command.speed,), target, scale=command.scale)
        name, fly = _flight(command, session, target)
        configuration = asdict(command) | {"runs_root": str(command.runs_root)}
        session.folder.write_configuration({"kind": "track", **configuration})
        records = [_flown(session, target, name, leg, fly) for leg in legs]
        (session.folder.path / "track.json").write_text(
            json.dumps(_document(records, session), indent=2) + "\n", encoding="utf-8"
        )
    if command.as_json:
        click.echo(json.dumps(_document(records, session)))
    failed = next((record for record in records if record.failure is not None), None)
    if failed is not None:
        raise RobotError(f"{command.target} did not finish {failed.drawing}: {failed.failure}")


def _flown(
    session: Session,
    target: Description,
    name: str,
    leg: Leg,
    fly: Callable[[FloatArray, str], PathFlight],
) -> FlightRecord:
    kept, label = KeptFlights(session), leg.label(name)
    kept.begins(target.robot, label, target.spec)
    flight = fly(leg.desired, label)
    kept.ended(flight)
    return flight_record(flight, name, leg)


def _flight(
    command: TrackCommand, session: Session, target: Description
) -> tuple[str, Callable[[FloatArray, str], PathFlight]]:
    """Return what gives the prior, and how one path is flown with it."""
    robot, pilot = target.robot, session.pilot
    inverse = command.inverse
    if inverse == "auto":
        inverse = "baseline" if target.prior is None else "prior"
    if inverse == "baseline":
        return BASELINE, partial(pilot.baseline, robot)
    if command.guarded and not target.baseline_known:
        session.console.print(
            f"{robot} flies for {FLIGHT_S:.0f} s first, so that its guard knows its baseline"
        )
        pilot.rich(robot, duration_s=FLIGHT_S, seed=0)
    if inverse == "zero-prior":
        layout = InverseLayout(
            architecture="state",
            states=target.state_names,
            sample_time_s=target.spec.sample_time_s,
            horizon_samples=max(1, round(command.horizon_s / target.spec.sample_time_s)),
        )
        return NO_PRIOR, partial(pilot.zero_prior, robot, layout=layout, guarded=command.guarded)
    if target.prior is None:
        raise InvalidInputError(
            f"{robot} has no prior; give it one with `nufleet transfer --target {robot} "
            "--source best`"
        )
    return target.prior.manifest.robot, partial(
        pilot.with_prior,
        robot,
        sha256=target.prior.sha256,
        guarded=command.guarded,
        learn=command.learn,
    )


def _document(records: list[FlightRecord], session: Session) -> dict[str, object]:
    return {
        "schema": 1,
        "flights": [record.model_dump(mode="json") for record in records],
        "run": str(session.folder.path),
    }
