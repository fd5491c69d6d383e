"""Does a Crazyflie's control period hold over UDP on a busy machine, and what delays its samples?

The driver for real drones flies a simulated one, which is served by another process, at a constant
reference of 0, in motions of a minute with the priority that agents give them. A sample is late if
it begins more than a sample time after its turn, as results count them. Linux tells how long the
threads of this process were ready and did not run, and how much time the host took from the
machine: a late sample is explained if its delay is not longer than these together. The drone does
not switch off when it hears nothing for 2 s, as a real one would.

    python -m benchmarks.crazyflie_period --rate 50 --minutes 10
"""

from __future__ import annotations

import argparse
import math
import multiprocessing
import os
import time
from contextlib import suppress
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from nufleet.robot_agent.drivers.crazyflie.robot import Crazyflie
from nufleet.robot_agent.drivers.crazyflie.settings import CrazyflieSettings
from nufleet.robot_agent.motion.promptness import Promptness
from nufleet.robot_agent.motion.watched_robot import WatchedRobot
from nufleet.shared.errors import RobotError
from nufleet.sims.crazyflies import firmware as simulated
from nufleet.sims.crazyflies.firmware import Firmware
from nufleet.sims.crazyflies.peer import Peer
from nufleet.sims.crazyflies.plant import KnownLoop, LoopSettings

UNTOLD_S = 2e-3
"""Part of a delay that Linux does not report: time in which this process itself computes."""


def serve(ours: Connection) -> None:
    """Serve a drone; send its address, and at last how many set-points it received."""
    simulated.SWITCH_OFF_S = math.inf  # it waits until this process runs again
    rng = np.random.default_rng(0)
    plant = KnownLoop(LoopSettings(), (0.0, 0.0, 0.0))
    firmware = Firmware(plant, rng, now_s=time.monotonic(), noise_m=0.001)
    with Peer(firmware, rng) as peer:
        ours.send(peer.uri)
        while ours.recv() is not None:
            ours.send(firmware.setpoints)


def waited_s() -> float:
    """Return for how long all threads of this process were ready and did not run, and the host."""
    waited_ns = 0
    for task in Path("/proc/self/task").iterdir():
        with suppress(OSError):
            waited_ns += int((task / "schedstat").read_text().split()[1])
    stolen = int(Path("/proc/stat").read_text().split("\n", 1)[0].split()[8])
    return 1e-9 * waited_ns + stolen / os.sysconf("SC_CLK_TCK")


@dataclass
class Late:
    """One late sample."""

    delay_s: float
    waited_s: float
    """Time that threads waited for a processor since the sample before."""


@dataclass
class Counts:
    """What happened to the samples of all motions."""

    played: int = 0
    late: list[Late] = field(default_factory=list)
    ended: list[str] = field(default_factory=list)
    """Why motions ended early."""


def fly(robot: WatchedRobot, samples: int, counts: Counts) -> None:
    """Play a reference of 0, and count."""
    zero = np.zeros(len(robot.spec.axes))
    before_s, waited = time.monotonic(), waited_s()
    lasted_s = waited_meanwhile_s = 0.0
    for k in range(samples):
        counted = robot.late_samples
        try:
            robot.step(zero)
        except RobotError as error:
            counts.ended.append(
                f"{error}, after {time.monotonic() - before_s:.2f} s in which this process waited "
                f"{waited_s() - waited:.2f} s"
            )
            break
        counts.played += 1
        if robot.late_samples > counted and k:  # it began late, since the one before lasted long
            delay_s = lasted_s - robot.spec.sample_time_s
            counts.late.append(Late(delay_s, waited_meanwhile_s))
        now_s, now_waited = time.monotonic(), waited_s()
        lasted_s, waited_meanwhile_s = now_s - before_s, now_waited - waited
        before_s, waited = now_s, now_waited
    try:
        robot.rest()
    except RobotError as error:
        counts.ended.append(f"at rest: {error}")


def main() -> None:
    """Parse the command line, fly, and print the counts."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rate", type=float, default=50.0, help="samples per second, up to 100")
    parser.add_argument("--minutes", type=float, default=10.0)
    given = parser.parse_args()
    counts, received, prompt = Counts(), 0, Promptness()
    theirs, ours = multiprocessing.Pipe()
    serving = multiprocessing.get_context("spawn").Process(target=serve, args=(ours,))
    serving.start()
    try:
        settings = CrazyflieSettings(uri=theirs.recv(), sample_time_s=1 / given.rate)
        robot = WatchedRobot(Crazyflie("drone", settings), realtime=None)
        robot.connect()
        try:
            robot.begin()
            samples = round(60 * given.minutes * given.rate)
            while counts.played < samples:
                with prompt.motion():
                    fly(robot, min(samples - counts.played, round(60 * given.rate)), counts)
            robot.end()
            theirs.send("count")
            received = theirs.recv()
        finally:
            robot.disconnect()
    finally:
        theirs.send(None)
        serving.join()
    late, played = counts.late, counts.played
    unexplained = [one for one in late if one.delay_s > one.waited_s + UNTOLD_S]
    worst_s = max((one.delay_s for one in late), default=0.0)
    print(
        f"{played} samples at {given.rate:g} Hz: {len(late)} late ({100 * len(late) / played:.2g} "
        f"%), by {1e3 * worst_s:.0f} ms at most; {len(unexplained)} of them unexplained; "
        f"{len(counts.ended)} motions ended early; the drone received {received} set-points, "
        f"those of its take-off and rest included; load {os.getloadavg()[0]:.0f}"
    )
    for why in counts.ended:
        print(f"ended: {why}")
    for one in unexplained:
        print(f"unexplained: {1e3 * one.delay_s:.1f} ms late, waited {1e3 * one.waited_s:.1f} ms")


if __name__ == "__main__":
    main()
