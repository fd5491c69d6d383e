"""A repository on another machine is reached by an encrypted link to a server that is proven."""

from __future__ import annotations

from pathlib import Path

import pytest
from postgresql_server import PostgresqlServer, certified
from sqlalchemy import text

from nufleet.orchestrator.repository.database import Database, parse_url
from nufleet.orchestrator.repository.errors import RepositoryUnreachableError


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
