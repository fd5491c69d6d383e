"""Grants leases on robots so that exactly one of several competing orchestrators succeeds."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from sqlalchemy import Connection, bindparam, select, tuple_

from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.errors import LeaseHeldError
from nufleet.orchestrator.repository.lease_rules import (
    RELEASED_S,
    StoredLease,
    acquired,
    check_held,
)
from nufleet.orchestrator.repository.records import LastLease, Lease, Renewal
from nufleet.orchestrator.repository.tables import LEASES
from nufleet.orchestrator.repository.upsert import insert_new


class LeaseStore:
    """Acquires, renews and releases leases; each call changes all of them or none."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def acquire(
        self,
        fleet: str,
        robots: Iterable[str],
        *,
        owner: str,
        term_s: float,
        above_epochs: Mapping[str, int] | None = None,
        silent: Collection[Renewal] = (),
    ) -> tuple[Lease, ...]:
        """Acquire leases on all the robots, or on none.

        Args:
            fleet: Name under which the fleet is leased.
            robots: Names of the robots to acquire.
            owner: Id of the owner, unique to this process.
            term_s: Time in s for which a lease holds without being renewed.
            above_epochs: Latest epoch that each robot has seen, by robot; the new one is higher.
            silent: Renewals that the owner saw unchanged for a whole term of its own clock.

        Returns:
            One lease per robot.

        Raises:
            LeaseHeldError: A robot belongs to another owner.
            EpochOutOfRangeError: A robot has seen an epoch that no repository grants.
        """
        names = sorted(set(robots))
        seen = above_epochs or {}
        with self._database.write() as connection:
            free = {"owner": None, "epoch": 0, "term_s": term_s, "expires_s": 0.0}
            rows = [{"fleet": fleet, "robot": name, **free} for name in names]
            if rows:
                connection.execute(insert_new(connection, LEASES), rows)
            stored = _locked(connection, [(fleet, name) for name in names])
            now_s = self._database.now_s(connection)
            leases, refused = [], []
            for name in names:
                try:
                    leases.append(
                        acquired(
                            stored[fleet, name],
                            owner=owner,
                            term_s=term_s,
                            above_epoch=seen.get(name, 0),
                            now_s=now_s,
                            silent=silent,
                        )
                    )
                except LeaseHeldError as held:
                    refused.append(held)
            if refused:
                renewals = [renewal for held in refused for renewal in held.renewals]
                raise LeaseHeldError(renewals, refused[0].remaining_s)
            _store(connection, [(lease, now_s + term_s) for lease in leases])
        return tuple(leases)

    def renew(self, leases: Iterable[Lease]) -> None:
        """Restart the term of leases.

        Raises:
            LeaseLostError: One of the leases is lost; none is renewed.
        """
        self._change(tuple(leases), renewing=True)

    def release(self, leases: Iterable[Lease]) -> None:
        """Release leases, so that other orchestrators need not wait; lost leases are ignored.

        The epoch stays stored, so that the next one is higher.
        """
        self._change(tuple(leases), renewing=False)

    def held(self, fleet: str) -> Mapping[str, tuple[str, int, float]]:
        """Return owner, epoch and remaining time in s for each robot that is owned now."""
        rows, now_s = self._rows(fleet)
        return {
            row.robot: (row.owner, row.epoch, row.remaining_s(now_s))
            for row in rows
            if row.owner is not None and row.remaining_s(now_s) > 0.0
        }

    def last(self, fleet: str) -> Mapping[str, LastLease]:
        """Return the last lease of each robot that was ever owned, by robot."""
        rows, now_s = self._rows(fleet)
        return {
            row.robot: LastLease(
                row.owner, row.epoch, not row.released and row.remaining_s(now_s) == 0.0
            )
            for row in rows
            if row.owner is not None
        }

    def _rows(self, fleet: str) -> tuple[list[StoredLease], float]:
        """Return the stored leases of a fleet's robots, and the database's time in s."""
        query = select(LEASES).where(LEASES.c.fleet == fleet).order_by(LEASES.c.robot)
        with self._database.read() as connection:
            rows = [StoredLease(*row) for row in connection.execute(query)]
            return rows, self._database.now_s(connection)

    def _change(self, leases: tuple[Lease, ...], *, renewing: bool) -> None:
        # Together with the results of tests: SQLite does not serve those that wait for its lock in
        # turn, so a stream of results could keep a renewal waiting until the leases run out.
        def work(connection: Connection) -> None:
            stored = _locked(connection, [(lease.fleet, lease.robot) for lease in leases])
            now_s = self._database.now_s(connection)
            changes = []
            for lease in leases:
                known = stored[lease.fleet, lease.robot]
                if renewing:
                    check_held(known, lease)
                    changes.append((lease, now_s + lease.term_s))
                elif (known.owner, known.epoch) == (lease.owner, lease.epoch):
                    changes.append((lease, RELEASED_S))
            _store(connection, changes)

        self._database.write_together(work)


def _locked(
    connection: Connection, keys: list[tuple[str, str]]
) -> dict[tuple[str, str], StoredLease]:
    """Return the rows of robots, locked until the transaction ends.

    All processes lock them in the same order, so that no two wait for each other.
    """
    query = (
        select(LEASES)
        .where(tuple_(LEASES.c.fleet, LEASES.c.robot).in_(keys))
        .order_by(LEASES.c.fleet, LEASES.c.robot)
        .with_for_update()
    )
    rows = (StoredLease(*row) for row in connection.execute(query))
    return {(row.fleet, row.robot): row for row in rows}


def _store(connection: Connection, changes: list[tuple[Lease, float]]) -> None:
    """Store leases with the times in s at which they expire."""
    rows = [
        {
            "in_fleet": lease.fleet,
            "of_robot": lease.robot,
            "owner": lease.owner,
            "epoch": lease.epoch,
            "term_s": lease.term_s,
            "expires_s": expires_s,
        }
        for lease, expires_s in changes
    ]
    if rows:
        connection.execute(_STORE, rows)


# One statement for all leases, built once: a fleet's leases are renewed every two seconds.
_STORE = LEASES.update().where(
    LEASES.c.fleet == bindparam("in_fleet"), LEASES.c.robot == bindparam("of_robot")
)
