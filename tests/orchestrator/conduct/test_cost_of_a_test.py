"""What a round costs, counted rather than timed: the messages and statements of each test.

How often the disk is waited for is counted in `tests/robot_agent/journal/test_journal.py`.
"""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import pytest
from counted_statements import counted_statements
from round_lab import ROBOTS, TEST, start_lab

from nufleet.robot_agent.network.heartbeat import HEARTBEAT_S
from nufleet.shared.wire import codec

BY_TEST = {
    **dict.fromkeys(("GoalRequest", "GoalAccepted", "ResultRequest", "GoalResult"), (1, 1)),
    "RobotState": (2, 2),  # it moves; it is at rest again
    "Telemetry": (1, 0),  # nothing here shows it
}
"""How many messages of each type are encoded and decoded for one test."""

STATEMENTS_BY_TEST = 5
"""One to accept it, four for its result, the robot's response among them."""

STATEMENTS_BY_ROUND = 3
"""Two to find what earlier orchestrators left, one to intend all tests."""

ROUNDS = 10
"""Rounds of which one must cost no more; on a busy machine a question may be repeated."""


@contextmanager
def counted_messages(monkeypatch: pytest.MonkeyPatch) -> Iterator[Counter[tuple[str, str]]]:
    """Count what this process, in which everything runs, encodes and decodes, by type."""
    counts: Counter[tuple[str, str]] = Counter()

    def counting(what: str, done: Callable[..., Any]) -> Callable[..., Any]:
        def count(subject: Any, *args: Any, **kwargs: Any) -> Any:
            made = done(subject, *args, **kwargs)
            message = subject if what == "encode" else made
            counts[what, type(message).__name__] += 1
            return made

        return count

    with monkeypatch.context() as patched:
        for what in ("encode", "decode"):
            done = getattr(codec, what)
            for module in [m for m in sys.modules.values() if getattr(m, what, None) is done]:
                patched.setattr(module, what, counting(what, done))
        yield counts


def cost_of_a_round(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> tuple[Counter[tuple[str, str]], int]:
    """Return how many messages and statements the first round of a new fleet costs.

    As many states as the heartbeats of its duration are not counted.
    """
    folder.mkdir()
    with ExitStack() as stack:
        lab = start_lab(stack, folder, realtime=None)
        began_s = time.monotonic()
        with counted_messages(monkeypatch) as messages, counted_statements(lab.repository) as said:
            lab.run(**dict.fromkeys(ROBOTS, TEST))
        beats = math.ceil((time.monotonic() - began_s) / HEARTBEAT_S) * len(ROBOTS)
    for what in ("encode", "decode"):
        messages[what, "RobotState"] -= beats
    return messages, sum(not one.startswith(("BEGIN", "COMMIT")) for one in said)


def test_a_test_costs_a_bounded_number_of_messages_and_statements(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    tests = len(ROBOTS)
    allowed = Counter(
        {
            (what, kind): tests * number
            for kind, numbers in BY_TEST.items()
            for what, number in zip(("encode", "decode"), numbers, strict=True)
        }
    )
    too_many = []
    for number in range(ROUNDS):
        messages, statements = cost_of_a_round(tmp_path / str(number), monkeypatch)
        if messages <= allowed and statements <= STATEMENTS_BY_TEST * tests + STATEMENTS_BY_ROUND:
            return
        too_many.append((messages - allowed, statements))
    pytest.fail(f"every round cost too much; messages beyond the bound, statements: {too_many}")
