"""The work of `nufleet doctor`: check what nufleet needs, and print the findings."""

from __future__ import annotations

import json
import os
import platform
import socket
import sys
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, metadata, requires, version
from pathlib import Path
from typing import Literal

import click
from packaging.requirements import Requirement

from nufleet.orchestrator.fleet.connection import running_fleet
from nufleet.orchestrator.viewer.server.ports import GRPC_PORT, WEB_PORT
from nufleet.orchestrator.viewer.server.rerun_program import rerun_program
from nufleet.shared.errors import NufleetError
from nufleet.shared.redaction import without_secrets
from nufleet.shared.robots.drivers import ENTRY_POINT_GROUP, load_driver
from nufleet.shared.robots.installed import installed
from nufleet.shared.wire.identity import SCHEME, identity_at
from nufleet.shared.wire.transport import open_router

ROUTER_PORT = 7447


@dataclass(frozen=True)
class Finding:
    """The result of one check."""

    what: str
    """Name of what was checked."""
    verdict: Literal["ok", "note", "missing"]
    """`ok`, `note` for a limitation, or `missing` for something that nufleet needs."""
    found: str
    """Description of what was found."""


_COLOURS = {"ok": "green", "note": "yellow", "missing": "red"}


def checkup_and_print(connect: str, fleet_name: str | None, *, as_json: bool) -> bool:
    """Make all checks, print their findings, and return whether nothing is missing.

    Args:
        connect: Endpoint at which to look for a running fleet.
        fleet_name: Name of that fleet; None when only one is running there.
        as_json: Whether to print the findings as JSON on stdout instead of text.
    """
    findings = checkup(connect, fleet_name)
    if as_json:
        click.echo(json.dumps({"schema": 1, "checks": [asdict(finding) for finding in findings]}))
    else:
        for finding in findings:
            click.secho(f"{finding.verdict:<8}", fg=_COLOURS[finding.verdict], nl=False)
            click.echo(f"{finding.what}: {finding.found}")
    return all(finding.verdict != "missing" for finding in findings)


def checkup(endpoint: str, fleet_name: str | None) -> list[Finding]:
    """Make all checks and return their findings.

    Args:
        endpoint: Endpoint at which to look for a running fleet.
        fleet_name: Name of that fleet; None when only one is running there.
    """
    return [
        _python(),
        *_packages(),
        *_extras(),
        *_drivers(),
        _viewer(),
        _own_router(),
        *_ports(),
        _fleet(endpoint, fleet_name),
    ]


def _python() -> Finding:
    right = sys.version_info >= (3, 11)
    found = f"{platform.python_version()} on {platform.platform(terse=True)}"
    return Finding(
        "python", "ok" if right else "missing", found + ("" if right else "; 3.11 needed")
    )


def _packages() -> Iterator[Finding]:
    for line in requires("nufleet") or ():
        requirement = Requirement(line)
        if requirement.marker is not None and not requirement.marker.evaluate({"extra": ""}):
            continue
        try:
            there = version(requirement.name)
        except PackageNotFoundError:
            yield Finding(requirement.name, "missing", f"not installed; {requirement} is needed")
            continue
        right = requirement.specifier.contains(there, prereleases=True)
        found = there if right else f"{there}; {requirement} is needed"
        yield Finding(requirement.name, "ok" if right else "missing", found)


def _extras() -> Iterator[Finding]:
    """Check the packages of each extra; none of them is needed by everyone."""
    wanted = [Requirement(line) for line in requires("nufleet") or ()]
    for extra in metadata("nufleet").get_all("Provides-Extra") or ():
        packages = {
            one.name
            for one in wanted
            if one.marker is not None
            and one.marker.evaluate({"extra": extra})
            and not one.marker.evaluate({"extra": ""})
        }
        missing = sorted(name for name in packages if not _is_installed(name))
        found = "installed"
        if missing:
            found = f"no {', '.join(missing)}: pip install 'nufleet[{extra}]' if you need it"
        yield Finding(f"extra {extra}", "note" if missing else "ok", found)


def _is_installed(package: str) -> bool:
    try:
        version(package)
    except PackageNotFoundError:
        return False
    return True


def _drivers() -> Iterator[Finding]:
    """Check which drivers there are, and which of them lack a package that they need."""
    names = sorted(installed(ENTRY_POINT_GROUP))
    yield Finding("robot drivers", "ok" if names else "missing", ", ".join(names) or "none")
    for name in names:
        try:
            load_driver(name)
        except NufleetError as error:
            yield Finding(f"driver {name}", "note", str(error))


def _viewer() -> Finding:
    try:
        binary = rerun_program()
    except NufleetError as error:
        return Finding("viewer", "missing", str(error))
    display = any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
    note = "" if display else "; no display here: use --web or --screenshot"
    return Finding("viewer", "ok" if display else "note", f"{Path(binary).name}{note}")


def _own_router() -> Finding:
    try:
        with open_router(["tcp/127.0.0.1:0"]) as session:
            where = ", ".join(session.listening_on())
    except NufleetError as error:
        return Finding("zenoh", "missing", str(error))
    return Finding("zenoh", "ok", f"a router could be opened ({where})")


def _ports() -> Iterator[Finding]:
    for port, purpose in (
        (ROUTER_PORT, "router"),
        (GRPC_PORT, "live recording"),
        (WEB_PORT, "web viewer"),
    ):
        with socket.socket() as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                probe.bind(("127.0.0.1", port))
            except OSError as error:
                use = f"{purpose}: {error.strerror}, perhaps by a {purpose} of yours"
                yield Finding(f"port {port}", "note", use)
                continue
        yield Finding(f"port {port}", "ok", f"{purpose}: free")


def _fleet(endpoint: str, fleet_name: str | None) -> Finding:
    name = f"fleet at {without_secrets(endpoint.removeprefix(SCHEME))}"
    try:
        identity = identity_at(endpoint)
        with running_fleet(endpoint, fleet_name) as connection:
            found, robots = connection.name, ", ".join(connection.robots)
    except NufleetError as error:
        return Finding(name, "note", str(error))
    if robots:
        return Finding(name, "ok", f"{found}: {robots}")
    blind = identity is not None and identity.role == "robot"
    why = "a robot may not see the others: use the identity of a person" if blind else "no robot"
    return Finding(name, "note", f"{found}: {why}")
