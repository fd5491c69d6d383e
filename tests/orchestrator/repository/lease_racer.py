"""A process that races others for robots."""

from __future__ import annotations

from multiprocessing.connection import Connection
from multiprocessing.synchronize import Barrier

from nufleet.orchestrator.repository.errors import LeaseHeldError
from nufleet.orchestrator.repository.repository import open_repository

PATIENCE_S = 120.0


def race(address: str, number: int, rounds: int, start: Barrier, answers: Connection) -> None:
    """Open a database together with the others, then ask for the same robots again and again.

    Sends the rounds that it won, each with the epochs of its leases.
    """
    won: list[tuple[int, list[int]]] = []
    robots = ["r1", "r2", "r3"]
    start.wait(PATIENCE_S)
    with open_repository(address) as repository:
        for n in range(rounds):
            start.wait(PATIENCE_S)
            try:
                leases = repository.leases.acquire(
                    "lab", robots if number else reversed(robots), owner=f"o{number}", term_s=60.0
                )
            except LeaseHeldError:
                leases = ()
            start.wait(PATIENCE_S)
            repository.leases.release(leases)
            if leases:
                won.append((n, [lease.epoch for lease in leases]))
    answers.send(won)
