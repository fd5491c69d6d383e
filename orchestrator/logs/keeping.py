"""Stores the responses found in flights and logs beside the responses of tests."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from nufleet.orchestrator.flights.pilot import PathFlight
from nufleet.orchestrator.logs.flown_response import FlownResponse, responses_of_flight
from nufleet.orchestrator.repository.records import (
    FlightCircumstances,
    Origin,
    ResponseRecord,
    RobotRecord,
)
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Description

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.repository import Repository


def flight_record(
    flown: FlownResponse,
    spec: RobotSpec,
    *,
    fleet: str,
    robot: str,
    origin: Origin,
    came_from: str,
    measured_at: datetime,
) -> ResponseRecord | None:
    """Return a response as it is stored; None if it claims nothing.

    Its id depends on the robot and on the estimates alone, so that the same flight is stored once.

    Args:
        flown: The response.
        spec: Spec of the robot at the time.
        fleet: Name of the fleet.
        robot: Name of the robot.
        origin: Whether nufleet flew it.
        came_from: Name of the run or the log.
        measured_at: Time of the flight, in UTC.
    """
    record = flown.record
    response = record.response
    if record.band_rad_s is None or response.flight is None or not response.quality.usable:
        return None
    arrays: tuple[FloatArray | ComplexArray, ...] = (response.omega_rad_s, response.z)
    content = [f"{fleet}/{robot}/{flown.axis}".encode(), *(part.tobytes() for part in arrays)]
    return ResponseRecord(
        fleet=fleet,
        robot=robot,
        axis=flown.axis,
        goal_id=f"{origin}.{hashlib.sha256(b'/'.join(content)).hexdigest()[:24]}",
        study_id=came_from,
        kind=spec.kind,
        measured_at=measured_at,
        response=response,
        origin=origin,
        flown=FlightCircumstances(
            spec=spec,
            band_rad_s=record.band_rad_s,
            flight=response.flight,
            duration_s=record.duration_s,
        ),
    )


def keep_flight_responses(
    repository: Repository, fleet: str, robot: Description, flight: PathFlight, run: str
) -> tuple[ResponseRecord, ...]:
    """Store the responses that a flight along a path gave, one for each axis that it moved.

    A flight that was not finished is left out: what ended it may have changed the robot.

    Args:
        repository: Repository to store them in.
        fleet: Name of the fleet.
        robot: Description of the robot that flew.
        flight: The flight.
        run: Name of the run that it belongs to.

    Returns:
        What was stored; axes whose reference had no power are missing.

    Raises:
        RepositoryError: A response cannot be stored.
    """
    if flight.failure is not None:
        return ()
    now = datetime.now(UTC)
    found = [
        flight_record(
            flown,
            robot.spec,
            fleet=fleet,
            robot=robot.robot,
            origin=Origin.FLIGHT,
            came_from=f"{run}: {flight.label}",
            measured_at=now,
        )
        for flown in responses_of_flight(flight, robot.spec)
    ]
    return _stored(repository, RobotRecord(fleet, robot.robot, robot.spec, robot.boot_id), found)


def _stored(
    repository: Repository, robot: RobotRecord, records: Iterable[ResponseRecord | None]
) -> tuple[ResponseRecord, ...]:
    kept = tuple(record for record in records if record is not None)
    if kept:
        repository.robots.describe(robot)
    for record in kept:
        repository.flights.add(record)
    return kept
