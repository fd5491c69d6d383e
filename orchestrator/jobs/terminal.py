"""The terminal: results on stdout, progress on stderr."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial

from rich.console import Console

TABLE_CHARACTERS_MIN = 80
"""Least width of tables; a narrower terminal breaks their lines rather than lose digits."""
FILE_CHARACTERS = 1000
"""Width of results that no terminal shows, so that other programs find each row on one line."""


def stdout_console() -> Console:
    """Return the console for what a command was asked for."""
    console = Console(highlight=False, soft_wrap=True)
    if not console.is_terminal and "COLUMNS" not in os.environ:
        console.width = FILE_CHARACTERS
    return _wide_enough(console)


def stderr_console() -> Console:
    """Return the console for progress, which leaves stdout to results."""
    return _wide_enough(Console(stderr=True, highlight=False, soft_wrap=True))


def results_console(progress: Console, *, as_json: bool) -> Console:
    """Return the console for the results of a command that shows its progress on another one.

    Args:
        progress: Console for progress. Results follow it, unless it prints on stderr.
        as_json: Whether stdout is taken by a document, so that people read the results on stderr.
    """
    if not progress.stderr or as_json:
        return progress
    out = stdout_console()
    # On one terminal, one console prints both, so that no bar is drawn across a result.
    return progress if out.is_terminal and progress.is_terminal else out


@contextmanager
def bars_shown(console: Console, unit: str) -> Iterator[Callable[[str, int, int | None], None]]:
    """Show on a terminal how far pieces of work are, since when, and the time they still take.

    Args:
        console: Console for progress; one that is no terminal shows nothing.
        unit: What is counted, in the plural.

    Yields:
        Function to call, from any thread, with a piece of work, how much of it is done, and of how
        much; None if that is not known yet. Its bar disappears when all of it is done.
    """
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        TaskID,
        TimeElapsedColumn,
        TimeRemainingColumn,
    )

    with Progress(
        "  {task.description}",
        BarColumn(),
        MofNCompleteColumn(),
        f"{unit}, time left",
        TimeRemainingColumn(),
        "after",
        TimeElapsedColumn(),
        console=console,
        transient=True,
        disable=console.quiet or not console.is_terminal,
    ) as progress:
        tasks = dict[str, TaskID]()

        def show(work: str, done: int, total: int | None) -> None:
            if work not in tasks:
                tasks[work] = progress.add_task(work, total=None)
            progress.update(tasks[work], completed=done, total=total, visible=done != total)

        yield show


@contextmanager
def rehearsal_shown(console: Console) -> Iterator[Callable[[int, int], None]]:
    """Show how many ways of flying a robot has rehearsed; see `bars_shown`."""
    with bars_shown(console, "ways") as shown:
        shown("rehearsing", 0, None)
        yield partial(shown, "rehearsing")


def _wide_enough(console: Console) -> Console:
    console.width = max(console.width, TABLE_CHARACTERS_MIN)
    return console
