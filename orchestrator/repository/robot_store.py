"""Stores robots and their experiences."""

from __future__ import annotations

from sqlalchemy import Connection, select

from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.errors import UnknownRecordError
from nufleet.orchestrator.repository.records import ExperienceRecord, RobotRecord, StoredExperience
from nufleet.orchestrator.repository.rows import (
    experience_payload,
    experience_row,
    robot_record,
    stored_experience,
)
from nufleet.orchestrator.repository.tables import EXPERIENCES, ROBOTS, utc_now
from nufleet.orchestrator.repository.upsert import insert_new


class RobotStore:
    """The robots' descriptions of themselves and their learned experiences."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def describe(self, *records: RobotRecord) -> None:
        """Store the robots' current descriptions of themselves."""
        with self._database.write() as connection:
            for record in records:
                _describe(connection, record)

    def robots(self, fleet: str) -> tuple[RobotRecord, ...]:
        """Return the robots of a fleet, by name."""
        query = select(ROBOTS).where(ROBOTS.c.fleet == fleet).order_by(ROBOTS.c.robot)
        return tuple(map(robot_record, self._database.rows(query)))

    def named(self, robot: str) -> tuple[RobotRecord, ...]:
        """Return the robots of that name, by the name of their fleet."""
        query = select(ROBOTS).where(ROBOTS.c.robot == robot).order_by(ROBOTS.c.fleet)
        return tuple(map(robot_record, self._database.rows(query)))

    def add_experience(self, record: ExperienceRecord) -> str:
        """Store an experience that its robot has learned now, and return its sha256.

        An experience is stored once. One that was learned again, to the same bytes, has the run and
        the time of the last learning.

        Raises:
            MalformedMessageError: The bytes are not an experience.
            UnknownRecordError: Its robot was never described.
        """
        values = {**experience_row(record), "learned_at": utc_now()}
        with self._database.write() as connection:
            connection.execute(insert_new(connection, EXPERIENCES), values)
            connection.execute(
                EXPERIENCES.update()
                .where(EXPERIENCES.c.fleet == record.fleet, EXPERIENCES.c.sha256 == record.sha256)
                .values(values)
            )
        return record.sha256

    def experience(self, fleet: str, sha256: str) -> bytes:
        """Return the file of an experience, checked like one that a robot sent.

        Raises:
            UnknownRecordError: The fleet has no experience with that hash.
            DamagedRecordError: It is not what was stored.
        """
        query = select(EXPERIENCES).where(
            EXPERIENCES.c.fleet == fleet, EXPERIENCES.c.sha256 == sha256
        )
        row = self._database.row(query)
        if row is None:
            raise UnknownRecordError(f"fleet {fleet} has no experience {sha256}")
        return experience_payload(row)

    def experiences(self, fleet: str, robot: str | None = None) -> tuple[StoredExperience, ...]:
        """Return the experiences of a fleet or of one of its robots, those learned last first."""
        columns = [column for column in EXPERIENCES.c if column is not EXPERIENCES.c.payload]
        query = select(*columns).where(EXPERIENCES.c.fleet == fleet)
        if robot is not None:
            query = query.where(EXPERIENCES.c.robot == robot)
        query = query.order_by(EXPERIENCES.c.learned_at.desc(), EXPERIENCES.c.sha256)
        return tuple(map(stored_experience, self._database.rows(query)))


def _describe(connection: Connection, record: RobotRecord) -> None:
    key = {"fleet": record.fleet, "robot": record.robot}
    values = {
        "spec": record.spec.model_dump_json(),
        "boot_id": record.boot_id,
        "described_at": utc_now(),
    }
    connection.execute(insert_new(connection, ROBOTS), {**key, **values})
    connection.execute(
        ROBOTS.update()
        .where(ROBOTS.c.fleet == record.fleet, ROBOTS.c.robot == record.robot)
        .values(values)
    )
