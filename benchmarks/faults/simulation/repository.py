"""A repository in memory that follows the product's rules, on a disk that may be full."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

from nufleet.orchestrator.conduct.replay import OpenTest
from nufleet.orchestrator.repository.errors import RepositoryError
from nufleet.orchestrator.repository.lease_rules import (
    RELEASED_S,
    StoredLease,
    acquired,
    check_held,
)
from nufleet.orchestrator.repository.records import (
    LastLease,
    Lease,
    Renewal,
    TrialEnd,
    TrialIntent,
    TrialRecord,
    TrialStatus,
)
from nufleet.orchestrator.repository.trial_rules import (
    check_epoch,
    check_same_intent,
    is_new_acceptance,
    is_new_end,
)
from nufleet.shared.wire.messages import GoalAccepted

TERM_S = 8.0


class SimulatedRepository:
    """The trials and leases that outlive the orchestrators sharing this repository."""

    def __init__(self) -> None:
        self.trials: dict[str, TrialRecord] = {}
        self.leases: dict[str, StoredLease] = {}
        self.full = False

    def write(self) -> None:
        """Check that the disk has room; raises RepositoryError if not."""
        if self.full:
            raise RepositoryError("the repository cannot be written: no space left on the device")

    # Leases.

    def acquire(
        self,
        robots: Iterable[str],
        *,
        owner: str,
        above_epochs: Mapping[str, int],
        now_s: float,
        silent: Iterable[Renewal],
    ) -> tuple[Lease, ...]:
        """Lease robots to an owner, all or none; raises LeaseHeldError or RepositoryError."""
        self.write()
        leases = tuple(
            acquired(
                self._stored(robot),
                owner=owner,
                term_s=TERM_S,
                above_epoch=above_epochs[robot],
                now_s=now_s,
                silent=tuple(silent),
            )
            for robot in robots
        )
        for lease in leases:
            self._store(lease, owner, now_s + TERM_S)
        return leases

    def renew(self, leases: Iterable[Lease], now_s: float) -> None:
        """Restart the term of leases; raises LeaseLostError or RepositoryError."""
        self.write()
        for lease in leases:
            check_held(self._stored(lease.robot), lease)
        for lease in leases:
            self._store(lease, lease.owner, now_s + TERM_S)

    def release(self, leases: Iterable[Lease]) -> None:
        """Give leases back."""
        for lease in leases:
            known = self._stored(lease.robot)
            if (known.owner, known.epoch) == (lease.owner, lease.epoch):
                self._store(lease, lease.owner, RELEASED_S)

    def last(self, now_s: float) -> Mapping[str, LastLease]:
        """Return each robot's last lease, as `LeaseStore.last` does."""
        return {
            robot: LastLease(
                owner=known.owner,
                epoch=known.epoch,
                silent=not known.released and known.remaining_s(now_s) == 0.0,
            )
            for robot, known in self.leases.items()
            if known.owner is not None
        }

    def _stored(self, robot: str) -> StoredLease:
        return self.leases.get(robot, StoredLease("sim", robot, None, 0, TERM_S, RELEASED_S))

    def _store(self, lease: Lease, owner: str, expires_s: float) -> None:
        self.leases[lease.robot] = StoredLease(
            "sim", lease.robot, owner, lease.epoch, TERM_S, expires_s
        )


class SimulatedLog:
    """One orchestrator's view of the trials, with the interface of `TrialLog`."""

    def __init__(
        self, repository: SimulatedRepository, study_id: str, epochs: Mapping[str, int]
    ) -> None:
        self._repository = repository
        self.study_id = study_id
        self._epochs = epochs

    def intend(self, tests: Iterable[OpenTest]) -> None:
        self._repository.write()
        trials = self._repository.trials
        for test in tests:
            intent = TrialIntent(
                test.goal_id,
                self.study_id,
                test.iteration,
                test.robot,
                test.attempt,
                test.excitation,
                self._epochs[test.robot],
            )
            known = trials.get(test.goal_id)
            if known is None:
                trials[test.goal_id] = TrialRecord(intent, TrialStatus.INTENDED)
            else:
                check_same_intent(known, intent)
                trials[test.goal_id] = replace(known, intent=intent)

    def accepted(self, test: OpenTest, accepted: GoalAccepted) -> None:
        known = self._known(test)
        if is_new_acceptance(known, accepted.boot_id):
            self._put(replace(known, status=TrialStatus.ACCEPTED, boot_id=accepted.boot_id))

    def ended(self, test: OpenTest, end: TrialEnd) -> None:
        known = self._known(test)
        if is_new_end(known, end.status):
            result = end.result
            self._put(
                replace(
                    known,
                    status=end.status,
                    reason=end.reason,
                    retry=end.retry,
                    interrupted=end.interrupted,
                    boot_id=known.boot_id if result is None else result.boot_id,
                    outcome=None if result is None else result.outcome,
                    response=end.response,
                )
            )

    def _known(self, test: OpenTest) -> TrialRecord:
        self._repository.write()
        known = self._repository.trials[test.goal_id]
        check_epoch(known, self._epochs[test.robot])
        return known

    def _put(self, trial: TrialRecord) -> None:
        self._repository.trials[trial.intent.goal_id] = trial
