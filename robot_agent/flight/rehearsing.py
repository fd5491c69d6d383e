"""The process beside an agent that rehearses flights: a task comes in, predictions go out.

It has no connection to the robot or to the network. It takes what processor time nothing else on
the computer wants, and it ends with the agent, however the agent ends.
"""

from __future__ import annotations

import os
import pickle
import sys
from dataclasses import dataclass

from nufleet.robot_agent.flight.rehearsal import Rehearsal
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import NufleetError
from nufleet.shared.lifeline import when_stdin_closes
from nufleet.shared.wire.messages import Foreseen, ForeseenWay

LEAST_URGENT = 19
"""Niceness of the process."""


@dataclass(frozen=True, eq=False)
class Task:
    """The ways of following a path that are to be rehearsed, one after the other."""

    rehearsal: Rehearsal
    """The robot as it knows itself."""
    desired: FloatArray
    """Path, shape (samples, axes), in the axes' units."""
    ways: tuple[ForeseenWay, ...]
    """Ways of following it."""


def foreseen(task: Task, way: ForeseenWay) -> Foreseen:
    """Return what is expected of one way of a task."""
    try:
        if way.after_rich_flight_s:
            found = task.rehearsal.predicted_after(task.desired, way.after_rich_flight_s)
        else:
            found = task.rehearsal.predicted(way.along(task.desired))
    except NufleetError as error:
        return Foreseen(code="rehearsal", reason=str(error))
    return Foreseen(predicted=found)


def main() -> None:
    """Read a task from standard input, and write one line of JSON for each of its ways."""
    os.nice(LEAST_URGENT)
    # The agent itself wrote it, through a pipe that nobody else holds.
    task: Task = pickle.load(sys.stdin.buffer)  # noqa: S301
    when_stdin_closes(lambda: os._exit(1))
    for way in task.ways:
        sys.stdout.write(foreseen(task, way).model_dump_json() + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
