"""What robots would do, shown before they do it, and the consent of a person for real robots.

`Opening.take` and `Opening.go_on`, the only ways to command robots, call `agree`: no command can
move a robot that has not said here what it is going to do.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NoReturn, TypeVar

import click
from rich.console import Console

from nufleet.orchestrator.flights.planned import Outlook, check_healths
from nufleet.orchestrator.jobs.commands import MovingCommand, StoredCommand
from nufleet.orchestrator.jobs.terminal import results_console, stderr_console
from nufleet.orchestrator.runs.plan_table import plan_parts
from nufleet.shared.command_line import ask_before
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.health import Health
from nufleet.shared.wire.messages import Description

Moves = Callable[[], Outlook] | None
"""Returns what the robots are going to do; None for a command that moves no robot."""

C = TypeVar("C", bound=MovingCommand)
R = TypeVar("R")


class OnlyPlannedError(Exception):
    """Ends a command with `--plan` where it would begin to move robots."""

    def __init__(self, outlook: Outlook) -> None:
        super().__init__(outlook.headline)
        self.outlook = outlook


def only_simulated() -> NoReturn:
    """Say instead of an outlook that a command moves simulated robots only."""
    raise InvalidInputError("this command moves simulated robots only; nothing has moved")


def agree(
    command: StoredCommand,
    descriptions: Iterable[Description],
    moves: Moves,
    health: Callable[[str], Health | None],
    console: Console,
) -> None:
    """Return if robots may move; simulated ones may without being asked for.

    Args:
        command: Options of the command.
        descriptions: Descriptions of the robots that are going to be commanded.
        moves: What they are going to do.
        health: Returns the latest health of a robot.
        console: Console for progress.

    Raises:
        OnlyPlannedError: The command is only to tell what would be done.
        InvalidInputError: A robot is not ready, or no person is at the terminal to be asked.
        click.Abort: The person declined.
    """
    if moves is None:
        return
    real = [one.robot for one in descriptions if not one.spec.simulated]
    chosen = command if isinstance(command, MovingCommand) else None
    if not (real or (chosen and (chosen.plans or chosen.yes is False))):
        return
    outlook = moves()
    healths = {motion.robot: health(motion.robot) for motion in outlook.motions}
    outlook = outlook.with_healths(healths)
    check_healths(outlook, healths)
    if chosen is not None and chosen.plans:
        raise OnlyPlannedError(outlook)
    for part in plan_parts(outlook):
        console.print(part)
    if chosen is None or not chosen.yes:
        who = ", ".join(real) or "simulated robots"
        ask_before(
            f"{who} will {'really ' if real else ''}move, and take off if they fly",
            instead="--plan to see what would be done",
        )


def carried_out(command: C, work: Callable[[C, Console], R]) -> R | None:
    """Do the work of a command, or with `--plan` only tell what it would do.

    Args:
        command: Options of the command.
        work: Function that carries it out.

    Returns:
        Its result; None if nothing was to move.
    """
    console = stderr_console()
    try:
        return work(command, console)
    except OnlyPlannedError as planned:
        outlook = planned.outlook
    results = results_console(console, as_json=command.as_json)
    for part in plan_parts(outlook):
        results.print(part)
    if command.picture is not None:
        from nufleet.orchestrator.runs.plan_picture import draw_plan

        draw_plan(command.picture, outlook)
        console.print(f"picture: {command.picture}")
    if command.as_json:
        click.echo(outlook.document())
    return None
