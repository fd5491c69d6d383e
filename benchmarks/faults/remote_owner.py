"""An orchestrator in a process of its own: begins one long motion after the other until refused."""

from __future__ import annotations

import argparse
import os
from functools import partial
from itertools import count

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.shared.errors import NufleetError, RefusedError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.lifeline import when_stdin_closes
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import GoalRequest
from nufleet.shared.wire.transport import open_client

MOTION = Excitation(axis="x", tones=(Tone(omega_rad_s=1.0),), settle_s=60.0)


def main() -> None:
    """Command a robot for as long as it obeys; print why it does not any more."""
    parser = argparse.ArgumentParser(description=__doc__)
    for name in ("fleet", "robot", "connect", "name"):
        parser.add_argument(f"--{name}", required=True)
    parser.add_argument("--epoch", type=int, required=True)
    own = parser.parse_args()
    when_stdin_closes(partial(os._exit, 0))
    with open_client(own.connect, timeout_s=30.0) as session:
        fleet = Fleet(session, FleetKeys(own.fleet), own.name)
        fleet.wait_for((own.robot,), timeout_s=30.0)
        for attempt in count(1):
            goal_id = f"{own.name}.{attempt}"
            request = GoalRequest(goal_id=goal_id, owner=own.name, epoch=own.epoch, motion=MOTION)
            try:
                fleet.submit(own.robot, request)
                _wait_for_end(fleet, own.robot, goal_id)
            except RefusedError as error:
                print(f"refused: {error.code}: {error.reason}", flush=True)
                return
            except NufleetError as error:
                print(f"not heard: {error}", flush=True)


def _wait_for_end(fleet: Fleet, robot: str, goal_id: str) -> None:
    watch = fleet.watch(robot)
    while not watch.wait_until(
        lambda w: w.state is not None and w.state.last_goal_id == goal_id, timeout_s=1.0
    ):
        pass


if __name__ == "__main__":
    main()
