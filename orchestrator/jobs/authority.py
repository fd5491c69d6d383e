"""The work of the commands that close a fleet: `nufleet fleet init`, `enroll`, `who` and others."""

from __future__ import annotations

from datetime import datetime
from pathlib import Path

import click
from rich.table import Table

from nufleet.orchestrator.authority.authority import (
    FOLDER_SUFFIX,
    PRINCIPAL_DAYS,
    Authority,
    Enrolled,
)
from nufleet.orchestrator.authority.certificates import utc_now
from nufleet.orchestrator.authority.key_files import make_request
from nufleet.orchestrator.authority.ledger import Enrolment
from nufleet.orchestrator.jobs.terminal import stdout_console
from nufleet.shared.errors import InvalidInputError, NufleetError, TransportError
from nufleet.shared.wire.identity import identity_folder
from nufleet.shared.wire.keys import checked_name, principal_of
from nufleet.shared.wire.transport import open_client

WHO_TIMEOUT_S = 5.0
ALARM = 1 / 3
"""Part of a certificate's life that is left when it is shown as due."""


def init_and_print(inventory: Path, folder: Path | None) -> None:
    """Make the authority of a fleet and print how to start its router.

    Args:
        inventory: Path of the fleet file that lists the principals.
        folder: Folder to create; None for one beside the inventory.

    Raises:
        InvalidInputError, FleetFileError: See `Authority.create`.
    """
    folder = folder or inventory.with_suffix(FOLDER_SUFFIX)
    authority = Authority.create(inventory, folder)
    names = ", ".join(authority.inventory.principals)
    click.echo(f"made the authority of fleet {authority.inventory.name} in {folder}", err=True)
    click.echo(f"start the router:  nufleet router --config {authority.configuration}", err=True)
    click.echo(f"then enroll each of {names}:  nufleet fleet enroll NAME", err=True)


def request_and_print(name: str, folder: Path | None) -> None:
    """Make a key and a request, and print what to do with the request.

    Args:
        name: Principal of the inventory.
        folder: Folder for both; None for the user's folder for identities.

    Raises:
        InvalidInputError: The name is not valid, or there is a key of this name.
    """
    key, request = make_request(checked_name(name, "principal"), folder or identity_folder())
    click.echo(f"the key {key} stays on this machine", err=True)
    click.echo(
        f"take {request} to the authority:  nufleet fleet enroll {name} --request {request.name}",
        err=True,
    )
    click.echo(f"and put the {name}.nufleet that it writes into {key.parent}", err=True)


def enroll_and_print(
    name: str, folder: Path | None, out: Path, *, request: Path | None, days: int
) -> None:
    """Write the identity of a principal and print what to do with it.

    Args:
        name: Principal of the inventory.
        folder: Folder of the authority; None for the only one here.
        out: Folder for the identity.
        request: Request of the principal; None to make its key here.
        days: Days for which the certificate is valid.

    Raises:
        InvalidInputError: See `Authority.enroll`.
    """
    authority = Authority(found_authority(folder))
    enrolled = authority.enroll(name, out, request=request, days=days)
    _print(authority, name, enrolled)


def renew_and_print(
    names: tuple[str, ...], folder: Path | None, out: Path, *, router: bool, days: int
) -> None:
    """Write new certificates for the keys of enrolled principals or of the router.

    Args:
        names: Principals; empty for all that are enrolled, unless the router alone is renewed.
        folder: Folder of the authority; None for the only one here.
        out: Folder for the identities.
        router: Whether to renew the certificate of the router.
        days: Days for which the certificates of principals are valid.

    Raises:
        InvalidInputError: See `Authority.renew`.
    """
    authority = Authority(found_authority(folder))
    if router:
        expires = authority.renew_router()
        click.echo(
            f"the router's certificate is valid until {expires:%Y-%m-%d}; restart the router. If "
            "its first address changed, `nufleet fleet renew` writes it into all identities",
            err=True,
        )
    enrolled = [name for name, one in authority.ledger.enrolments.items() if not one.revoked]
    listed = authority.inventory.principals
    for name in names or ([] if router else enrolled):
        if names or name in listed:
            _print(authority, name, authority.renew(name, out, days=days))
        else:
            click.echo(f"{name} is no longer in the inventory and is not renewed", err=True)


def replace_and_print(folder: Path | None) -> None:
    """Begin to replace the key of an authority, or end it, and print what comes next.

    Args:
        folder: Folder of the authority; None for the only one here.

    Raises:
        InvalidInputError: See `Authority.finish_replacing`.
    """
    authority = Authority(found_authority(folder))
    if authority.replaced:
        expires = authority.finish_replacing()
        said = f"""\
the former authority is trusted no longer, and the router's certificate is valid until {expires:%F}.
Restart the router when the renewed identities are on all machines: agents take them when they
connect to it again, without a restart of their own."""
    else:
        authority.replace()
        said = f"""\
a new authority signs from now on; {authority.folder} trusts the former one as well.
1. restart the router
2. `nufleet fleet renew`, and copy each identity to its machine
3. `nufleet fleet renew --replace-authority` once more, and restart the router"""
    click.echo(said, err=True)


def revoke_and_print(name: str, folder: Path | None) -> None:
    """Take a principal out of the router's list.

    Args:
        name: Principal that is enrolled.
        folder: Folder of the authority; None for the only one here.

    Raises:
        InvalidInputError: The principal is not enrolled.
    """
    authority = Authority(found_authority(folder))
    authority.revoke(name)
    click.secho(f"restart the router now: until then {name} is still admitted", bold=True, err=True)
    click.echo(f"  nufleet router --config {authority.configuration}", err=True)


def who_and_print(folder: Path | None, connect: str) -> None:
    """Print all principals: role, certificate, and whether they are connected.

    Args:
        folder: Folder of the authority; None for the only one here.
        connect: Address of the fleet.

    Raises:
        InvalidInputError: There is no authority here.
        TransportError: The router cannot be asked; the table is printed before.
    """
    authority = Authority(found_authority(folder))
    fleet, ledger = authority.inventory, authority.ledger
    connected: set[str] | None = None
    error = None
    try:
        connected = _connected(connect)
    except NufleetError as raised:  # raised again below the table
        error = raised
    table = Table(title=f"principals of fleet {fleet.name}")
    for heading in ("principal", "role", "certificate", "connected"):
        table.add_column(heading)
    for name, role in fleet.principals.items():
        there = "not known" if connected is None else "yes" if name in connected else "no"
        table.add_row(name, role, _certificate(ledger.enrolments.get(name)), there)
    table.add_row("the router", "router", _left(ledger.router_expires), "")
    stdout_console().print(table)
    if error is not None:
        raise error


def found_authority(folder: Path | None) -> Path:
    """Return the folder of the authority that was given, or the only one in this folder.

    Raises:
        InvalidInputError: None was given, and there is none here, or several.
    """
    if folder is not None:
        return folder
    found = sorted(Path().glob(f"*{FOLDER_SUFFIX}"))
    if len(found) == 1:
        return found[0]
    there = f"there are {', '.join(map(str, found))}" if found else "there is none here"
    raise InvalidInputError(
        f"which authority? {there}; give its folder with --authority, or make one with "
        "`nufleet fleet init INVENTORY`"
    )


def _connected(connect: str) -> set[str]:
    """Return the principals that are connected to the router, also under a revoked certificate.

    Raises:
        TransportError: The router cannot be asked, or does not tell this principal.
    """
    with open_client(connect, timeout_s=WHO_TIMEOUT_S) as session:
        session.check_admitted()
        names = {principal_of(name) for name in session.connected()}
        if session.principal not in names:
            raise TransportError(
                f"the router does not tell {session.principal} who is connected: use the identity "
                "of an orchestrator; if it is one, `nufleet fleet renew --router` writes the "
                "router's list again, and the router has to be restarted"
            )
    return names


def _certificate(enrolment: Enrolment | None) -> str:
    if enrolment is None:
        return "not enrolled"
    return "revoked" if enrolment.revoked else _left(enrolment.expires)


def _left(expires: datetime) -> str:
    days = (expires - utc_now()).total_seconds() / 86400
    if days <= 0:
        return f"[red]expired {expires:%Y-%m-%d}[/]"
    due = days < ALARM * PRINCIPAL_DAYS
    return f"{'[yellow]' if due else ''}{expires:%Y-%m-%d}, {days:.0f} d left{'[/]' if due else ''}"


def _print(authority: Authority, name: str, enrolled: Enrolled) -> None:
    role = authority.inventory.principals[name]
    what = f"{enrolled.identity} ({role}, until {enrolled.expires:%Y-%m-%d})"
    click.echo(f"wrote {what}", err=True)
    if enrolled.identity.parent.resolve() == identity_folder().resolve():
        click.echo("commands of this user find it there", err=True)
    elif enrolled.key is None:
        click.echo(f"copy it to where the key of {name} is", err=True)
    else:
        click.echo(
            f"and its key {enrolled.key}: move both to the machine of {name}, over a channel that "
            "you trust, and delete the key here",
            err=True,
        )
    if enrolled.router_changed:
        click.echo(f"restart the router: {authority.configuration} changed", err=True)
