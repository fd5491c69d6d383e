"""The process beside an agent that rehearses flights: a task comes in, predictions go out.

It has no connection to the robot or to the network, and it ends with the agent, however the agent
ends.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence
from typing import IO, Annotated

from pydantic import Field

from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.rehearsal import Rehearsal
from nufleet.shared.errors import MalformedMessageError, NufleetError
from nufleet.shared.lifeline import when_stdin_closes
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.strict import Name
from nufleet.shared.wire.codec import (
    MAX_MESSAGE_BYTES,
    Bytes,
    Float64Array,
    Message,
    decode,
    encode,
)
from nufleet.shared.wire.messages import WAYS_MAX, Foreseen, ForeseenWay
from nufleet.shared.wire.motions import MIXTURE_MAX

_LENGTH_BYTES = 8


class RehearsalTask(Message):
    """The ways of following a path that are to be rehearsed, and the robot as it knows itself."""

    spec: RobotSpec
    """Description of the robot."""
    state_names: tuple[Name, ...]
    """Names of the states that it measures."""
    records: Bytes
    """What it knows of its axes; see `Memory.exported`."""
    priors: Annotated[int, Field(ge=0, le=MIXTURE_MAX)]
    """Number of priors, each of which follows as a `HeldPrior`."""
    desired: Float64Array
    """Path, shape (samples, axes), in the axes' units."""
    ways: Annotated[tuple[ForeseenWay, ...], Field(min_length=1, max_length=WAYS_MAX)]
    """Ways of following it, in the order in which they are answered."""


class HeldPrior(Message):
    """The file of a prior, since a task has no room for several."""

    payload: Bytes
    """Content of the file."""


def write_task(stream: IO[bytes], task: RehearsalTask, priors: Sequence[bytes]) -> None:
    """Write a task and the files of its priors to a process; raises OSError if it is gone."""
    for message in (task, *(HeldPrior(payload=payload) for payload in priors)):
        frame = encode(message)
        stream.write(len(frame).to_bytes(_LENGTH_BYTES, "big") + frame)
    stream.flush()


def read_task(stream: IO[bytes]) -> tuple[RehearsalTask, Memory]:
    """Return a task, and the memory of its robot.

    Raises:
        MalformedMessageError: The stream ends early, or holds something else.
    """
    task = decode(_frame(stream), RehearsalTask)
    held = [decode(_frame(stream), HeldPrior).payload for _ in range(task.priors)]
    return task, Memory.imported(task.records, held)


def _frame(stream: IO[bytes]) -> bytes:
    length = int.from_bytes(stream.read(_LENGTH_BYTES), "big")
    if not 0 < length <= MAX_MESSAGE_BYTES:
        raise MalformedMessageError(f"a frame of {length} bytes")
    return stream.read(length)


def foreseen(way: ForeseenWay, rehearsal: Rehearsal) -> Foreseen:
    """Return what is expected of one way to fly the rehearsed path.

    With the baseline's comes what of the path is unlike all motions that the robot knows of itself.
    """
    seen = rehearsal.unseen if way.inverse == "baseline" else ""
    try:
        return Foreseen(predicted=rehearsal.predicted(way), reason=seen)
    except NufleetError as error:
        return Foreseen(code="rehearsal", reason=str(error))


def main() -> None:
    """Read a task from standard input, and write one line of JSON for each of its ways."""
    task, memory = read_task(sys.stdin.buffer)
    when_stdin_closes(lambda: os._exit(1))
    rehearsal = Rehearsal.of(task.spec, task.state_names, memory, task.desired)
    for way in task.ways:
        sys.stdout.write(foreseen(way, rehearsal).model_dump_json() + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    main()
