"""`nufleet fleet init`, `request`, `enroll`, `renew`, `revoke`, `who`: a closed fleet."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from nufleet.orchestrator.cli.options import connect_options
from nufleet.shared.command_line import folder_option

PRINCIPAL_DAYS = 90


authority_option = folder_option(
    "--authority",
    "folder",
    envvar="NUFLEET_AUTHORITY",
    help="Folder of the fleet's authority.  [env: NUFLEET_AUTHORITY; default: the only "
    "*.authority folder here]",
)
out_option = folder_option(
    "--out", default=Path(), help="Folder for the identity.  [default: here]"
)
days_option = click.option(
    "--days",
    type=click.IntRange(min=1, max=3650),
    default=PRINCIPAL_DAYS,
    show_default=True,
    help="Days for which the certificate is valid.",
)


@click.command()
@click.argument("inventory", type=click.Path(dir_okay=False, path_type=Path), metavar="INVENTORY")
@authority_option
def init(inventory: Path, folder: Path | None) -> None:
    """Make the authority of a fleet, and the certificate and configuration of its router.

    INVENTORY is the fleet file; besides the robots it lists the router's addresses and the other
    principals. Orchestrators may do everything, operators watch and stop, watchers watch.

    \b
    [router]
    addresses = ["192.168.1.10"]
    [orchestrators.desk]
    [operators.anna]
    may_release = true
    [watchers.screen]
    """
    from nufleet.orchestrator.jobs.authority import init_and_print

    init_and_print(inventory, folder)


@click.command()
@click.argument("name")
@folder_option("--folder", help="Folder for key and request.  [default: ~/.config/nufleet]")
def request(name: str, folder: Path | None) -> None:
    """Make a key for principal NAME on this machine, and a request to have it enrolled."""
    from nufleet.orchestrator.jobs.authority import request_and_print

    request_and_print(name, folder)


@click.command()
@click.argument("name")
@click.option(
    "--request",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Request that `nufleet fleet request` made where NAME runs; without one the key is made "
    "here and has to travel.",
)
@days_option
@out_option
@authority_option
def enroll(name: str, folder: Path | None, out: Path, request: Path | None, days: int) -> None:
    """Write the identity of principal NAME of the inventory: NAME.nufleet."""
    from nufleet.orchestrator.jobs.authority import enroll_and_print

    enroll_and_print(name, folder, out, request=request, days=days)


@click.command()
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("--router", is_flag=True, help="Renew the certificate of the router.")
@click.option(
    "--replace-authority",
    is_flag=True,
    help="Make a new key for the authority; given again after all identities were renewed, trust "
    "the former one no longer.",
)
@days_option
@out_option
@authority_option
def renew(names: tuple[str, ...], folder: Path | None, replace_authority: bool, **o: Any) -> None:
    """Write new certificates for the same keys; without NAME for all principals.

    Agents and orchestrators use a new identity file from their next connection on.
    """
    from nufleet.orchestrator.jobs.authority import renew_and_print, replace_and_print

    if replace_authority:
        return replace_and_print(folder)
    return renew_and_print(names, folder, **o)


@click.command()
@click.argument("name")
@authority_option
def revoke(name: str, folder: Path | None) -> None:
    """Take principal NAME out of the router's list for good; the router has to be restarted.

    NAME can be enrolled again, with a new key.
    """
    from nufleet.orchestrator.jobs.authority import revoke_and_print

    revoke_and_print(name, folder)


@click.command()
@connect_options
@authority_option
def who(folder: Path | None, connect: str, **_: Any) -> None:
    """List all principals: role, end of the certificate, and who is connected."""
    from nufleet.orchestrator.jobs.authority import who_and_print

    who_and_print(folder, connect)
