"""Migrates a database that an older nufleet made. Loads Alembic."""

from __future__ import annotations

from pathlib import Path

from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from sqlalchemy import Connection

from nufleet.orchestrator.repository.errors import SchemaVersionError


def upgrade(connection: Connection, found: str | None, migrations: Path, name: str) -> None:
    """Bring a database to the newest schema, in the transaction of the connection.

    Args:
        connection: Connection with a transaction that may write.
        found: Revision of the database; None if it is empty.
        migrations: Folder with the known schemas.
        name: Name of the database, for the error.

    Raises:
        SchemaVersionError: The database has a schema that is not among them.
    """
    config = Config()
    config.set_main_option("script_location", str(migrations).replace("%", "%%"))
    scripts = ScriptDirectory.from_config(config)
    known = {script.revision for script in scripts.walk_revisions()}
    if found is not None and found not in known:
        raise SchemaVersionError(
            f"repository {name} has schema version {found}, but this version of nufleet knows none "
            f"above {scripts.get_current_head()}; install the version that wrote it, or a newer one"
        )
    config.attributes["connection"] = connection
    command.upgrade(config, "head")
