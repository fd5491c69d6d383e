"""Removes owner and epoch from the journals of robots while no agent serves them."""

from __future__ import annotations

from pathlib import Path

import click

from nufleet.robot_agent.journal.journal import Journal
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.fleet_file import read_fleet_file


def forget_owners(fleet_file: Path, names: tuple[str, ...], state_folder: Path) -> None:
    """Remove the owners of robots from their journals, and print them; nothing moves.

    Args:
        fleet_file: Path of the fleet file.
        names: Names of the robots, at least one.
        state_folder: Folder with the state of the robots' agents.

    Raises:
        InvalidInputError: No robot is named, or one is not in the file.
        JournalError: An agent serves one of the robots, or a journal cannot be written.
    """
    fleet = read_fleet_file(fleet_file)
    unknown = [name for name in names if name not in fleet.robots]
    if unknown or not names:
        raise InvalidInputError(
            f"--forget-owner needs --robot with robots of {fleet_file}: {', '.join(fleet.robots)}"
            + (f"; not in the file: {', '.join(unknown)}" if unknown else "")
        )
    for name in names:
        with Journal(state_folder / fleet.name / name / "journal") as journal:
            known = journal.forget_owner()
        if known is None:
            click.echo(f"{name} had no owner stored")
        else:
            click.echo(f"{name} forgot {known.owner} and its epoch {known.epoch}")
