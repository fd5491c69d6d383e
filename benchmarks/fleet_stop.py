"""How soon a whole fleet is at rest after `nufleet stop --all`, while a ranking moves its robots.

The robots are simulated in real time by one process per core. The time counts from when the command
is started, so that what a busy machine takes to start it is part of the figure, and ends when this
program has heard from all robots that they are at rest. The robots themselves were there earlier.
It is started when the robots move that can be made to move at the same time.

    python -m benchmarks.fleet_stop --robots 1000
    python -m benchmarks.fleet_stop --robots 100 --runs 5
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np

from benchmarks.fleet_scale import write_fleet
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.connection import wait_for_robots
from nufleet.orchestrator.fleet.orchestrator_id import new_orchestrator_id
from nufleet.orchestrator.fleet.processes import FleetProcesses, grouped, private_folder
from nufleet.shared.robots.fleet_file import read_fleet_file
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import RobotState, RobotStatus
from nufleet.shared.wire.transport import open_client

NUFLEET = (sys.executable, "-P", "-m", "nufleet")
MOVING = (RobotStatus.RUNNING, RobotStatus.RESTING)
PATIENCE_S = 120.0
NONE_BEGAN_S = 2.0
"""Time in s without another robot that begins to move, after which as many move as will."""


class Rest:
    """Hears which robots move, and when each of them told that it is stopped and at rest."""

    def __init__(self) -> None:
        self._changed = threading.Condition()
        self._moving: set[str] = set()
        self._began_s = float("inf")
        self._ended = False
        self._waited_for: set[str] = set()
        self.rested_s: list[float] = []

    def heard(self, state: RobotState) -> None:
        """Take a state, on Zenoh's thread."""
        with self._changed:
            if state.status in MOVING:
                if state.robot not in self._moving:
                    self._moving.add(state.robot)
                    self._began_s = time.monotonic()
            else:
                self._ended |= state.robot in self._moving
                self._moving.discard(state.robot)
                if state.status is RobotStatus.STOPPED and state.robot in self._waited_for:
                    self._waited_for.discard(state.robot)
                    self.rested_s.append(time.perf_counter())
            self._changed.notify_all()

    def wait_until_most_move(self, ranking: subprocess.Popen[bytes]) -> None:
        """Wait until no further robot begins to move in a ranking, or the first one has ended."""
        while not self._ended and time.monotonic() < self._began_s + NONE_BEGAN_S:
            time.sleep(0.05)
            if ranking.poll() is not None:
                raise SystemExit(f"the ranking ended with exit code {ranking.returncode}")

    def stopping(self) -> int:
        """Wait from now on for all that move; return how many these are."""
        with self._changed:
            self._waited_for = set(self._moving)
            return len(self._waited_for)

    def wait_for_rest(self) -> None:
        """Wait until all that moved are at rest."""
        with self._changed:
            if not self._changed.wait_for(lambda: not self._waited_for, PATIENCE_S):
                raise SystemExit(f"after {PATIENCE_S:g} s robots are not at rest")


def stopped(robots: int, processes: int) -> None:
    """Start a fleet, stop it during a ranking, and print how long that took."""
    with private_folder() as folder, FleetProcesses() as started:
        path, endpoint = Path(folder, "fleet.toml"), f"unixsock-stream/{folder}/router.sock"
        write_fleet(path, robots, np.random.default_rng(robots))
        file = read_fleet_file(path)
        started.start_router(endpoint)
        groups = grouped(file, processes=processes)
        started.start_agents(path, groups, endpoint, 1.0, state_folder=Path(folder, "state"))
        with open_client(endpoint, timeout_s=PATIENCE_S) as session:
            fleet, rest = Fleet(session, FleetKeys(file.name), new_orchestrator_id()), Rest()
            wait_for_robots(fleet, started, file)
            fleet.observe_states(rest.heard)
            asked = ("--connect", endpoint, "--target", "target", "--algorithm", "paper")
            rank = subprocess.Popen(
                (*NUFLEET, "rank", *asked, "--band", "5", "10"),
                cwd=folder,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
            )
            try:
                rest.wait_until_most_move(rank)
                moved, began_s = rest.stopping(), time.perf_counter()
                command = subprocess.run(
                    (*NUFLEET, "stop", "--all", "--connect", endpoint),
                    capture_output=True,
                    check=False,
                )
                ended_s = time.perf_counter() - began_s
                rest.wait_for_rest()
            finally:
                rank.terminate()
                rank.wait()
    at_s = sorted(when_s - began_s for when_s in rest.rested_s)
    print(
        f"{moved} of {robots} robots moved; at rest after {at_s[0]:.2f} s the first, "
        f"{at_s[len(at_s) // 2]:.2f} s half, {at_s[-1]:.2f} s all; the command took {ended_s:.2f} "
        f"s, exit code {command.returncode}; load {os.getloadavg()[0]:.1f}",
        flush=True,
    )


def main() -> None:
    """Parse the command line and measure."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, default=1000)
    parser.add_argument("--processes", type=int, default=os.cpu_count())
    parser.add_argument("--runs", type=int, default=1)
    arguments = parser.parse_args()
    for _ in range(arguments.runs):
        stopped(arguments.robots, arguments.processes)


if __name__ == "__main__":
    main()
