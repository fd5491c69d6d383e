"""Addresses of databases: their syntax, what is shown of them, and which prove their server."""

from __future__ import annotations

import os
from pathlib import Path

from sqlalchemy import URL, make_url
from sqlalchemy.exc import ArgumentError

from nufleet.orchestrator.repository.errors import RepositoryUrlError
from nufleet.shared.redaction import without_secrets
from nufleet.shared.wire.openness import is_this_machine

FILE_NAME = "nufleet.sqlite"


def default_url(runs: Path) -> str:
    """Return the address of the default repository for a folder of runs.

    The file lies in the same folder as the runs it describes, so that one option names both, a copy
    of the folder is complete, and two folders are independent of each other.
    """
    return f"sqlite:///{runs / FILE_NAME}"


def parse_url(address: str) -> URL:
    """Return the URL of a database.

    Args:
        address: URL of a database, or path of an SQLite file.

    Raises:
        RepositoryUrlError: The address is neither an SQLite file nor a PostgreSQL database.
    """
    expected = "expected a file, sqlite:///FILE or postgresql://USER@HOST/DATABASE"
    try:
        url = make_url(address) if ":" in address else URL.create("sqlite", database=address)
    except (ArgumentError, ValueError):
        # The message shows neither the address nor the cause: both may contain a password.
        raise RepositoryUrlError(f"the repository's address is not a URL; {expected}") from None
    if "@" in (url.host or ""):
        raise RepositoryUrlError(
            f"the repository's address has more than one @; write %40 for one in a password, or "
            f"leave the password to PGPASSFILE; {expected}"
        )
    if url.drivername in ("postgresql", "postgresql+psycopg"):
        return url.set(drivername="postgresql+psycopg")
    if url.drivername in ("sqlite", "sqlite+pysqlite") and url.database not in (
        None,
        "",
        ":memory:",
    ):
        return url
    raise RepositoryUrlError(f"{shown(url)}: {expected}")


def is_file(address: str) -> bool:
    """Return whether a database is a file, not a server; raises RepositoryUrlError."""
    return parse_url(address).get_backend_name() == "sqlite"


def name_of(address: str) -> str:
    """Return a database's address without a password; raises RepositoryUrlError."""
    return shown(parse_url(address))


def shown(url: URL) -> str:
    """Return a URL without its password."""
    return without_secrets(url.render_as_string(hide_password=True))


def check_proven(url: URL) -> None:
    """Check that the address of a server on another machine says whether the server proves itself.

    PostgreSQL's own default takes any server, without encryption if that offers none.

    Raises:
        RepositoryUrlError: It does not say so.
    """
    if url.get_backend_name() == "sqlite" or "sslmode" in url.query or os.environ.get("PGSSLMODE"):
        return
    away = [host for host in _hosts(url) if not is_this_machine(host)]
    if away:
        raise RepositoryUrlError(
            f"{shown(url)}: another machine on the way to {away[0]} could pretend to be it; "
            "add ?sslmode=verify-full&sslrootcert=FILE with the certificate of the authority that "
            "signed the server's (deploy/README.md), or accept this with ?sslmode=prefer"
        )


def _hosts(url: URL) -> list[str]:
    """Return what libpq may connect to, by the URL or else by its environment, without sockets."""

    def first(*given: str | tuple[str, ...] | None) -> list[str]:
        found = next((one for one in given if one), ())
        return ",".join((found,) if isinstance(found, str) else found).split(",")

    query, environment = url.query.get, os.environ.get
    hosts = first(query("host"), url.host, environment("PGHOST"))
    if hosts == [""]:
        hosts = first(query("service"), environment("PGSERVICE"))
    hosts += first(query("hostaddr"), environment("PGHOSTADDR"))
    # With several hosts, each may have its port.
    hosts = [host.partition(":")[0] if host.count(":") == 1 else host for host in hosts]
    return [host for host in hosts if host and not host.startswith(("/", "@"))]
