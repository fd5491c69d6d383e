"""`nufleet audit show` and `verify`: who asked a robot for what."""

from __future__ import annotations

from pathlib import Path

import click

_LOG = click.argument("log", type=click.Path(exists=True, path_type=Path), metavar="LOG")


@click.command()
@_LOG
@click.option("--principal", metavar="NAME", help="Show the requests of this principal only.")
def show(log: Path, principal: str | None) -> None:
    """Show who asked a robot for what, and what it answered.

    LOG is an audit log, or the state folder of the robot that contains it, such as
    ~/.local/state/nufleet/FLEET/ROBOT.
    """
    from nufleet.robot_agent.journal.audit_log import read_audit_log

    for entry in read_audit_log(_file(log)):
        if principal in (None, entry.principal):
            by = entry.principal or "(not proven)"
            lease = "" if not entry.epoch else f" under epoch {entry.epoch}"
            about = f" {entry.about}" if entry.about else ""
            click.echo(
                f"{entry.time}  {by} ({entry.sender}) asked {entry.asked}{about}{lease}: "
                f"{entry.answer}"
            )


@click.command()
@_LOG
@click.option(
    "--digest", metavar="SHA256", help="Digest that the log must contain, noted at an earlier time."
)
def verify(log: Path, digest: str | None) -> None:
    """Check that no entry of LOG was changed, removed or inserted.

    Prints the digest of the last entry: note it elsewhere and give it with --digest later, because
    only this shows whether entries were cut off at the end. Ends with exit code 1 if the log is not
    whole.
    """
    from nufleet.robot_agent.journal.audit_log import verified

    found = verified(_file(log), digest=digest)
    click.echo(f"{found.entries} entries follow from each other; last digest {found.digest}")
    if found.broken is not None:
        click.secho(f"NOT WHOLE: {found.broken}", fg="red", bold=True, err=True)
        raise click.exceptions.Exit(1)


def _file(log: Path) -> Path:
    from nufleet.robot_agent.journal.audit_log import AUDIT_LOG

    return log / AUDIT_LOG if log.is_dir() else log
