"""Tells a person after an interrupt which robots are at rest, and which may not be."""

from __future__ import annotations

import time
from collections.abc import Sequence

from rich.console import Console

from nufleet.orchestrator.fleet.robot_watch import RobotWatch
from nufleet.shared.wire.messages import RobotState, RobotStatus

REST_TIMEOUT_S = 10.0
"""Longest time after an interrupt in which robots report that they are at rest."""

SILENT_WAIT_S = 1.5
"""Time after which it is said which robots are waited for; longer than a heartbeat."""

_MOVING = (RobotStatus.RUNNING, RobotStatus.RESTING)


def say_who_rests(console: Console, watches: Sequence[RobotWatch]) -> None:
    """Wait until robots report that they are at rest, and print which of them do not.

    The last state of a robot may be older than the motion that was interrupted, so only a state
    that arrives now counts. A robot whose agent is gone, or that has a fault, is not waited for. A
    second Ctrl-C ends the wait, and is raised once the robots are named.

    Args:
        console: Console to print on.
        watches: Watches of the robots that were commanded.
    """
    known = {watch.robot: watch.state for watch in watches}
    began_s = time.monotonic()
    said = False
    try:
        for until_s in (SILENT_WAIT_S, REST_TIMEOUT_S):
            for watch in watches:
                left_s = max(0.0, began_s + until_s - time.monotonic())
                watch.wait_until(lambda one: _settled(one, known), timeout_s=left_s)
            waiting = [watch.robot for watch in watches if not _settled(watch, known)]
            if waiting and not said:
                said = True
                console.print(
                    f"waiting up to {REST_TIMEOUT_S:g} s for {', '.join(waiting)} to report to be "
                    "at rest; Ctrl-C ends the wait"
                )
    finally:
        _say(console, watches, known)


def _settled(watch: RobotWatch, known: dict[str, RobotState | None]) -> bool:
    """Return whether there is nothing more to wait for: a new state at rest, or no agent."""
    state = watch.state
    if not watch.alive:
        return True
    return state is not None and state is not known[watch.robot] and state.status not in _MOVING


def _doubt(watch: RobotWatch, known: dict[str, RobotState | None]) -> str | None:
    """Return why a robot may be moving; None when it reports that it is at rest."""
    state = watch.state
    if not watch.alive:
        return "its agent is gone"
    if state is None or state is known[watch.robot]:
        return f"not heard for {watch.silent_s:.1f} s"
    if state.status is RobotStatus.FAULT:
        return f"it has a fault: {state.reason}"
    return "it still moves" if state.status in _MOVING else None


def _say(
    console: Console, watches: Sequence[RobotWatch], known: dict[str, RobotState | None]
) -> None:
    doubts = [(watch.robot, _doubt(watch, known)) for watch in watches]
    moving = ", ".join(f"{robot} ({doubt})" for robot, doubt in doubts if doubt is not None)
    if moving:
        console.print(
            f"{moving} did not report to be at rest: look at them, or stop them with "
            "`nufleet stop --all`",
            style="bold red",
            markup=False,
        )
        return
    names = [watch.robot for watch in watches]
    what = f"all {len(names)} robots are" if len(names) > 1 else f"{names[0]} is"
    console.print(f"{what} at rest")
