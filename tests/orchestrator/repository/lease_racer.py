"""A process that races others for robots."""

from __future__ import annotations

from multiprocessing.connection import Connection
from multiprocessing.synchronize import Barrier

from orchestrator.repository.errors import LeaseHeldError
from orchestrator.repository.repository import open_repository

PATIENCE_S = 30.0


def race(address: str, number: int, rounds: int, start: Barrier, answers: Connection) -> None:
    """Open a database together with the others, then ask for the same robots again and again.

    Sends the epochs of the leases of every round that it won.
    """
    won: list[dict[str, int]] = []
    start.wait(PATIENCE_S)
    with open_repository(address) as repository:
        for n in range(rounds):
            robots = [f"x{n}", "shared", "more"]
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
                won.append({lease.robot: lease.epoch for lease in leases})
    answers.send(won)
