"""Databases to test against: a new SQLite file, and a new database on a real PostgreSQL server."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from postgresql_server import PostgresqlServer, running_server
from repository_records import FLEET, SPEC, STUDY

from nufleet.orchestrator.repository.records import RobotRecord
from nufleet.orchestrator.repository.repository import Repository, open_repository


@pytest.fixture(scope="session")
def server() -> Iterator[PostgresqlServer]:
    with running_server() as running:
        yield running


@pytest.fixture(params=["sqlite", "postgresql"])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """The address of an empty database."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/nufleet.sqlite"
    running: PostgresqlServer = request.getfixturevalue("server")
    return running.empty_database()


@pytest.fixture
def repository(address: str) -> Iterator[Repository]:
    with open_repository(address) as opened:
        yield opened


@pytest.fixture
def begun(repository: Repository) -> Repository:
    """A repository with two robots and a study that has asked nothing yet."""
    for robot in ("target", "source"):
        repository.robots.describe(RobotRecord(FLEET, robot, SPEC, "boot-1"))
    repository.studies.begin(STUDY)
    return repository
