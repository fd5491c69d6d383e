"""A real PostgreSQL server of the tests' own, as an unprivileged user on a socket in a folder.

It also listens on this machine's own network, where it serves no connection without TLS.
"""

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
from datetime import timedelta
from pathlib import Path

import psycopg
from lifeline import RUN
from polling import PATIENCE_S
from ports import free_port

from nufleet.orchestrator.authority.certificates import (
    Issuer,
    authority_certificate,
    certificate_pem,
    key_pem,
    new_key,
    utc_now,
)
from nufleet.shared.private_files import write_privately

MISSING = "PostgreSQL's server is not installed; install it with: apt-get install -y postgresql"


@dataclass(frozen=True)
class PostgresqlServer:
    """A server that runs; its only user is `nufleet`, who needs no password."""

    folder: Path
    port: int
    process: subprocess.Popen[bytes]

    @property
    def authority(self) -> Path:
        """Certificate of the authority that signed the certificate of the server."""
        return self.folder / "authority.pem"

    def empty_database(self) -> str:
        """Empty the server's database and return its address.

        A database for each test would mean writing 8 MB each; one still in use is detected.
        """
        with psycopg.connect(self.connection(), autocommit=True) as connection:
            connection.execute(f"SET lock_timeout = '{PATIENCE_S:g}s'")
            connection.execute("DROP SCHEMA public CASCADE")
            connection.execute("CREATE SCHEMA public")
        return f"postgresql://nufleet@/postgres?host={self.folder}&port={self.port}"

    def connection(self) -> str:
        return f"host={self.folder} port={self.port} user=nufleet dbname=postgres"


def binaries() -> Path:
    """Return the folder of the newest server installed."""
    on_path = shutil.which("initdb")
    found = [Path(on_path)] if on_path else []
    debian = Path("/usr/lib/postgresql").glob("*/bin/initdb")
    found += sorted(debian, key=lambda path: int(path.parts[-3]), reverse=True)
    if not found:
        raise RuntimeError(MISSING)
    return found[0].parent


def certified(folder: Path) -> tuple[Path, Path]:
    """Make an authority, and a key and a certificate that it signs for a server at 127.0.0.1."""
    signer, key, now = new_key(), new_key(), utc_now()
    authority = authority_certificate("database", signer, now)
    made = Issuer(authority, signer).issue(
        "database", key.public_key(), now, timedelta(days=1), serves_at=("127.0.0.1",)
    )
    (folder / "authority.pem").write_text(certificate_pem(authority))
    certificate, secret = folder / "server.pem", folder / "server.key"
    certificate.write_text(certificate_pem(made))
    write_privately(secret, key_pem(key))
    return certificate, secret


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
        for file in certified(folder):
            os.chown(file, folder.stat().st_uid, folder.stat().st_gid)
        data = folder / "data"
        settings = ["-U", "nufleet", "-A", "trust", "-E", "UTF8", "--no-sync", "--no-instructions"]
        made = subprocess.run(
            [*as_user, here / "initdb", "-D", data, *settings],
            cwd=folder,
            capture_output=True,
            text=True,
        )
        assert made.returncode == 0, made.stderr
        (data / "pg_hba.conf").write_text(
            "local all all trust\nhostssl all all 127.0.0.1/32 trust\n"
        )
        port = free_port()
        options = ["-k", str(folder), "-p", str(port), "-c", "listen_addresses=127.0.0.1"]
        tls = ["ssl=on", f"ssl_cert_file={folder}/server.pem", f"ssl_key_file={folder}/server.key"]
        options += [part for setting in ("fsync=off", *tls) for part in ("-c", setting)]
        log = folder / "log"
        with log.open("wb") as output:
            process = subprocess.Popen(
                [*as_user, here / "postgres", "-D", data, *options],
                cwd=folder,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=output,
            )
        server = PostgresqlServer(folder, port, process)
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
