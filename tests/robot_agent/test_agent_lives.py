"""A robot keeps its promises when its agent dies at any moment."""

from __future__ import annotations

import itertools
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from pathlib import Path

import pytest
from agent_lives import MOMENTS, Lives, Moment, killing_disk
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from nufleet.robot_agent.journal.journal import LOG
from nufleet.shared.wire.messages import Outcome

STEPS: dict[str, Callable[[Lives], None]] = {
    "submit a": lambda lives: lives.submit("a"),
    "submit b": lambda lives: lives.submit("b"),
    "cancel a": lambda lives: lives.cancel("a"),
    "end": Lives.end,
    "acknowledge a": lambda lives: lives.acknowledge("a"),
    "stop": Lives.stop,
    "release": Lives.release,
    "owner lost": Lives.lose_owner,
    "restart": Lives.restart,
}
DEPTH = 4

STORY = (
    *(
        "submit a",
        "end",
        "submit a",
        "acknowledge a",
        "submit a",
        "stop",
        "submit b",
        "restart",
        "submit b",
        "stop",
        "release",
    ),
    *("submit b", "stop", "end", "restart", "submit b", "release", "cancel d", "submit d"),
    *("submit c", "cancel d", "restart", "submit d", "submit c", "cancel a", "owner lost", "end"),
)


MORE_STEPS: dict[str, Callable[[Lives], None]] = {
    "submit c": lambda lives: lives.submit("c"),
    "submit d": lambda lives: lives.submit("d"),
    "cancel d": lambda lives: lives.cancel("d"),
}


def step(lives: Lives, name: str) -> None:
    (STEPS | MORE_STEPS)[name](lives)


@pytest.mark.thorough
def test_every_sequence_of_events_and_restarts_keeps_every_promise(tmp_path: Path) -> None:
    # Nothing but a release leads from stopped to motion, and no goal moves twice: the model in
    # `Lives` refuses every answer that says otherwise.
    sequences = 0
    with killing_disk():
        for sequence in itertools.product(STEPS, repeat=DEPTH):
            lives = Lives(tmp_path / "r")
            for name in sequence:
                step(lives, name)
                lives.check()
            lives.restart()
            lives.journal.close()
            (tmp_path / "r" / LOG).unlink()  # and its results are swept away: a new robot
            sequences += 1
    assert sequences == len(STEPS) ** DEPTH


def writes_of_the_story(folder: Path) -> int:
    with killing_disk() as disk:
        lives = Lives(folder)
        for name in STORY:
            step(lives, name)
        lives.journal.close()
        return disk.writes


@pytest.mark.parametrize("moment", MOMENTS)
def test_killed_at_any_write_an_agent_keeps_what_it_said_and_goes_on(
    tmp_path: Path, moment: Moment
) -> None:
    writes = writes_of_the_story(tmp_path / "whole")
    assert writes > 10
    for fatal in range(1, writes):  # the first write makes a journal, which was not reported yet
        with killing_disk() as disk:
            disk.kill_at(fatal, moment)
            lives = Lives(tmp_path / f"killed-{fatal}")
            died = 0
            for name in STORY:
                # Who got no answer asks again.
                while not lives.do(partial(step, lives, name)):
                    died += 1
                lives.check()
            assert died <= 1
            # Killed between the record of a goal and its answer, it counts as lost and never moves.
            assert lives.motions["a"] == 1 or lives.known["a"] is Outcome.LOST
            assert lives.motions["d"] == 0
            lives.journal.close()


class AnyLives(RuleBasedStateMachine):
    """Any events in any order, with deaths between them and at any write."""

    def __init__(self) -> None:
        super().__init__()
        self._opened = ExitStack()
        folder = self._opened.enter_context(tempfile.TemporaryDirectory())
        self.disk = self._opened.enter_context(killing_disk())
        self.lives = Lives(Path(folder))

    def teardown(self) -> None:
        self.lives.journal.close()
        self._opened.close()

    @rule(
        name=st.sampled_from([*STEPS, *MORE_STEPS]),
        death=st.none() | st.tuples(st.integers(0, 3), st.sampled_from(MOMENTS)),
    )
    def happens(self, name: str, death: tuple[int, Moment] | None) -> None:
        if death is not None:
            self.disk.kill_at(*death)
        self.lives.do(lambda: step(self.lives, name))
        self.disk.spare()

    @invariant()
    def every_promise_is_kept(self) -> None:
        self.lives.check()


AnyLives.TestCase.settings = settings(max_examples=80, stateful_step_count=40, deadline=None)
TestAnyLives = AnyLives.TestCase
