"""Stores the responses of flights and logs, beside those of tests."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC

from pydantic import TypeAdapter
from sqlalchemy import RowMapping, select

from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.errors import UnknownRecordError
from nufleet.orchestrator.repository.records import FlightCircumstances, Origin, ResponseRecord
from nufleet.orchestrator.repository.rows import checked, frequency_response, response_row
from nufleet.orchestrator.repository.tables import FLIGHT_RESPONSES, ROBOTS
from nufleet.orchestrator.repository.upsert import insert_new

_CIRCUMSTANCES = TypeAdapter(FlightCircumstances)


class FlightStore:
    """The responses that no test measured."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def add(self, record: ResponseRecord) -> bool:
        """Store a response, and return whether it is new; the same id again changes nothing.

        Raises:
            UnknownRecordError: Its robot was never described.
        """
        flown = record.flown
        if flown is None:
            raise ValueError("the response of a test is stored with its study")
        values = {
            "goal_id": record.goal_id,
            "fleet": record.fleet,
            "robot": record.robot,
            "axis": record.axis,
            "origin": record.origin,
            "came_from": record.study_id,
            "circumstances": _CIRCUMSTANCES.dump_json(flown).decode(),
            "measured_at": record.measured_at.astimezone(UTC).replace(tzinfo=None),
            **response_row(record.response),
        }
        described = select(ROBOTS.c.robot).where(
            ROBOTS.c.fleet == record.fleet, ROBOTS.c.robot == record.robot
        )
        with self._database.write() as connection:
            if connection.execute(described).one_or_none() is None:
                raise UnknownRecordError(
                    f"robot {record.robot} of fleet {record.fleet} is not described"
                )
            added = connection.execute(insert_new(connection, FLIGHT_RESPONSES), values)
            return added.rowcount == 1

    def responses(
        self, fleet: str, robot: str, axis: str, *, usable: bool = True
    ) -> tuple[ResponseRecord, ...]:
        """Return the responses of a robot's axis from flights and logs, oldest first.

        Args:
            fleet: Name of the fleet.
            robot: Name of the robot.
            axis: Name of the axis.
            usable: Whether to return the usable responses or, instead, the unusable ones.
        """
        columns = FLIGHT_RESPONSES.c
        query = (
            select(FLIGHT_RESPONSES)
            .where(columns.fleet == fleet, columns.robot == robot, columns.axis == axis)
            .where(columns.usable == usable)
            .order_by(columns.measured_at, columns.goal_id)
        )
        return tuple(map(_record, self._database.rows(query)))


def flown_response(database: Database, response_id: str) -> ResponseRecord | None:
    """Return the response of a flight or log; None if there is none of that id."""
    query = select(FLIGHT_RESPONSES).where(FLIGHT_RESPONSES.c.goal_id == response_id)
    row = database.row(query)
    return None if row is None else _record(row)


def _record(row: RowMapping) -> ResponseRecord:
    with checked(f"the response {row['goal_id']}"):
        flown = _CIRCUMSTANCES.validate_json(row["circumstances"])
        origin = Origin(row["origin"])
    return ResponseRecord(
        fleet=row["fleet"],
        robot=row["robot"],
        axis=row["axis"],
        goal_id=row["goal_id"],
        study_id=row["came_from"],
        kind=flown.spec.kind,
        measured_at=row["measured_at"].replace(tzinfo=UTC),
        response=replace(frequency_response(row), flight=flown.flight),
        origin=origin,
        flown=flown,
    )
