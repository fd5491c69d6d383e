"""Removes the fixes of earlier defects, one at a time, each of which a simulation must then find.

A simulation that finds no defect proves little unless it is known which defects it would find.
"""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import Any
from unittest.mock import patch

from benchmarks.faults.simulation import orchestrator as simulated
from benchmarks.faults.simulation import repository as kept
from benchmarks.faults.simulation.conducting import Conduct
from benchmarks.faults.simulation.leasing import Leasing
from nufleet.orchestrator.conduct import attempts
from nufleet.orchestrator.conduct import leases as robot_leases
from nufleet.orchestrator.fleet.goal_events import (
    Ask,
    CancelTaken,
    Ended,
    Event,
    InterruptAsked,
    Question,
    Refused,
    Unanswered,
)
from nufleet.orchestrator.fleet.goal_pursuit import Pursuit
from nufleet.orchestrator.repository import lease_rules
from nufleet.orchestrator.repository.errors import LeaseLostError
from nufleet.orchestrator.repository.lease_rules import StoredLease
from nufleet.orchestrator.repository.records import Lease
from nufleet.robot_agent import stop_service
from nufleet.robot_agent.decisions import Decisions
from nufleet.robot_agent.motion.pace import HaltSwitch
from nufleet.robot_agent.motion.sortie import Sortie
from nufleet.robot_agent.motion.watched_robot import WatchedRobot
from nufleet.robot_agent.robot import RobotAround
from nufleet.robot_agent.rules import fitness, goal_machine, ownership, supervisor
from nufleet.robot_agent.rules.freezes import Freezes
from nufleet.robot_agent.rules.supervisor import Supervision
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan
from nufleet.shared.frequency_test.quality import Quality
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Description

Patches = Iterator[Any]


def _interrupt_once() -> Patches:
    """Ctrl-C cancels running goals once; a goal being submitted is submitted again (defect 1)."""
    take, told = Pursuit.take, weakref.WeakSet[Pursuit]()

    def took(self: Pursuit, event: Event, now_s: float) -> tuple[Ask, ...]:
        if isinstance(event, InterruptAsked) and self._sent:
            told.add(self)
            return (Ask(Question.CANCEL, self.goal_id),)
        answer = isinstance(event, CancelTaken | Refused | Unanswered)
        if self in told and answer and _question(event) is Question.CANCEL:
            return ()
        return take(self, event, now_s)

    yield patch.object(Pursuit, "take", took)
    yield patch.object(goal_machine, "forgo", lambda goals, goal_id, owner: goals)


def _question(event: Any) -> Question:
    question: Question = event.question
    return question


def _believe_old_states() -> Patches:
    """A state from before the goal, or silence for a while, ends the robot's part (defect 6)."""
    refused = Pursuit._note_refusal  # noqa: SLF001 - what is taken out lies inside

    def noted(self: Pursuit, question: Question, error: Any, now_s: float) -> None:
        if question is Question.RESULT and error.code == "not-finished" and not self._cancelling:
            self.ended = Ended(error=error)
        else:
            refused(self, question, error, now_s)

    yield patch.object(Pursuit, "_note_refusal", noted)


def _compare_epochs() -> Patches:
    """An owner whose epoch this repository has passed counts as gone (defect 10)."""

    def check(
        fleet: Any, descriptions: Mapping[str, Description], given: Mapping[str, Any]
    ) -> None:
        others = {
            robot: found
            for robot, found in descriptions.items()
            if robot not in given or found.epoch > given[robot].epoch
        }
        checked(fleet, others, {})

    checked = robot_leases.check_others
    yield patch.object(robot_leases, "check_others", check)


def _lengthen_without_limit() -> Patches:
    """A test is repeated with twice the time, even if its robot will refuse that (defect 11)."""

    def longer(
        excitation: Excitation, plan: ExcitationPlan, quality: Quality, spec: RobotSpec
    ) -> Excitation:
        del quality, spec
        settle = max(plan.settle_samples, plan.ramp_samples) * plan.sample_time_s
        segment = plan.segment_samples * plan.sample_time_s
        update = {"settle_s": 2 * settle, "segment_min_s": 2 * segment}
        return excitation.model_copy(update=update)

    yield patch.object(attempts, "retried", longer)


def _time_leases() -> Patches:
    """A lease is lost when the clock says so, although no other owner took it (defect 12)."""

    def check(stored: StoredLease, lease: Lease) -> None:
        check_held(stored, lease)
        left_s = stored.expires_s - clock[0]()
        if not 0.0 < left_s <= stored.term_s:
            raise LeaseLostError(lease.robot, lease.owner, lease.epoch, "it was not renewed")

    def renewed(self: Leasing) -> None:
        clock[0] = self.clock
        renew(self)

    clock: list[Callable[[], float]] = []
    clock.append(lambda: 0.0)
    check_held = lease_rules.check_held
    renew = Leasing._renew  # noqa: SLF001 - as above
    yield patch.object(kept, "check_held", check)
    yield patch.object(Leasing, "_renew", renewed)


def _interrupt_in_turn() -> Patches:
    """Ctrl-C reaches each robot only when the one before it has answered (defect 16)."""

    def interrupted(self: Conduct) -> None:
        process = self._process
        for place, run in enumerate(tuple(self._runs.values())):
            process.world.after(
                simulated.REST_WITHIN_S * place,
                partial(process.node.do, partial(self._take, run, InterruptAsked())),
            )

    yield patch.object(Conduct, "interrupt", interrupted)


def _forget_forgone() -> Patches:
    """A goal cancelled before it arrives is not recorded, and moves its robot when it arrives."""
    yield patch.object(goal_machine, "forgo", lambda goals, goal_id, owner: goals)


def _wake_at_once() -> Patches:
    """An agent that was frozen takes the goals that waited, even of owners that have gone since."""
    yield patch.object(Freezes, "refusal", lambda self, now_s: None)


def _forget_who_waits() -> Patches:
    """A robot stays with the owner that sends each goal as soon as the one before has ended."""
    yield patch.object(ownership, "refusal_to_begin", lambda *asked, **circumstances: None)


def _drop_the_refused() -> Patches:
    """A refused goal is over at once, although a copy of it may still arrive."""

    def noted(self: Pursuit, error: Any, now_s: float) -> None:
        refused(self, error, now_s)
        if self._given_up is error:
            self.ended = Ended(error=error)

    refused = Pursuit._note_goal_refused  # noqa: SLF001 - as above
    yield patch.object(Pursuit, "_note_goal_refused", noted)


def _ask_the_killed() -> Patches:
    """A robot whose motors were cut is asked to rest and to land like any other."""
    yield patch.object(WatchedRobot, "kill", RobotAround.kill)


def _trust_the_killed() -> Patches:
    """That motors were cut is no fault, and a release does not reconnect the robot."""
    cut = Decisions.cut
    yield patch.object(Decisions, "cut", lambda self, fault: cut(self, None))


def _release_the_killed() -> Patches:
    """A robot is released while its motors are being cut, and reconnected under the cut."""
    yield patch.object(Decisions, "cutting", lambda self: None)


def _fly_after_a_freeze() -> Patches:
    """A process that was frozen while its robot took off begins the motion all the same."""

    def move(self: Sortie, switch: HaltSwitch, hindrance: Any, *others: Any) -> Any:
        del hindrance
        return (yield from moved(self, switch, lambda: None, *others))

    moved = Sortie.move
    yield patch.object(Sortie, "move", move)


def _store_no_kill() -> Patches:
    """A kill is confirmed when the motors are cut, whether its stop is stored or not."""
    yield patch.object(stop_service, "_both", lambda killing, stored: killing)


def _cure_everything() -> Patches:
    """A reconnection cures every fault, although motors were cut during it."""

    def cured(self: Decisions, fault: str | None, *, stops: int) -> str | None:
        del stops
        return reconnected(self, fault, stops=self.stops)

    reconnected = Decisions.reconnected
    yield patch.object(Decisions, "reconnected", cured)


def _accept_unready() -> Patches:
    """A robot takes goals in good health and in bad."""

    def refusal(state: Supervision, **circumstances: Any) -> Any:
        return refused(replace(state, unfit=None), **circumstances)

    refused = supervisor.refusal_to_start
    yield patch.object(supervisor, "refusal_to_start", refusal)


def _move_unready() -> Patches:
    """A robot whose health becomes bad continues its motion."""

    def supervised(state: Supervision, event: supervisor.Event) -> tuple[Supervision, Any]:
        after, halt = supervise(state, event)
        return after, None if isinstance(event, supervisor.HealthReported) else halt

    supervise = supervisor.supervise
    yield patch.object(supervisor, "supervise", supervised)


def _believe_old_health() -> Patches:
    """A robot moves by its last report of health, however old it is."""
    unfit = fitness.unfit
    yield patch.object(fitness, "unfit", lambda health, age_s: unfit(health, 0.0))


def _take_off_halted() -> Patches:
    """A robot takes off for a goal that was halted before its turn came."""

    def move(self: Sortie, switch: HaltSwitch, *circumstances: Any) -> Any:
        del switch
        return (yield from moved(self, HaltSwitch(), *circumstances))

    moved = Sortie.move
    yield patch.object(Sortie, "move", move)


def _stay_begun() -> Patches:
    """A robot that has landed is not asked to take off again."""

    def end(self: Sortie) -> Any:
        failed = yield from ended(self)
        self.begun = True
        return failed

    ended = Sortie.end
    yield patch.object(Sortie, "end", end)


WITHOUT: Mapping[str, Callable[[], Patches]] = {
    "1-interrupt": _interrupt_once,
    "6-late-states": _believe_old_states,
    "10-repositories": _compare_epochs,
    "11-longer": _lengthen_without_limit,
    "12-clock": _time_leases,
    "16-in-turn": _interrupt_in_turn,
    "forgone": _forget_forgone,
    "frozen": _wake_at_once,
    "starved": _forget_who_waits,
    "refused": _drop_the_refused,
    "killed": _ask_the_killed,
    "kill-fault": _trust_the_killed,
    "kill-stored": _store_no_kill,
    "kill-cured": _cure_everything,
    "kill-released": _release_the_killed,
    "frozen-beginning": _fly_after_a_freeze,
    "unready": _accept_unready,
    "unready-moving": _move_unready,
    "old-health": _believe_old_health,
    "halted": _take_off_halted,
    "landed": _stay_begun,
}


@contextmanager
def without(name: str | None) -> Iterator[None]:
    """Remove a fix within this context; None leaves all fixes in place."""
    patches = () if name is None else tuple(WITHOUT[name]())
    begun = []
    try:
        for fix in patches:
            fix.start()
            begun.append(fix)
        yield
    finally:
        for fix in reversed(begun):
            fix.stop()
