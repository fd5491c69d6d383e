"""Procedures that ask a robot for one thing after another and leave the waiting to others.

A procedure yields each call that it wants made, and receives what the call returned or raised. The
agent makes the calls on its motion thread; the simulation of the protocol lets each of them take
its time on a virtual clock, so that what a procedure decides is the same in both.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import Any, TypeVar

R = TypeVar("R")

Call = Callable[[], Any]
"""A call of the robot, which may take long and may raise."""

Steps = Generator[Call, Any, R]
"""A procedure with a result of type `R`."""


def make(steps: Steps[R]) -> R:
    """Make every call of a procedure on this thread; return its result, or raise what it raises."""
    try:
        call = next(steps)
        while True:
            try:
                answer = call()
            except Exception as error:  # noqa: BLE001 - the procedure decides what follows from it
                call = steps.throw(error)
            else:
                call = steps.send(answer)
    except StopIteration as end:
        result: R = end.value
        return result
