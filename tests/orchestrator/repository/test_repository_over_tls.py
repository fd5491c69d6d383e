"""A repository on another machine is reached by an encrypted link to a server that is proven."""

from __future__ import annotations

from pathlib import Path

import pytest
from postgresql_server import PostgresqlServer, certified
from sqlalchemy import text

from nufleet.orchestrator.repository.address import check_proven, parse_url
from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.errors import RepositoryUnreachableError, RepositoryUrlError
from nufleet.orchestrator.repository.repository import open_repository


def asked(server: PostgresqlServer, host: str, **settings: object) -> str:
    """The version of TLS under which a server at this host is asked."""
    query = "&".join(f"{name}={value}" for name, value in settings.items())
    database = Database(parse_url(f"postgresql://nufleet@{host}:{server.port}/postgres?{query}"))
    try:
        with database.read() as connection:
            version = "SELECT version FROM pg_stat_ssl WHERE pid = pg_backend_pid()"
            return str(connection.execute(text(version)).scalar_one())
    finally:
        database.close()


def test_a_server_whose_certificate_is_verified_is_asked_over_tls(server: PostgresqlServer) -> None:
    proven = {"sslmode": "verify-full", "sslrootcert": server.authority}
    assert asked(server, "127.0.0.1", **proven) == "TLSv1.3"


def test_a_server_that_cannot_prove_its_name_is_not_asked(
    server: PostgresqlServer, tmp_path: Path
) -> None:
    certified(tmp_path)  # another authority of the same name
    for host, authority in (
        ("localhost", server.authority),
        ("127.0.0.1", tmp_path / "authority.pem"),
    ):
        with pytest.raises(RepositoryUnreachableError, match="certificate"):
            asked(server, host, sslmode="verify-full", sslrootcert=authority)


def test_a_server_with_hostssl_lines_alone_takes_no_link_without_tls(
    server: PostgresqlServer,
) -> None:
    with pytest.raises(RepositoryUnreachableError, match="no encryption"):
        asked(server, "127.0.0.1", sslmode="disable")


LOCAL = [
    ("lab.sqlite", {}),
    ("postgresql://me@/lab", {}),
    ("postgresql://me@/lab?host=/run/postgresql", {}),
    ("postgresql://me@localhost/lab", {}),
    ("postgresql://me@[::1]:5433/lab", {}),
    ("postgresql://me@/lab?host=127.0.0.1:5433&host=127.0.0.2", {}),
    ("postgresql://me@/lab", {"PGHOST": "/run/postgresql"}),
]
AWAY = [
    ("postgresql://me:secret@base/lab", {}),
    ("postgresql://me@192.168.1.10:5433/lab", {}),
    ("postgresql://me@[fd00::1]/lab", {}),
    ("postgresql://me@/lab?host=127.0.0.1&host=base:5433", {}),
    ("postgresql://me@localhost,base/lab", {}),
    ("postgresql://me@localhost/lab?hostaddr=192.168.1.10", {}),
    ("postgresql://me@/lab?service=lab", {}),
    ("postgresql://me@/lab", {"PGHOST": "base"}),
    ("postgresql://me@localhost/lab", {"PGHOSTADDR": "192.168.1.10"}),
    ("postgresql://me@/lab", {"PGSERVICE": "lab"}),
]


def environment(monkeypatch: pytest.MonkeyPatch, variables: dict[str, str]) -> None:
    for name in ("PGHOST", "PGHOSTADDR", "PGSERVICE", "PGSSLMODE"):
        monkeypatch.delenv(name, raising=False)
    for name, value in variables.items():
        monkeypatch.setenv(name, value)


@pytest.mark.parametrize(("address", "variables"), LOCAL)
def test_a_server_on_this_machine_needs_no_proof(
    address: str, variables: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    environment(monkeypatch, variables)
    check_proven(parse_url(address))


@pytest.mark.parametrize(("address", "variables"), AWAY)
def test_an_address_on_another_machine_says_whether_its_server_proves_itself(
    address: str, variables: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    environment(monkeypatch, variables)
    with pytest.raises(RepositoryUrlError, match="sslmode=verify-full&sslrootcert") as refused:
        open_repository(address)
    assert "secret" not in str(refused.value)
    for mode in ("verify-full", "prefer"):
        check_proven(parse_url(f"{address}{'&' if '?' in address else '?'}sslmode={mode}"))
        monkeypatch.setenv("PGSSLMODE", mode)
        check_proven(parse_url(address))
