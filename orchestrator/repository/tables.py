"""The tables of the newest schema for SQLAlchemy; migrations bring databases to this schema.

Numbers that must survive bit for bit are stored in blobs or in JSON, because SQLite turns NaN into
NULL.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    DateTime,
    Double,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    Table,
    Text,
    TypeDecorator,
    UniqueConstraint,
)
from sqlalchemy.schema import SchemaItem


class Sentence(TypeDecorator[str]):
    """Arbitrary text for people, also with NUL or lone surrogates, which PostgreSQL rejects."""

    impl = Text
    cache_ok = True

    def process_bind_param(self, value: str | None, dialect: Any) -> str | None:
        """Return the text as JSON, which escapes both."""
        return None if value is None else json.dumps(value)

    def process_result_value(self, value: str | None, dialect: Any) -> str | None:
        """Return the text that was stored."""
        return None if value is None else str(json.loads(value))


def utc_now() -> datetime:
    """Return the wall time for people, in UTC but without a time zone, as the tables hold it."""
    return datetime.now(UTC).replace(tzinfo=None)


REVISION = "0007"
"""Revision of the newest migration, which arrives at the tables below."""

METADATA = MetaData(
    naming_convention={
        "ix": "ix_%(column_0_N_label)s",
        "uq": "uq_%(table_name)s_%(column_0_N_name)s",
        "fk": "fk_%(table_name)s_%(column_0_N_name)s",
        "pk": "pk_%(table_name)s",
    }
)

ROBOTS = Table(
    "robots",
    METADATA,
    Column("fleet", Text, primary_key=True),
    Column("robot", Text, primary_key=True),
    Column("spec", Text, nullable=False),
    Column("boot_id", Text, nullable=False),
    Column("described_at", DateTime, nullable=False),
)

STUDIES = Table(
    "studies",
    METADATA,
    Column("study_id", Text, primary_key=True),
    Column("fleet", Text, nullable=False),
    Column("algorithm", Text, nullable=False),
    Column("plan", Text, nullable=False),
    Column("seed", Text, nullable=False),
    Column("parameters", Text, nullable=False),
    Column("status", Text, nullable=False),
    Column("reason", Sentence, nullable=False),
    Column("begun_at", DateTime, nullable=False),
    Column("result", Text),
)

TRIALS = Table(
    "trials",
    METADATA,
    Column("goal_id", Text, primary_key=True),
    Column("study_id", Text, ForeignKey("studies.study_id"), nullable=False),
    Column("iteration", Integer, nullable=False),
    Column("robot", Text, nullable=False),
    Column("attempt", Integer, nullable=False),
    Column("excitation", Text, nullable=False),
    Column("epoch", BigInteger, nullable=False),
    Column("status", Text, nullable=False),
    Column("boot_id", Text),
    Column("plan", Text),
    Column("outcome", Text),
    Column("reason", Sentence, nullable=False),
    Column("retry", Text),
    Column("robot_time_s", Double, nullable=False),
    Column("intended_at", DateTime, nullable=False),
    Column("ended_at", DateTime),
    Column("interrupted", Boolean),
    UniqueConstraint("study_id", "iteration", "robot", "attempt"),
)


def _response_columns() -> tuple[SchemaItem, ...]:
    """Return what the tables of responses from tests and from flights have in common."""
    return (
        Column("fleet", Text, nullable=False),
        Column("robot", Text, nullable=False),
        Column("axis", Text, nullable=False),
        Column("tones", Integer, nullable=False),
        Column("omega_rad_s", LargeBinary, nullable=False),
        Column("z", LargeBinary, nullable=False),
        Column("variance", LargeBinary, nullable=False),
        Column("segments", Integer, nullable=False),
        Column("quality", Text, nullable=False),
        Column("usable", Boolean, nullable=False),
        Column("measured_at", DateTime, nullable=False),
        Column("degrees", LargeBinary),
        Column("amplitude", Double),
        Column("hidden_variance", LargeBinary),
        ForeignKeyConstraint(["fleet", "robot"], ["robots.fleet", "robots.robot"]),
        Index(None, "fleet", "robot", "axis"),
    )


RESPONSES = Table(
    "responses",
    METADATA,
    Column("goal_id", Text, ForeignKey("trials.goal_id"), primary_key=True),
    Column("kind", Text),
    *_response_columns(),
)

MATRICES = Table(
    "matrices",
    METADATA,
    Column("goal_id", Text, ForeignKey("responses.goal_id"), primary_key=True),
    Column("axes", Text, nullable=False),
    Column("all_omega_rad_s", LargeBinary, nullable=False),
    Column("all_z", LargeBinary, nullable=False),
    Column("all_variances", LargeBinary, nullable=False),
    Column("all_degrees", LargeBinary, nullable=False),
    Column("correlation", LargeBinary, nullable=False),
    Column("all_hidden_variances", LargeBinary),
)
"""Every entry of the response of a test of several axes, whose first axis is in `responses`."""

FLIGHT_RESPONSES = Table(
    "flight_responses",
    METADATA,
    Column("goal_id", Text, primary_key=True),
    Column("origin", Text, nullable=False),
    Column("came_from", Sentence, nullable=False),
    Column("circumstances", Text, nullable=False),
    *_response_columns(),
)

SAMPLES = Table(
    "samples",
    METADATA,
    Column("goal_id", Text, ForeignKey("trials.goal_id"), primary_key=True),
    Column("samples", Integer, nullable=False),
    Column("reference", LargeBinary, nullable=False),
    Column("response", LargeBinary, nullable=False),
)

EXPERIENCES = Table(
    "experiences",
    METADATA,
    Column("fleet", Text, primary_key=True),
    Column("sha256", Text, primary_key=True),
    Column("robot", Text, nullable=False),
    Column("architecture", Text, nullable=False),
    Column("manifest", Text, nullable=False),
    Column("run", Text, nullable=False),
    Column("size_bytes", BigInteger, nullable=False),
    Column("payload", LargeBinary, nullable=False),
    Column("learned_at", DateTime, nullable=False),
    ForeignKeyConstraint(["fleet", "robot"], ["robots.fleet", "robots.robot"]),
    Index(None, "fleet", "robot"),
)

LEASES = Table(
    "leases",
    METADATA,
    Column("fleet", Text, primary_key=True),
    Column("robot", Text, primary_key=True),
    Column("owner", Text),
    Column("epoch", BigInteger, nullable=False),
    Column("term_s", Double, nullable=False),
    Column("expires_s", Double, nullable=False),
)
