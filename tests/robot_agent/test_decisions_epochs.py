"""Decisions between orchestrators with leases, over restarts of the agent."""

from __future__ import annotations

import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

import pytest
from agent_lives import EXCITATION, MOMENTS, Died, Moment, killing_disk, result_of
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule
from puppet_robot import puppet_spec

from nufleet.robot_agent.decisions import Assignment, Decisions
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.journal.journal import Journal
from nufleet.robot_agent.planner import Planner
from nufleet.robot_agent.rules.ownership import WAITS_S, Commander
from nufleet.shared import private_files
from nufleet.shared.errors import RefusedError
from nufleet.shared.wire.messages import GoalAccepted, GoalRequest, Outcome, Refusal

OWNERS = ("o-1", "o-2", "o-3")
owners = st.sampled_from(OWNERS)
epochs = st.integers(0, 4)


@dataclass
class Clock:
    """A clock that shows what it was set to."""

    now_s: float = 100.0

    def __call__(self) -> float:
        return self.now_s


def decisions_over(journal: Journal, clock: Callable[[], float]) -> Decisions:
    planner = Planner("r", puppet_spec(), (), Memory(None), None)
    return Decisions("boot", planner, journal, threading.Event(), clock)


@contextmanager
def agent_on(
    folder: Path, *alive: str, clock: Callable[[], float] = time.monotonic
) -> Iterator[Decisions]:
    with Journal(folder) as journal:
        decisions = decisions_over(journal, clock)
        for owner in alive:
            decisions.owner_appeared(owner)
        yield decisions


def take(
    decisions: Decisions, goal_id: str, owner: str, epoch: int
) -> tuple[str, Assignment | None]:
    """Return the code of the refusal, or "yes"; and the motion that begins."""
    request = GoalRequest(goal_id=goal_id, owner=owner, epoch=epoch, motion=EXCITATION)
    answer, motion = decisions.take(request)
    return (answer.code if isinstance(answer, Refusal) else "yes"), motion


def begun(decisions: Decisions, goal_id: str, owner: str, epoch: int) -> Assignment:
    motion = take(decisions, goal_id, owner, epoch)[1]
    assert motion is not None
    return motion


def code_of(refusal: Refusal | None) -> str:
    return "yes" if refusal is None else refusal.code


def test_the_highest_epoch_and_its_owner_outlast_the_agent(tmp_path: Path) -> None:
    with agent_on(tmp_path, *OWNERS) as decisions:
        assert decisions.commander is None
        decisions.ended(result_of(begun(decisions, "a", "o-1", 3)), None)
        assert decisions.commander == Commander("o-1", 3)
        assert take(decisions, "b", "o-2", 2)[0] == "stale-epoch"
    with agent_on(tmp_path, *OWNERS) as decisions:
        assert decisions.commander == Commander("o-1", 3)
        assert take(decisions, "b", "o-2", 2)[0] == "stale-epoch"
        assert take(decisions, "b", "o-2", 3)[0] == "stale-epoch"
        begun(decisions, "b", "o-2", 4)
        assert take(decisions, "c", "o-1", 3)[0] == "stale-epoch"


def test_a_live_owners_motion_goes_on_whatever_others_send(tmp_path: Path) -> None:
    with agent_on(tmp_path, *OWNERS) as decisions:
        motion = begun(decisions, "a", "o-1", 3)
        other = Commander("o-2", 9)
        assert take(decisions, "b", "o-2", 9)[0] == "busy"
        assert take(decisions, "a", "o-2", 9)[0] == "busy"
        assert code_of(decisions.cancel("a", other)) == "busy"
        assert code_of(decisions.cancel("a", Commander("o-2", 2))) == "stale-epoch"
        assert code_of(decisions.change(other)) == "busy"
        assert code_of(decisions.acknowledge(["a"], other)) == "busy"
        assert motion.switch.order is None
        assert decisions.commander == Commander("o-1", 3)


def test_whoever_waits_under_a_higher_epoch_commands_the_robot_next(tmp_path: Path) -> None:
    with agent_on(tmp_path, *OWNERS) as decisions:
        motion = begun(decisions, "a", "o-1", 3)
        assert take(decisions, "b", "o-2", 4)[0] == "busy"
        assert take(decisions, "a", "o-1", 3)[0] == "yes"  # its running goal, sent a second time
        decisions.ended(result_of(motion), None)
        refused, _ = decisions.take(
            GoalRequest(goal_id="c", owner="o-1", epoch=3, motion=EXCITATION)
        )
        assert isinstance(refused, Refusal)
        assert refused.code == "busy"
        assert refused.reason == "o-2 waits for it and commands it next, epoch 4"
        assert code_of(decisions.acknowledge(["a"], Commander("o-1", 3))) == "yes"
        begun(decisions, "b", "o-2", 4)


def test_an_owner_that_returns_while_its_motion_ends_does_not_outrun_the_one_that_waits(
    tmp_path: Path,
) -> None:
    with agent_on(tmp_path, *OWNERS) as decisions:
        motion = begun(decisions, "a", "o-1", 3)
        decisions.owner_lost("o-1")  # the robot comes to rest
        assert take(decisions, "b", "o-2", 4)[0] == "busy"
        decisions.owner_appeared("o-1")
        decisions.ended(result_of(motion), None)
        assert take(decisions, "c", "o-1", 3)[0] == "busy"
        begun(decisions, "b", "o-2", 4)


def test_nobody_waits_for_an_orchestrator_that_waited_and_is_gone(tmp_path: Path) -> None:
    with agent_on(tmp_path, *OWNERS) as decisions:
        motion = begun(decisions, "a", "o-1", 3)
        assert take(decisions, "b", "o-2", 4)[0] == "busy"
        decisions.ended(result_of(motion), None)
        decisions.owner_lost("o-2")
        begun(decisions, "c", "o-1", 3)


def test_who_stopped_asking_keeps_nobody_from_a_robot_although_it_is_alive(tmp_path: Path) -> None:
    clock = Clock()
    with agent_on(tmp_path, *OWNERS, clock=clock) as decisions:
        motion = begun(decisions, "a", "o-1", 3)
        assert take(decisions, "b", "o-2", 4)[0] == "busy"
        decisions.ended(result_of(motion), None)
        clock.now_s += WAITS_S
        assert take(decisions, "c", "o-1", 3)[0] == "busy"
        clock.now_s += 0.01
        begun(decisions, "c", "o-1", 3)


def test_who_waited_and_is_gone_keeps_nobody_else_from_waiting(tmp_path: Path) -> None:
    with agent_on(tmp_path, *OWNERS) as decisions:
        motion = begun(decisions, "a", "o-1", 3)
        assert take(decisions, "b", "o-3", 9)[0] == "busy"
        decisions.owner_lost("o-3")
        assert take(decisions, "b", "o-2", 4)[0] == "busy"
        decisions.ended(result_of(motion), None)
        assert take(decisions, "c", "o-1", 3)[0] == "busy"
        begun(decisions, "b", "o-2", 4)


def test_who_waited_under_an_epoch_that_is_over_keeps_nobody_from_a_robot(tmp_path: Path) -> None:
    with agent_on(tmp_path, *OWNERS) as decisions:
        motion = begun(decisions, "a", "o-1", 3)
        assert take(decisions, "b", "o-2", 4)[0] == "busy"
        decisions.ended(result_of(motion), None)
        decisions.ended(result_of(begun(decisions, "c", "o-3", 5)), None)
        decisions.owner_lost("o-3")
        begun(decisions, "d", "o-1", 0)


def test_a_silent_owners_robot_rests_and_is_taken_over_and_the_owner_comes_back_too_late(
    tmp_path: Path,
) -> None:
    with agent_on(tmp_path, "o-1", "o-2") as decisions:
        motion = begun(decisions, "a", "o-1", 3)
        decisions.owner_lost("o-1")
        assert motion.switch.order == (Outcome.ABORTED, "its owner o-1 is gone")
        assert take(decisions, "b", "o-2", 4)[0] == "busy"  # it is coming to rest
        decisions.ended(result_of(motion), None)
        taken_over = begun(decisions, "b", "o-2", 4)
        decisions.owner_appeared("o-1")
        late = Commander("o-1", 3)
        assert take(decisions, "a", "o-1", 3)[0] == "stale-epoch"
        assert take(decisions, "c", "o-1", 3)[0] == "stale-epoch"
        assert code_of(decisions.cancel("b", late)) == "stale-epoch"
        assert code_of(decisions.acknowledge(["a"], late)) == "stale-epoch"
        assert code_of(decisions.change(late)) == "stale-epoch"
        assert taken_over.switch.order is None
        assert code_of(decisions.cancel("b", Commander("o-2", 4))) == "yes"


def test_who_began_a_motion_may_end_it_whatever_becomes_of_leases(tmp_path: Path) -> None:
    with agent_on(tmp_path, "o-1", "o-2") as decisions:
        decisions.ended(result_of(begun(decisions, "a", "o-1", 3)), None)
        decisions.owner_lost("o-1")
        motion = begun(decisions, "b", "o-2", 0)
        decisions.owner_appeared("o-1")
        assert take(decisions, "c", "o-2", 0)[0] == "stale-epoch"
        assert decisions.cancel("b", Commander("o-2")) is None
        assert motion.switch.order == (Outcome.CANCELLED, "cancelled")


def test_a_refused_request_takes_nothing_over(tmp_path: Path) -> None:
    too_much = EXCITATION.model_copy(update={"settle_s": 1e5})
    with agent_on(tmp_path, "o-1") as decisions:
        assert take(decisions, "a", "ghost", 7)[0] == "owner-not-alive"
        request = GoalRequest(goal_id="a", owner="o-1", epoch=7, motion=too_much)
        with pytest.raises(RefusedError):
            decisions.take(request)
        assert decisions.commander is None


def test_what_a_robot_flies_with_is_changed_under_an_epoch_too(tmp_path: Path) -> None:
    with agent_on(tmp_path, *OWNERS) as decisions:
        assert decisions.change(Commander("o-1", 2)) is None
        assert decisions.commander == Commander("o-1", 2)
        assert code_of(decisions.change(Commander("o-2", 1))) == "stale-epoch"
        assert take(decisions, "a", "o-2", 1)[0] == "stale-epoch"


def test_an_epoch_that_cannot_be_stored_is_not_begun(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    with agent_on(tmp_path, *OWNERS) as decisions:
        with monkeypatch.context() as disk:
            disk.setattr(private_files, "write_all", full)
            assert take(decisions, "a", "o-1", 2) == ("journal", None)
        assert decisions.commander is None
        assert decisions.state().goal_id is None
        begun(decisions, "a", "o-2", 1)


class Rivals(RuleBasedStateMachine):
    """Three orchestrators with any epochs, and an agent that dies between and at its writes."""

    def __init__(self) -> None:
        super().__init__()
        self._opened = ExitStack()
        self._folder = Path(self._opened.enter_context(tempfile.TemporaryDirectory()))
        self.disk = self._opened.enter_context(killing_disk())
        self.clock = Clock()
        self.alive: set[str] = set()
        self.motion: Assignment | None = None
        self.goals = 0
        self.highest = 0
        self._begin()

    def teardown(self) -> None:
        self.journal.close()
        self._opened.close()

    def _begin(self) -> None:
        self.motion = None
        self.waiting: Commander | None = None
        self.asked_s = 0.0
        self.journal = Journal(self._folder)
        self.decisions = decisions_over(self.journal, self.clock)
        for owner in self.alive:
            self.decisions.owner_appeared(owner)

    @rule(owner=owners)
    def owner_appears(self, owner: str) -> None:
        self.decisions.owner_appeared(owner)
        self.alive.add(owner)

    @rule(owner=owners)
    def owner_disappears(self, owner: str) -> None:
        self.decisions.owner_lost(owner)
        self.alive.discard(owner)

    @rule(seconds=st.sampled_from((0.25, WAITS_S - 0.25, WAITS_S, 2 * WAITS_S)))
    def time_passes(self, seconds: float) -> None:
        self.clock.now_s += seconds

    def _begins(self, sender: Commander) -> bool:
        """Whether the robot has to begin a new motion for a sender; notes who waits from now on."""
        held = self.decisions.commander
        obeyed = held is None or sender.epoch > held.epoch or sender == held
        if held is not None and not obeyed and sender.epoch in (0, held.epoch):
            obeyed = held.owner not in self.alive or (held.owner, 0) == (sender.owner, sender.epoch)
        if (
            self.clock.now_s - self.asked_s > WAITS_S
            or self.waiting is None
            or self.waiting.owner not in self.alive
            or (held is not None and self.waiting.epoch <= held.epoch)
        ):
            self.waiting = None
        next_epoch = 0 if self.waiting is None else self.waiting.epoch
        if self.motion is None:
            return sender.owner in self.alive and obeyed and sender.epoch >= next_epoch
        takes_over = obeyed and sender.epoch > 0 and sender != held
        if takes_over and sender.owner in self.alive and sender.epoch >= next_epoch:
            self.waiting, self.asked_s = sender, self.clock.now_s
        return False

    @rule()
    def agent_restarts(self) -> None:
        before = self.decisions.commander
        self.journal.close()
        self._begin()
        assert self.decisions.commander == before

    @rule(
        owner=owners,
        epoch=epochs,
        death=st.none() | st.tuples(st.integers(0, 2), st.sampled_from(MOMENTS)),
    )
    def submit(self, owner: str, epoch: int, death: tuple[int, Moment] | None) -> None:
        before = self.decisions.commander
        begins = self._begins(Commander(owner, epoch))
        if death is not None:
            self.disk.kill_at(*death)
        self.goals += 1
        request = GoalRequest(goal_id=f"g{self.goals}", owner=owner, epoch=epoch, motion=EXCITATION)
        try:
            answer, motion = self.decisions.take(request)
        except Died:
            self.disk.spare()
            self.journal.close()
            self._begin()
            assert self.decisions.commander in (before, Commander(owner, epoch))
            return
        self.disk.spare()
        assert (motion is not None) == begins
        if motion is None:
            assert isinstance(answer, Refusal)
            assert self.decisions.commander == before
            return
        assert isinstance(answer, GoalAccepted)
        assert epoch == 0 or epoch >= (0 if before is None else before.epoch)
        if epoch > 0:
            assert self.decisions.commander == Commander(owner, epoch)
        elif before is not None and before.owner in self.alive:
            assert before.owner == owner
        self.motion = motion

    @rule(owner=owners, epoch=epochs)
    def cancel(self, owner: str, epoch: int) -> None:
        if self.motion is None:
            return
        before = self.motion.switch.order
        refusal = self.decisions.cancel(self.motion.goal.goal_id, Commander(owner, epoch))
        if self.motion.goal.owner == owner:
            assert refusal is None
        held = self.decisions.commander
        if refusal is not None:
            assert self.motion.switch.order == before
        elif held is not None and self.motion.goal.owner != owner:
            assert epoch == 0 or epoch >= held.epoch

    @rule(owner=owners, epoch=epochs)
    def change(self, owner: str, epoch: int) -> None:
        refusal = self.decisions.change(Commander(owner, epoch))
        if self.motion is not None:
            assert refusal is not None
        if refusal is None and epoch > 0:
            assert self.decisions.commander == Commander(owner, epoch)

    @precondition(lambda self: self.motion is not None)
    @rule()
    def motion_ends(self) -> None:
        assert self.motion is not None
        self.decisions.ended(result_of(self.motion), None)
        self.motion = None

    @invariant()
    def the_epoch_never_falls(self) -> None:
        commander = self.decisions.commander
        epoch = 0 if commander is None else commander.epoch
        assert epoch >= self.highest
        self.highest = epoch


Rivals.TestCase.settings = settings(max_examples=80, stateful_step_count=40, deadline=None)
TestRivals = Rivals.TestCase
