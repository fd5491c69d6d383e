"""Stores the responses found in flights and logs beside the responses of tests."""

from __future__ import annotations

import hashlib
from datetime import UTC, datetime
from typing import TYPE_CHECKING

from nufleet.orchestrator.flights.pilot import PathFlight
from nufleet.orchestrator.logs.flown_response import responses_of_flight
from nufleet.orchestrator.repository.records import (
    FlightCircumstances,
    Origin,
    ResponseRecord,
    RobotRecord,
)
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.record_response import RecordResponse
from nufleet.shared.wire.messages import Description

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.repository import Repository


def flight_record(
    found: RecordResponse,
    fleet: str,
    robot: Description,
    axis: str,
    *,
    origin: Origin,
    came_from: str,
    measured_at: datetime,
) -> ResponseRecord | None:
    """Return a response as it is stored; None if it claims nothing.

    Its id depends on the robot and on the estimates alone, so that the same flight is stored once.

    Args:
        found: Response to store.
        fleet: Name of the fleet.
        robot: Description of the robot at the time.
        axis: Name of the axis.
        origin: Whether nufleet flew it.
        came_from: Name of the run or the log.
        measured_at: Time of the flight, in UTC.
    """
    response, band_rad_s = found.response, found.band_rad_s
    if band_rad_s is None or response.flight is None or not response.quality.usable:
        return None
    arrays: tuple[FloatArray | ComplexArray, ...] = (response.omega_rad_s, response.z)
    content = [f"{fleet}/{robot.robot}/{axis}".encode(), *(part.tobytes() for part in arrays)]
    return ResponseRecord(
        fleet=fleet,
        robot=robot.robot,
        axis=axis,
        goal_id=f"{origin}.{hashlib.sha256(b'/'.join(content)).hexdigest()[:24]}",
        study_id=came_from,
        kind=robot.spec.kind,
        measured_at=measured_at,
        response=response,
        origin=origin,
        flown=FlightCircumstances(robot.spec, band_rad_s, response.flight, found.duration_s),
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
        flight: Flight along the path.
        run: Name of the run that it belongs to.

    Returns:
        What was stored; axes whose reference had no power are missing.

    Raises:
        RepositoryError: A response cannot be stored.
    """
    if flight.failure is not None:
        return ()
    came_from, now = f"{run}: {flight.label}", datetime.now(UTC)
    records = [
        flight_record(
            found, fleet, robot, axis, origin=Origin.FLIGHT, came_from=came_from, measured_at=now
        )
        for axis, found in responses_of_flight(flight, robot.spec).items()
    ]
    kept = tuple(record for record in records if record is not None)
    if kept:
        repository.robots.describe(RobotRecord.of(fleet, robot))
    for record in kept:
        repository.flights.add(record)
    return kept
