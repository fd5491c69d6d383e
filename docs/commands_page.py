"""Writes the help of every command into the page of the commands, when MkDocs builds it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, cast

import click

from nufleet.shared.command_line import command_line

PAGE = "commands.md"
COLUMNS = 96


def on_page_markdown(markdown: str, *, page: Any, **_: Any) -> str:
    """Append the commands to their page; MkDocs calls this for every page."""
    if page.file.src_uri != PAGE:
        return markdown
    return "\n".join([markdown, *_commands(click.Context(command_line(), info_name="nufleet"))])


def _commands(context: click.Context) -> Iterator[str]:
    group = cast(click.Group, context.command)
    for name in group.list_commands(context):
        command = cast(click.Command, group.get_command(context, name))
        below = click.Context(
            command,
            parent=context,
            info_name=name,
            terminal_width=COLUMNS,
            max_content_width=COLUMNS,
        )
        if isinstance(command, click.Group):
            yield from _commands(below)
        else:
            yield f"## {below.command_path}\n\n```text\n{command.get_help(below)}\n```\n"
