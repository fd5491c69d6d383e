"""A real PostgreSQL server of the tests' own, as an unprivileged user on a socket in a folder."""

from __future__ import annotations

import os
import pwd
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psycopg
from lifeline import RUN
from polling import PATIENCE_S

MISSING = "PostgreSQL's server is not installed; install it with: apt-get install -y postgresql"


@dataclass(frozen=True)
class PostgresqlServer:
    """A server that runs; its only user is `nufleet`, who needs no password."""

    folder: Path
    process: subprocess.Popen[bytes]

    def empty_database(self) -> str:
        """Empty the server's database and return its address.

        A database for each test would mean writing 8 MB each; one still in use is detected.
        """
        with psycopg.connect(self.connection(), autocommit=True) as connection:
            connection.execute(f"SET lock_timeout = '{PATIENCE_S:g}s'")
            connection.execute("DROP SCHEMA public CASCADE")
            connection.execute("CREATE SCHEMA public")
        return f"postgresql://nufleet@/postgres?host={self.folder}"

    def connection(self) -> str:
        return f"host={self.folder} user=nufleet dbname=postgres"


def binaries() -> Path:
    """Return the folder of the newest server installed."""
    on_path = shutil.which("initdb")
    found = [Path(on_path)] if on_path else []
    debian = Path("/usr/lib/postgresql").glob("*/bin/initdb")
    found += sorted(debian, key=lambda path: int(path.parts[-3]), reverse=True)
    if not found:
        raise RuntimeError(MISSING)
    return found[0].parent


@contextmanager
def running_server() -> Iterator[PostgresqlServer]:
    """A server from an empty folder to its end; nothing of it is left."""
    here = binaries()
    # Not in pytest's folder: that is closed to everybody but who runs the tests.
    with tempfile.TemporaryDirectory(prefix="postgresql-", dir=os.environ[RUN]) as name:
        folder = Path(name)
        as_user: list[str] = []
        if os.geteuid() == 0:
            user = pwd.getpwnam("postgres")  # the package makes it; the server refuses to be root
            os.chown(folder, user.pw_uid, user.pw_gid)
            ids = [f"--reuid={user.pw_uid}", f"--regid={user.pw_gid}", "--clear-groups"]
            as_user = ["setpriv", *ids]
        data = folder / "data"
        settings = ["-U", "nufleet", "-A", "trust", "-E", "UTF8", "--no-sync", "--no-instructions"]
        made = subprocess.run(
            [*as_user, here / "initdb", "-D", data, *settings],
            cwd=folder,
            capture_output=True,
            text=True,
        )
        assert made.returncode == 0, made.stderr
        options = ["-k", str(folder), "-c", "listen_addresses=", "-c", "fsync=off"]
        log = folder / "log"
        with log.open("wb") as output:
            process = subprocess.Popen(
                [*as_user, here / "postgres", "-D", data, *options],
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
            )
        server = PostgresqlServer(folder, process)
        try:
            wait_until_ready(server, log)
            yield server
        finally:
            process.send_signal(signal.SIGINT)
            code = process.wait(PATIENCE_S)
        assert code == 0, log.read_text()
        assert not list(folder.glob(".s.PGSQL*")), "the server left its socket"


def wait_until_ready(server: PostgresqlServer, log: Path) -> None:
    deadline_s = time.monotonic() + PATIENCE_S
    while True:
        try:
            psycopg.connect(server.connection()).close()
        except psycopg.OperationalError:
            alive = server.process.poll() is None
            assert alive, log.read_text()
            assert time.monotonic() < deadline_s, log.read_text()
            time.sleep(0.02)
        else:
            return
