"""A robot's durable journal: its goals and their results, its stop, and its owner.

The journal is a folder with an append-only log of small records, and a file for each result. A
record is on disk when its call returns, and the agent writes *before* it answers, so every fact
that it has confirmed survives. After a crash the log is read again. A record that was not written
to its end is cut off, since it was never confirmed. If a record was altered, the robot is stopped,
since that record might have been a stop.

A database in a single file would lose everything with its first page; a log that is cut anywhere
still holds all records before the cut.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import logging
import os
import threading
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from nufleet.robot_agent.journal import ledger
from nufleet.robot_agent.journal.ledger import JournalError, Ledger, LedgerGoal
from nufleet.robot_agent.journal.log import LogFile, continue_log, read_log, replace_log
from nufleet.robot_agent.journal.result_files import ResultFiles
from nufleet.robot_agent.rules.goal_machine import Goal, Goals
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared.errors import MalformedMessageError, system_errors_as
from nufleet.shared.frequency_test.excitation import ExcitationPlan
from nufleet.shared.private_files import make_private_folder, replace_privately
from nufleet.shared.wire.codec import decode, encode
from nufleet.shared.wire.messages import GoalResult, Outcome
from nufleet.shared.wire.motions import MotionPlan

LOG = "log"
DAMAGED_LOG = "log.damaged"
COMPACT_ABOVE_BYTES = 256 * 1024
"""Size above which the log is rewritten in compact form, unless it is smaller than twice its size
after the last rewriting."""

_log = logging.getLogger(__name__)


class JournalInUseError(JournalError):
    """Another process has this journal open: two agents serve one robot."""


@dataclass(frozen=True)
class Remembrance:
    """The content of the journal when an agent process begins."""

    goals: Goals
    """All goals known."""

    stop: StopOrder | None
    """Stop in force; None without one."""

    owner: ledger.Owned | None
    """Orchestrator that last commanded the robot, with its epoch; None when there was none."""

    lost: tuple[str, ...]
    """Ids of the goals in progress when the process before this one ended; they have ended as
    lost."""

    damage: str | None
    """Damage found in the log, in which case the robot is stopped; None for a sound log."""


class Journal:
    """One robot's journal, open for one agent process; usable from many threads, and to be closed.

    Every method that stores a fact returns when it is on disk, and raises JournalError when it is
    not; `acknowledged` is the exception. After a disk error that leaves the content of the disk in
    doubt, nothing more is stored.
    """

    def __init__(self, folder: Path) -> None:
        """Open a robot's journal, or create it; `remembrance` is its content at that moment.

        Args:
            folder: Folder of the journal, created if missing.

        Raises:
            JournalInUseError: Another process has the journal open.
            JournalError: The journal cannot be read or written, or a newer nufleet wrote it.
        """
        self._folder = folder
        results = folder / "results"
        self._incoming = folder / "incoming"
        self._mutex = threading.Lock()
        self._ledger = Ledger()
        self._compact_above_bytes = COMPACT_ABOVE_BYTES
        with contextlib.ExitStack() as opened:
            advice = "; choose a writable folder with NUFLEET_STATE, or free or repair the disk"
            with system_errors_as(JournalError, str(folder), advice):
                for made in (folder, results, self._incoming):
                    make_private_folder(made)
                self._take_lock(opened)
                self._log_file, damage = self._read()
                opened.callback(self._close_log)
                for path in self._incoming.iterdir():
                    path.unlink()  # left by a crash between two steps
                goals, kept = self._ledger.goals, self._ledger.kept
                known = {goal_id: goals[goal_id].sha256 for goal_id in kept}
                self._results = ResultFiles(results, {k: v for k, v in known.items() if v})
                lost = self._end_what_ran()
            self._closing = opened.pop_all()
        self.remembrance = Remembrance(
            goals=Goals(MappingProxyType({k: g.goal for k, g in self._ledger.goals.items()})),
            stop=self._ledger.stop,
            owner=self._ledger.owner,
            lost=lost,
            damage=damage,
        )

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the journal, so that other processes can open it; a second call does nothing."""
        with self._mutex:
            self._closing.close()

    def accepted(self, goal: Goal, plan: MotionPlan, boot_id: str) -> None:
        """Store that a goal was accepted, before the answer is sent and the motion begins.

        Args:
            goal: Goal that was accepted.
            plan: Plan of its motion.
            boot_id: Id of the agent process that plays it.
        """
        self._append(
            ledger.Accepted(
                goal_id=goal.goal_id,
                owner=goal.owner,
                digest=goal.digest,
                boot_id=boot_id,
                plan=plan,
            )
        )

    def ended(self, result: GoalResult) -> bool:
        """Store how a goal ended, and its samples if the disk has room for them.

        Returns:
            Whether the samples are stored; the end of the goal is in either case.
        """
        sha256, size_bytes = None, 0
        try:
            sha256, size_bytes = self._store_result(result)
        except (OSError, MalformedMessageError) as error:
            _log.warning(
                "%s: the result of %s cannot be kept: %s", self._folder, result.goal_id, error
            )
        self._append(
            ledger.Ended(
                goal_id=result.goal_id,
                outcome=result.outcome,
                sha256=sha256,
                size_bytes=size_bytes,
            )
        )
        return sha256 is not None

    def forgone(self, goal_id: str) -> None:
        """Store that a goal was cancelled before it arrived, before this is confirmed."""
        self._append(
            ledger.Ended(goal_id=goal_id, outcome=Outcome.CANCELLED, sha256=None, size_bytes=0)
        )

    def acknowledged(self, goal_ids: Iterable[str]) -> None:
        """Drop results that have arrived; unknown ids are ignored.

        This alone is not on disk when the call returns, but with the next record, most often the
        acceptance in the same request. After a power failure in between, the journal names results
        that are gone, and that their requester has: it asks for them no more.
        """
        self._append(ledger.Acknowledged(goal_ids=tuple(goal_ids)), durable=False)

    def stopped(self, order: StopOrder) -> None:
        """Store a stop; the robot is halted before this call, so a slow disk delays no stop."""
        self._append(ledger.Stopped(sender=order.sender, reason=order.reason))

    def released(self, sender: str) -> None:
        """Store that the stop is over, before the robot may move again."""
        self._append(ledger.Released(sender=sender))

    def owned(self, owner: str, epoch: int) -> None:
        """Store which orchestrator commands the robot, before anything is done under its epoch."""
        self._append(ledger.Owned(owner=owner, epoch=epoch))

    def forget_owner(self) -> ledger.Owned | None:
        """Remove the owner and its epoch from the journal.

        This is for a person to decide, since the robot obeys owners of the past again afterwards.

        Returns:
            The owner removed; None when there was none.

        Raises:
            JournalError: The change cannot be stored.
        """
        with self._mutex:
            forgotten, self._ledger.owner = self._ledger.owner, None
            if forgotten is not None:
                try:
                    self._replace_log()
                except OSError as error:
                    self._ledger.owner = forgotten
                    raise JournalError(
                        f"{self._folder}: {error.strerror}; free or repair the disk"
                    ) from error
        return forgotten

    def result(self, goal_id: str) -> GoalResult | None:
        """Return a goal's result; None when it was dropped or its file is damaged."""
        with self._mutex:
            known = self._ledger.goals.get(goal_id)
        if known is None or known.sha256 is None:
            return None
        try:
            data = self._results.read(goal_id)
            if hashlib.sha256(data).hexdigest() == known.sha256:
                return decode(data, GoalResult)
            problem = "its file was altered or cut off"
        except (OSError, MalformedMessageError) as error:
            problem = str(error)
        _log.warning("%s: the result of %s is lost: %s", self._folder, goal_id, problem)
        return None

    # Opening.

    def _take_lock(self, opened: contextlib.ExitStack) -> None:
        flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        lock = os.open(self._folder / "lock", flags, 0o600)
        opened.callback(os.close, lock)
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            raise JournalInUseError(
                f"{self._folder} is in use: another agent serves this robot; end one of them, "
                "or, if there are two robots, give each its own folder with --state"
            ) from error

    def _read(self) -> tuple[LogFile, str | None]:
        """Read the log into the ledger; return it open for appending, and its damage, if any."""
        path = self._folder / LOG
        if not path.exists():
            return self._new_log(), None
        found, data = read_log(path)
        for payload in found.payloads:
            self._ledger.apply(ledger.decode_record(payload))
        if found.damage is None:
            return continue_log(path, found), None
        damage = f"{path}: {found.damage}"
        _log.error("%s; the robot is stopped, and the file is kept as %s", damage, DAMAGED_LOG)
        reason = f"{damage[:1500]}; inspect the robot, then release it"
        self._ledger.apply(ledger.Stopped(sender="journal", reason=reason))
        damaged, part = self._folder / DAMAGED_LOG, self._incoming / "log.damaged"
        os.close(replace_privately(damaged, data, part))
        return self._new_log(), damage

    def _end_what_ran(self) -> tuple[str, ...]:
        """End the goals that were in progress when the previous process ended; return their ids."""
        lost = self._ledger.running
        for known in lost:
            self.ended(lost_result(known))
        return tuple(known.goal.goal_id for known in lost)

    # Writing.

    def _close_log(self) -> None:
        self._log_file.close()

    def _append(self, record: ledger.Record, *, durable: bool = True) -> None:
        with self._mutex:
            if self._ledger.says_already(record):
                return
            self._log_file.append(ledger.encode_record(record), durable=durable)
            for goal_id in self._ledger.apply(record):
                self._remove_result(goal_id)
            if self._log_file.size_bytes > self._compact_above_bytes:
                self._compact()

    def _remove_result(self, goal_id: str) -> None:
        try:
            self._results.drop(goal_id)
        except OSError as error:
            # The record already says that it is gone; the next process removes the file.
            _log.warning(
                "%s: the result of %s cannot be removed: %s",
                self._folder,
                goal_id,
                error.strerror,
            )

    def _compact(self) -> None:
        """Replace the log with a shorter one of the same content; a failure is only logged."""
        try:
            self._replace_log()
        except OSError as error:
            _log.warning("%s could not be shortened: %s", self._folder, error.strerror)
        self._compact_above_bytes = max(COMPACT_ABOVE_BYTES, 2 * self._log_file.size_bytes)

    def _replace_log(self) -> None:
        """Replace the open log with one made from the ledger; raises OSError."""
        old = self._log_file
        try:
            self._log_file = self._new_log()
        except OSError:
            old.check_in_place()
            raise
        old.close()

    def _new_log(self) -> LogFile:
        payloads = map(ledger.encode_record, self._ledger.records())
        return replace_log(self._folder / LOG, payloads, self._incoming / "log.new")

    def _store_result(self, result: GoalResult) -> tuple[str, int]:
        data = encode(result)
        self._results.store(result.goal_id, data)
        return hashlib.sha256(data).hexdigest(), len(data)


def lost_result(known: LedgerGoal) -> GoalResult:
    """Return the result of a goal whose agent process died: lost, without samples.

    Raises:
        ValueError: The goal was not running.
    """
    if known.plan is None:
        raise ValueError(f"goal {known.goal.goal_id} is not running")
    plan = known.plan
    nothing = np.empty((0, *plan.columns) if isinstance(plan, ExcitationPlan) else (0, 0))
    return GoalResult(
        goal_id=known.goal.goal_id,
        boot_id=known.boot_id,
        outcome=Outcome.LOST,
        reason=f"lost: the agent process {known.boot_id} ended during it; send a new attempt",
        plan=known.plan,
        reference=nothing,
        response=nothing,
    )
