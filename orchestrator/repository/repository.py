"""The repository: one database that holds every durable fact of the orchestrators that share it."""

from __future__ import annotations

from pathlib import Path

from nufleet.orchestrator.repository.address import check_proven, parse_url
from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.flight_store import FlightStore
from nufleet.orchestrator.repository.lease_store import LeaseStore
from nufleet.orchestrator.repository.robot_store import RobotStore
from nufleet.orchestrator.repository.schema import MIGRATIONS, migrate
from nufleet.orchestrator.repository.study_store import StudyStore


class Repository:
    """The stores of one database; a context manager that many threads and processes may use."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self.robots = RobotStore(database)
        self.studies = StudyStore(database)
        self.flights = FlightStore(database)
        self.leases = LeaseStore(database)

    @property
    def name(self) -> str:
        """The database's address, without a password."""
        return self._database.name

    def __enter__(self) -> Repository:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close every connection."""
        self._database.close()


def open_repository(address: str, *, migrations: Path = MIGRATIONS) -> Repository:
    """Open a repository, create it if it is new, and bring its schema up to date.

    Args:
        address: File path, `sqlite:///FILE` or `postgresql://USER@HOST/DATABASE`.
        migrations: Folder with the known schemas.

    Raises:
        RepositoryUrlError: The address does not name a database, or one on another machine
            without saying whether that proves who it is.
        SchemaVersionError: The database was written by a newer nufleet.
        RepositoryError: The database cannot be reached, read or written.
    """
    url = parse_url(address)
    check_proven(url)
    database = Database(url)
    try:
        database.prepare()
        migrate(database, migrations)
    except BaseException:
        database.close()
        raise
    return Repository(database)
