"""A process whose journal is on a small file system that fills up."""

from __future__ import annotations

import sys
from pathlib import Path

from journal_facts import PLAN, goal, result

from nufleet.robot_agent.journal.journal import Journal
from nufleet.robot_agent.journal.ledger import JournalError
from nufleet.robot_agent.rules.supervisor import StopOrder


def fill_up(folder: Path) -> str:
    """Accept goals until the disk is full, then make room and go on; return the error."""
    ballast = folder / "ballast"
    with Journal(folder) as journal:
        journal.accepted(goal("first"), PLAN, "boot-1")
        ballast.write_bytes(bytes(900_000))
        taken = ["first"]
        said = ""
        while not said:
            goal_id = f"g{len(taken)}"
            try:
                journal.accepted(goal(goal_id), PLAN, "boot-1")
                taken.append(goal_id)
                ended = journal.ended(result(goal_id))
            except JournalError as error:
                said = str(error)
        assert not ended, "there was no room for the samples long before"
        refused = [0, 0]
        for attempt in range(3):
            try:
                journal.stopped(StopOrder("a", f"while it is full, {attempt}"))
            except JournalError:
                refused[0] += 1
            else:
                refused[1] += 1
        ballast.unlink()
        journal.accepted(goal("after"), PLAN, "boot-1")
        assert journal.ended(result("after"))
    with Journal(folder) as journal:
        found = journal.remembrance
        assert found.damage is None
        assert {*taken, "after"} == set(found.goals.known)
        assert journal.result("after") is not None
        assert (found.stop is not None) == (refused[1] > 0)
    return said


if __name__ == "__main__":
    sys.stdout.write(fill_up(Path(sys.argv[1])))
