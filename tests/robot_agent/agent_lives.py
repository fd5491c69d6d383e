"""One robot's decisions over the lives of several agent processes, beside a model of what holds.

What a process wrote stays; everything else is gone with it. `disk` can end a process at any of its
writes: before it, in the middle of it, or before it is known to have worked.
"""

from __future__ import annotations

import os
import threading
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Literal

import numpy as np
import pytest
from puppet_robot import puppet_spec

from nufleet.robot_agent.decisions import Assignment, Decisions
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.journal.journal import Journal
from nufleet.robot_agent.planner import Planner
from nufleet.robot_agent.rules.ownership import Commander
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared import private_files
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.messages import (
    GoalAccepted,
    GoalRequest,
    GoalResult,
    Outcome,
    Refusal,
    RobotStatus,
)

Moment = Literal["before", "within", "after"]
MOMENTS: tuple[Moment, ...] = ("before", "within", "after")
EXCITATION = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),), settle_s=0.0)


class Died(BaseException):
    """The process is gone: nothing in it can catch this."""


class Disk:
    """Counts the writes of a process, and ends it at one of them."""

    def __init__(self) -> None:
        self.writes = 0
        self._fatal: tuple[int, Moment] | None = None

    def kill_at(self, writes_from_now: int, moment: Moment) -> None:
        self._fatal = (self.writes + writes_from_now, moment)

    def spare(self) -> None:
        self._fatal = None

    def write(self, descriptor: int, data: bytes) -> None:
        fatal = self._fatal if self._fatal and self._fatal[0] == self.writes else None
        self.writes += 1
        if fatal is None or fatal[1] != "before":
            os.write(
                descriptor, data if fatal is None or fatal[1] == "after" else data[: len(data) // 2]
            )
        if fatal is not None:
            raise Died


@contextmanager
def killing_disk() -> Iterator[Disk]:
    """Put a disk under the journal that ends processes; a killed one needs nothing flushed."""
    disk = Disk()
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(private_files, "write_all", disk.write)
        patched.setattr("os.fsync", lambda descriptor: None)
        patched.setattr("os.fdatasync", lambda descriptor: None)
        yield disk


def result_of(motion: Assignment) -> GoalResult:
    outcome, reason = motion.switch.order or (Outcome.COMPLETED, "")
    samples = motion.plan.samples if motion.switch.order is None else 3
    return GoalResult(
        goal_id=motion.goal.goal_id,
        boot_id="boot",
        outcome=outcome,
        reason=reason,
        plan=motion.plan,
        reference=np.zeros(samples),
        response=np.zeros(samples),
    )


class Lives:
    """A robot whose agent dies and restarts; checks earlier promises at every step.

    In the model None says that a process died before it was known: either may be so. `known` says
    of each goal how it ended; one that is there without an end runs. `forgone` are those that were
    cancelled before they came.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self.motion: Assignment | None = None
        self.motions: Counter[str] = Counter()
        self.stopped: bool | None = False
        self.known: dict[str, Outcome | None] = {}
        self.perhaps: dict[str, set[Outcome | None]] = {}
        self.acknowledged: set[str] = set()
        self.forgone: set[str] = set()
        self.perhaps_forgone: set[str] = set()
        self.lives = 0
        self._begin()

    def do(self, step: Callable[[], None]) -> bool:
        """Take a step; return False when the process died of it, and begin the next one."""
        try:
            step()
        except Died:
            self.restart()
            return False
        return True

    def restart(self) -> None:
        self.journal.close()  # which writes nothing
        if self.motion is not None:
            self.perhaps.setdefault(self.motion.goal.goal_id, {Outcome.LOST})
        self.motion = None
        self._begin()
        assert self.journal.remembrance.damage is None
        status = self.decisions.state().status
        assert status in (RobotStatus.IDLE, RobotStatus.STOPPED)
        if self.stopped is not None:
            assert (status is RobotStatus.STOPPED) == self.stopped
        self.stopped = status is RobotStatus.STOPPED
        for goal_id, possible in self.perhaps.items():
            outcome = self._outcome(goal_id)
            assert outcome in possible
            if outcome is None:
                self.known.pop(goal_id, None)
            else:
                self.known[goal_id] = outcome
        self.perhaps.clear()
        # A cancel that was never confirmed may be on disk.
        self.forgone |= {g for g in self.perhaps_forgone if self._refusal(g) == "result-gone"}
        self.perhaps_forgone.clear()
        self.check()

    def check(self) -> None:
        """Check that every promise holds."""
        assert max(self.motions.values(), default=0) <= 1
        for goal_id, outcome in self.known.items():
            if goal_id in self.acknowledged:
                assert self._refusal(goal_id) in (None, "result-gone")
            elif outcome is not None:
                assert self._outcome(goal_id) is outcome
        for goal_id in self.forgone:
            assert self._refusal(goal_id) == "result-gone"
            assert self.motions[goal_id] == 0
        state = self.decisions.state()
        assert state.goal_id == (None if self.motion is None else self.motion.goal.goal_id)
        if self.motion is None:
            assert (state.status is RobotStatus.STOPPED) == self.stopped

    # Steps.

    def submit(self, goal_id: str) -> None:
        forgone = goal_id in self.forgone
        new = goal_id not in self.known and not forgone
        if new:
            self.perhaps[goal_id] = {None, Outcome.LOST}
        request = GoalRequest(goal_id=goal_id, owner="o", motion=EXCITATION)
        answer, motion = self.decisions.take(request)
        self.perhaps.pop(goal_id, None)
        if forgone:
            assert isinstance(answer, Refusal)
            assert (answer.code, motion) == ("cancelled", None)
            return
        if new and (self.stopped or self.motion is not None):
            assert isinstance(answer, Refusal)
            assert answer.code == ("stopped" if self.stopped else "busy")
            assert motion is None
            return
        assert isinstance(answer, GoalAccepted)
        assert (motion is not None) == new
        if motion is not None:
            self.motion = motion
            self.motions[goal_id] += 1
            self.known[goal_id] = None

    def cancel(self, goal_id: str) -> None:
        new = goal_id not in self.known
        if new:
            self.perhaps_forgone.add(goal_id)
        refusal = self.decisions.cancel(goal_id, Commander("o"))
        if new:
            assert refusal is None
            self.forgone.add(goal_id)
            self.perhaps_forgone.discard(goal_id)
        elif self.known[goal_id] is None:
            assert refusal is None
            assert self.motion is not None
            assert self.motion.switch.order is not None
        else:
            assert refusal is not None
            assert refusal.code == "goal-ended"

    def stop(self) -> None:
        if not self.stopped:
            self.stopped = None
        self.decisions.stop(StopOrder("alice", "smoke"))
        assert self.motion is None or self.motion.switch.order is not None
        self.decisions.store_stop()
        self.stopped = True

    def release(self) -> None:
        was, self.stopped = self.stopped, None if self.stopped else False
        refusal = self.decisions.release("bob")
        assert (refusal is not None) == (self.motion is not None)
        self.stopped = False if refusal is None else was

    def lose_owner(self) -> None:
        self.decisions.owner_lost("o")
        assert self.motion is None or self.motion.switch.order is not None
        self.decisions.owner_appeared("o")

    def end(self) -> None:
        if self.motion is None:
            return
        motion, result = self.motion, result_of(self.motion)
        self.perhaps[motion.goal.goal_id] = {Outcome.LOST, result.outcome}
        self.decisions.ended(result, None)
        self.perhaps.clear()
        self.known[motion.goal.goal_id] = result.outcome
        self.motion = None

    def acknowledge(self, goal_id: str) -> None:
        if self.known.get(goal_id) is not None:
            self.acknowledged.add(goal_id)
            assert self.decisions.acknowledge([goal_id], Commander("o")) is None
            assert self._refusal(goal_id) == "result-gone"

    # The process.

    def _begin(self) -> None:
        self.lives += 1
        self.journal = Journal(self._folder)
        planner = Planner("r", puppet_spec(), (), Memory(None), None)
        boot_id = f"boot-{self.lives}"
        self.decisions = Decisions(boot_id, planner, self.journal, threading.Event())
        self.decisions.owner_appeared("o")

    def _outcome(self, goal_id: str) -> Outcome | None:
        answer = self.decisions.result(goal_id)
        if isinstance(answer, GoalResult):
            return answer.outcome
        assert answer.code == "unknown-goal"
        return None

    def _refusal(self, goal_id: str) -> str | None:
        answer = self.decisions.result(goal_id)
        return answer.code if isinstance(answer, Refusal) else None
