"""Opening: schemas that are older, newer and the same, and databases that cannot be used."""

from __future__ import annotations

import os
import shutil
import stat
import subprocess
import sys
from pathlib import Path

import psycopg
import pytest
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from learned_things import experience
from polling import PATIENCE_S, wait_until
from postgresql_server import PostgresqlServer
from repository_records import FLEET, SPEC, STUDY
from sqlalchemy import create_engine

from nufleet.orchestrator.repository import database
from nufleet.orchestrator.repository.address import default_url, parse_url
from nufleet.orchestrator.repository.errors import (
    DamagedRecordError,
    RepositoryError,
    RepositoryUnreachableError,
    RepositoryUrlError,
    SchemaVersionError,
)
from nufleet.orchestrator.repository.migration import upgrade
from nufleet.orchestrator.repository.records import ExperienceRecord, RobotRecord
from nufleet.orchestrator.repository.repository import open_repository
from nufleet.orchestrator.repository.schema import MIGRATIONS
from nufleet.orchestrator.repository.tables import METADATA, REVISION

NEXT_SCHEMA = """
from alembic import op
import sqlalchemy as sa

revision = "newer"
down_revision = "0007"


def upgrade():
    op.add_column("studies", sa.Column("weather", sa.Text(), nullable=True))
    op.execute("UPDATE studies SET weather = 'indoors'")
"""
BROKEN_SCHEMA = NEXT_SCHEMA.replace("UPDATE studies", "UPDATE nothing")


@pytest.fixture
def newer(tmp_path: Path) -> Path:
    """The schemas of a nufleet that knows one more."""
    folder = tmp_path / "newer"
    shutil.copytree(MIGRATIONS, folder)
    (folder / "versions" / "next_schema.py").write_text(NEXT_SCHEMA)
    return folder


@pytest.mark.parametrize("migrated", [True, False], ids=["migrated", "created"])
def test_migrations_arrive_at_the_tables_that_the_code_uses_and_creates(
    address: str, migrated: bool
) -> None:
    if not migrated:
        open_repository(address).close()
    engine = create_engine(parse_url(address))
    with engine.begin() as connection:
        if migrated:
            upgrade(connection, None, MIGRATIONS, address)
        context = MigrationContext.configure(connection, opts={"compare_type": True})
        assert compare_metadata(context, METADATA) == []
        assert context.get_current_revision() == REVISION
    engine.dispose()


def test_opening_again_keeps_what_is_stored(address: str) -> None:
    with open_repository(address) as repository:
        repository.studies.begin(STUDY)
    with open_repository(address) as repository:
        assert repository.studies.studies() == (STUDY,)


def test_an_older_schema_is_brought_up_to_date_with_what_it_holds(
    address: str, newer: Path
) -> None:
    with open_repository(address) as repository:
        repository.studies.begin(STUDY)
    with open_repository(address, migrations=newer) as repository:
        assert repository.studies.studies() == (STUDY,)
    engine = create_engine(parse_url(address))
    with engine.connect() as connection:
        assert connection.exec_driver_sql("SELECT weather FROM studies").scalar() == "indoors"
    engine.dispose()


def test_an_unknown_newer_schema_is_refused_with_both_versions(address: str, newer: Path) -> None:
    open_repository(address, migrations=newer).close()
    with pytest.raises(SchemaVersionError, match=r"newer.*0007.*install"):
        open_repository(address)


def test_a_migration_that_fails_leaves_the_database_as_it_was(address: str, newer: Path) -> None:
    with open_repository(address) as repository:
        repository.studies.begin(STUDY)
    (newer / "versions" / "next_schema.py").write_text(BROKEN_SCHEMA)
    with pytest.raises(RepositoryError, match="nothing"):
        open_repository(address, migrations=newer)
    with open_repository(address) as repository:
        assert repository.studies.studies() == (STUDY,)


@pytest.mark.parametrize(
    "change",
    [
        "UPDATE robots SET spec = '{}'",
        "UPDATE studies SET plan = '[1'",
        "UPDATE studies SET status = 'odd'",
        "UPDATE studies SET seed = 'seven'",
        "UPDATE experiences SET architecture = 'odd'",
    ],
)
def test_an_altered_record_is_an_error_that_names_it(address: str, change: str) -> None:
    with open_repository(address) as repository:
        repository.robots.describe(RobotRecord(FLEET, "r1", SPEC, "boot-1"))
        repository.studies.begin(STUDY)
        repository.robots.add_experience(ExperienceRecord(FLEET, "run-1", experience("r1")))
        engine = create_engine(parse_url(address))
        with engine.begin() as connection:
            connection.exec_driver_sql(change)
        engine.dispose()
        with pytest.raises(DamagedRecordError, match=r"r1|run-1|[0-9a-f]{64}"):
            _ = (
                repository.robots.robots(FLEET),
                repository.studies.studies(),
                repository.robots.experiences(FLEET),
            )


def test_a_folder_of_runs_has_its_repository_in_it(tmp_path: Path) -> None:
    open_repository(default_url(tmp_path)).close()
    assert (tmp_path / "nufleet.sqlite").is_file()


@pytest.mark.parametrize(
    "address",
    [
        "mysql://u:secret@h/d",
        "mysql://u:se/secret@h/d",
        "mysql://h/d?password=secret",
        "postgresql://u:p@secret@h/d",
        "postgresql://u@h:secret/d",
        "postgresql:/u:secret@h/d",
        "sqlite://",
        "sqlite:///:memory:",
        "://",
        "oracle:x",
    ],
)
def test_an_address_of_no_database_is_refused_without_its_password(address: str) -> None:
    with pytest.raises(RepositoryUrlError, match="expected a file") as refused:
        parse_url(address)
    assert "secret" not in str(refused.value)


@pytest.mark.parametrize("scheme", ["postgresql", "postgresql+psycopg"])
def test_a_postgresql_address_is_served_by_psycopg(scheme: str) -> None:
    assert parse_url(f"{scheme}://me@host/lab").drivername == "postgresql+psycopg"


@pytest.mark.parametrize(
    "address",
    [
        "postgresql://me:secret@/lab?host={folder}",
        "postgresql://me:se/secret@/lab?host={folder}",
        "postgresql://me@/lab?host={folder}&password=secret",
    ],
)
def test_a_server_that_is_not_there_is_named_without_the_password(
    tmp_path: Path, address: str
) -> None:
    with pytest.raises(RepositoryUnreachableError, match="lab") as refused:
        open_repository(address.format(folder=tmp_path))
    assert "secret" not in str(refused.value)


def test_the_password_of_a_server_may_stand_in_the_file_that_pgpassfile_names(
    server: PostgresqlServer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    rules = server.folder / "data" / "pg_hba.conf"
    rules.write_text(f"local all careful scram-sha-256\n{rules.read_text()}")
    with psycopg.connect(server.connection(), autocommit=True) as connection:
        connection.execute("CREATE ROLE careful LOGIN SUPERUSER PASSWORD 'se/c@ret'")
        connection.execute("SELECT pg_reload_conf()")
        server.empty_database()
        address = f"postgresql://careful@/postgres?host={server.folder}&port={server.port}"

        def refused() -> bool:  # from the moment on at which the server has read its rules
            try:
                open_repository(address).close()
            except RepositoryUnreachableError as error:
                return "no password supplied" in str(error)
            return False

        wait_until(refused)
        kept = tmp_path / "pgpass"
        kept.write_text("*:*:*:careful:se/c@ret\n")
        kept.chmod(0o600)
        monkeypatch.setenv("PGPASSFILE", str(kept))
        with open_repository(address) as repository:
            assert repository.studies.studies() == ()
        server.empty_database()
        connection.execute("DROP OWNED BY careful; DROP ROLE careful")


def test_a_database_that_its_server_does_not_have_is_named(server: PostgresqlServer) -> None:
    with pytest.raises(RepositoryUnreachableError, match="missing"):
        open_repository(f"postgresql://nufleet@/missing?host={server.folder}&port={server.port}")


def test_a_file_that_is_no_database_is_refused_and_left_alone(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("not a database " * 100)
    before = path.read_bytes()
    with pytest.raises(RepositoryUnreachableError, match=r"notes\.txt"):
        open_repository(str(path))
    assert path.read_bytes() == before


def test_a_folder_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(RepositoryUnreachableError, match="missing"):
        open_repository(str(tmp_path / "missing" / "nufleet.sqlite"))


def in_a_small_filesystem(folder: Path, scenario: str) -> str:
    """Run a scenario of `disk_trouble.py` on a file system of 1 MiB; return its words."""
    script = Path(__file__).with_name("disk_trouble.py")
    mount = 'mount -t tmpfs -o size=1m small "$1" && exec "$2" "$3" "$1" "$4"'
    apart = ["unshare", "--mount", "--user", "--map-root-user"]
    done = subprocess.run(
        [*apart, "sh", "-c", mount, "sh", folder, sys.executable, script, scenario],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_a_full_disk_stores_no_intent_and_keeps_what_was_stored(tmp_path: Path) -> None:
    said = in_a_small_filesystem(tmp_path, "full")
    assert said.startswith("RepositoryFullError")
    assert "free some space" in said


def test_a_file_system_that_cannot_be_written_is_an_error_on_opening(tmp_path: Path) -> None:
    said = in_a_small_filesystem(tmp_path, "read-only")
    assert said.startswith(("RepositoryReadOnlyError", "RepositoryUnreachableError"))


def test_a_server_without_its_driver_is_refused_with_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(database, "find_spec", lambda name: None)
    with pytest.raises(RepositoryUrlError, match=r"nufleet\[repository\]"):
        open_repository("postgresql://me@127.0.0.1/none")


def test_a_database_of_measurements_is_its_users_alone(tmp_path: Path) -> None:
    with open_repository(f"{tmp_path}/nufleet.sqlite") as repository:
        repository.studies.studies()
        files = sorted(tmp_path.iterdir())
        assert [path.name for path in files] == [
            "nufleet.sqlite",
            "nufleet.sqlite-shm",
            "nufleet.sqlite-wal",
        ]
        assert {stat.S_IMODE(path.stat().st_mode) for path in files} == {0o600}
