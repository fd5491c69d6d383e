"""Brings a database to the schema that this nufleet knows, and refuses one that is newer."""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.script import ScriptDirectory
from sqlalchemy import text

from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.errors import SchemaVersionError

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
    config = Config()
    config.set_main_option("script_location", str(migrations).replace("%", "%%"))
    scripts = ScriptDirectory.from_config(config)
    newest = scripts.get_current_head()
    known = {script.revision for script in scripts.walk_revisions()}
    with database.write() as connection:
        if not database.is_sqlite:
            connection.execute(text("SELECT pg_advisory_xact_lock(:key)"), {"key": _ADVISORY_LOCK})
        found = MigrationContext.configure(connection).get_current_revision()
        if found == newest:
            return
        if found is not None and found not in known:
            raise SchemaVersionError(
                f"repository {database.name} has schema version {found}, but this version of "
                f"nufleet knows none above {newest}; install the version that wrote it, or a "
                "newer one"
            )
        config.attributes["connection"] = connection
        command.upgrade(config, "head")
