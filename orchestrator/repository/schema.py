"""Brings a database to the schema that this nufleet knows, and refuses one that is newer."""

from __future__ import annotations

from pathlib import Path

from sqlalchemy import Connection, inspect, text

from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.tables import METADATA, REVISION

MIGRATIONS = Path(__file__).with_name("migrations")

_ADVISORY_LOCK = 0x6E75666C656574
"""Key of the lock that is held while the schema is read and changed: `nufleet` in ASCII."""


def migrate(database: Database, migrations: Path = MIGRATIONS) -> None:
    """Bring a database to the newest schema in `migrations`, in one transaction.

    When several processes open an empty database at the same time, exactly one creates its tables.

    Raises:
        SchemaVersionError: The database has a schema that is not among them.
        RepositoryError: The database cannot be reached or written.
    """
    with database.write() as connection:
        if not database.is_sqlite:
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _ADVISORY_LOCK})
        found = _revision(connection)
        if migrations == MIGRATIONS and found in (None, REVISION):
            if found is None:
                _create(connection)
            return
        # Alembic takes a quarter of a second to load, which few commands ever need.
        from nufleet.orchestrator.repository.migration import upgrade

        upgrade(connection, found, migrations, database.name)


def _revision(connection: Connection) -> str | None:
    """Return the revision of a database's schema, where Alembic notes it; None if it is empty."""
    if not inspect(connection).has_table("alembic_version"):
        return None
    found = connection.execute(text("SELECT version_num FROM alembic_version")).scalar_one_or_none()
    return None if found is None else str(found)


def _create(connection: Connection) -> None:
    """Make the newest tables, and note their revision as Alembic does."""
    METADATA.create_all(connection)
    connection.execute(
        text(
            "CREATE TABLE alembic_version (version_num VARCHAR(32) NOT NULL, "
            "CONSTRAINT alembic_version_pkc PRIMARY KEY (version_num))"
        )
    )
    connection.execute(
        text("INSERT INTO alembic_version (version_num) VALUES (:found)"), {"found": REVISION}
    )
