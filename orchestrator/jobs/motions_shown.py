"""Shows on a terminal which robots move, how far they are, and how long that still takes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

from rich.console import Console
from rich.live import Live
from rich.progress_bar import ProgressBar
from rich.table import Table

from nufleet.orchestrator.fleet.robot_watch import RobotWatch

ROWS_MAX = 12
"""Largest number of robots shown at once; a large fleet would fill the terminal."""
REFRESHES_PER_S = 4.0
_BAR_CHARACTERS = 30


@dataclass(frozen=True)
class _Begun:
    """A motion as it was first heard of."""

    goal_id: str
    at_s: float
    progress: float


class MotionBars:
    """Draws a bar for each robot in motion, from the states that robots publish."""

    def __init__(
        self, watches: Sequence[RobotWatch], clock: Callable[[], float] = time.monotonic
    ) -> None:
        self._watches = watches
        self._clock = clock
        self._begun: dict[str, _Begun] = {}

    def __rich__(self) -> Table:
        """Return a row for each robot in motion."""
        table = Table.grid(padding=(0, 2))
        moving = [row for watch in self._watches if (row := self._row(watch)) is not None]
        for robot, progress, left in moving[:ROWS_MAX]:
            bar = ProgressBar(total=1.0, completed=progress, width=_BAR_CHARACTERS)
            table.add_row(f"  {robot}", bar, f"{progress:.0%}", left)
        if len(moving) > ROWS_MAX:
            table.add_row(f"  and {len(moving) - ROWS_MAX} more")
        return table

    def _row(self, watch: RobotWatch) -> tuple[str, float, str] | None:
        state = watch.state
        if state is None or state.goal_id is None or not watch.alive:
            return None
        now_s = self._clock()
        heard_s = now_s - watch.silent_s
        begun = self._begun.get(watch.robot)
        if begun is None or begun.goal_id != state.goal_id:
            begun = self._begun[watch.robot] = _Begun(state.goal_id, heard_s, state.progress)
        gone = state.progress - begun.progress
        if gone <= 0:
            return watch.robot, state.progress, ""
        left_s = (1 - state.progress) * (heard_s - begun.at_s) / gone - (now_s - heard_s)
        return watch.robot, state.progress, f"{max(left_s, 0):.0f} s left"


@contextmanager
def motions_shown(console: Console, watches: Sequence[RobotWatch]) -> Iterator[None]:
    """Show bars below what is printed, while robots move; a console that is no terminal has none.

    Args:
        console: Console for progress, on which all that is printed meanwhile has to be printed.
        watches: Watches on the robots that may move.
    """
    if console.quiet or not console.is_terminal:
        yield
        return
    with Live(
        MotionBars(watches),
        console=console,
        refresh_per_second=REFRESHES_PER_S,
        transient=True,
        redirect_stdout=False,
        redirect_stderr=False,
    ):
        yield
