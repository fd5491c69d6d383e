"""Stores robots and their experiences."""

from __future__ import annotations

from sqlalchemy import Connection, select

from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.errors import UnknownRecordError
from nufleet.orchestrator.repository.records import ExperienceRecord, ExperienceSummary, RobotRecord
from nufleet.orchestrator.repository.rows import (
    experience_record,
    experience_summary,
    json_object,
    robot_record,
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
        with self._database.read() as connection:
            return tuple(robot_record(row) for row in connection.execute(query).mappings())

    def add_experience(self, record: ExperienceRecord) -> str:
        """Store an experience and return its sha256; the same bytes again change nothing.

        Raises:
            UnknownRecordError: Its robot was never described.
        """
        sha256 = record.sha256
        values = {
            "sha256": sha256,
            "fleet": record.fleet,
            "robot": record.robot,
            "manifest": json_object(record.manifest),
            "size_bytes": len(record.data),
            "data": record.data,
            "stored_at": utc_now(),
        }
        with self._database.write() as connection:
            connection.execute(insert_new(connection, EXPERIENCES, values))
        return sha256

    def experience(self, sha256: str) -> ExperienceRecord:
        """Return an experience with its bytes.

        Raises:
            UnknownRecordError: There is no experience with that digest.
            DamagedRecordError: Its bytes have changed.
        """
        query = select(EXPERIENCES).where(EXPERIENCES.c.sha256 == sha256)
        with self._database.read() as connection:
            row = connection.execute(query).mappings().one_or_none()
        if row is None:
            raise UnknownRecordError(f"there is no experience {sha256}")
        return experience_record(row)

    def experiences(self, fleet: str) -> tuple[ExperienceSummary, ...]:
        """Return the experiences of a fleet without their bytes, by robot, oldest first."""
        columns = [column for column in EXPERIENCES.c if column is not EXPERIENCES.c.data]
        query = (
            select(*columns)
            .where(EXPERIENCES.c.fleet == fleet)
            .order_by(EXPERIENCES.c.robot, EXPERIENCES.c.stored_at, EXPERIENCES.c.sha256)
        )
        with self._database.read() as connection:
            return tuple(experience_summary(row) for row in connection.execute(query).mappings())


def _describe(connection: Connection, record: RobotRecord) -> None:
    key = {"fleet": record.fleet, "robot": record.robot}
    values = {
        "spec": record.spec.model_dump_json(),
        "boot_id": record.boot_id,
        "described_at": utc_now(),
    }
    connection.execute(insert_new(connection, ROBOTS, {**key, **values}))
    connection.execute(
        ROBOTS.update()
        .where(ROBOTS.c.fleet == record.fleet, ROBOTS.c.robot == record.robot)
        .values(values)
    )
