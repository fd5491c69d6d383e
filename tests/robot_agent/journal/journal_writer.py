"""A process that writes into a journal for as long as it lives, and says what is stored."""

from __future__ import annotations

import sys
from pathlib import Path

from journal_facts import PLAN, goal, result

from nufleet.robot_agent.journal.journal import Journal
from nufleet.robot_agent.rules.supervisor import StopOrder


def say(what: str) -> None:
    sys.stdout.write(what + "\n")
    sys.stdout.flush()


def live(folder: Path, life: str) -> None:
    """Accept goals, end them, stop and release, until this process is killed."""
    journal = Journal(folder)
    say("open")
    number = 0
    while True:
        number += 1
        goal_id = f"life{life}-{number}"
        journal.accepted(goal(goal_id), PLAN, f"boot-{life}")
        say(f"accepted {goal_id}")
        journal.stopped(StopOrder("a", "b"))
        say(f"stopped {goal_id}")
        journal.ended(result(goal_id))
        say(f"ended {goal_id}")
        journal.released("a")
        say(f"released {goal_id}")


if __name__ == "__main__":
    live(Path(sys.argv[1]), sys.argv[2])
