"""`nufleet plan`: what another command would have robots do."""

from __future__ import annotations

import click

from nufleet.orchestrator.cli.types import NewPicture


class _OfAnotherCommand(click.Command):
    """A command whose arguments are the words of another one."""

    ignore_unknown_options = True
    allow_interspersed_args = False


@click.command(cls=_OfAnotherCommand)
@click.option(
    "--picture",
    type=NewPicture(),
    metavar="FILE",
    help="Draw it, as PNG, SVG or PDF.",
)
@click.argument("words", nargs=-1, required=True, type=str, metavar="COMMAND [OPTIONS]...")
@click.pass_context
def plan(context: click.Context, picture: object, words: tuple[str, ...]) -> None:
    """Print what COMMAND with its OPTIONS would have each robot do, and move none.

    COMMAND is one that moves robots: `rank`, `match`, `track`, `train`, `evaluate` or `runs
    resume`. The table says how often each robot would do what, how long it takes, from where to
    where it leads, how fast, and what share of the battery it uses.

    \b
    nufleet plan rank --fleet paper_linear
    nufleet plan --picture plan.png track --target drone-7 --trajectory clover
    """
    parent = context.find_root()
    command: click.Command | None = parent.command
    left, name = list(words), ""
    while isinstance(command, click.Group):
        if not left:
            raise click.UsageError(f"name one of the commands of `nufleet {name}`")
        name, command, left = _resolved(command, context.parent or parent, left)
    if command is None or not any(option.name == "plans" for option in command.params):
        raise click.UsageError(f"`nufleet {name}` moves no robot: there is nothing to plan")
    options = ["--plan", *([] if picture is None else ["--picture", str(picture)])]
    with command.make_context(name, [*left, *options], parent=parent) as inner:
        command.invoke(inner)


def _resolved(
    group: click.Group, context: click.Context, words: list[str]
) -> tuple[str, click.Command | None, list[str]]:
    name, command, left = group.resolve_command(context, words)
    return name or words[0], command, left
