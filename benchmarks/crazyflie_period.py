"""Does a Crazyflie's control period hold over UDP on a busy machine, and what delays its samples?

The driver for real drones flies a simulated one, which is served by another process, at a constant
reference of 0, in motions of a minute with the priority that agents give them. A sample is late if
it begins more than a sample time after its turn, as results count them. The scheduler of Linux
tells what every thread of this process did meanwhile, so that each moment of a late sample has one
cause: the thread that moves the drone slept because it was early, ran, waited for a processor, or
was blocked while another thread of this process ran, or waited for a processor and so held what it
needs. Moments at which nothing of this was seen are unexplained, and a sample is if they last for
more than a millisecond. The drone does not switch off when it hears nothing for 2 s, as a real one
would. Needs root.

    sudo python -m benchmarks.crazyflie_period --rate 50 --minutes 10
"""

from __future__ import annotations

import argparse
import gc
import math
import multiprocessing
import os
import resource
import threading
import time
from collections import Counter, defaultdict
from dataclasses import dataclass, field
from itertools import pairwise
from multiprocessing.connection import Connection
from pathlib import Path

import numpy as np

from benchmarks.thread_timeline import Scheduler, State, Timeline
from nufleet.robot_agent.drivers.crazyflie.robot import Crazyflie
from nufleet.robot_agent.drivers.crazyflie.settings import CrazyflieSettings
from nufleet.robot_agent.motion.promptness import Promptness
from nufleet.robot_agent.motion.watched_robot import WatchedRobot
from nufleet.shared.errors import RobotError
from nufleet.sims.crazyflies import firmware as simulated
from nufleet.sims.crazyflies.firmware import Firmware
from nufleet.sims.crazyflies.peer import Peer
from nufleet.sims.crazyflies.plant import KnownLoop, LoopSettings

UNTOLD_S = 1e-3
"""Time of a late sample that may stay without a cause, as between two events of the scheduler."""

EARLY = "it was early, and slept as it asked for"
RAN = "it ran"
KERNEL = "Linux ran for it"
COLLECTED = "it collected garbage"
WAITED = "it waited for a processor"
HOST = "the host had its processor"
OTHER_RAN = "another thread of its process ran"
OTHER_WAITED = "another thread of its process waited for a processor"
LOOKED = "it waited for a measurement"
UNKNOWN = "no cause was seen"

WORST = 5
"""Number of the latest samples that are printed, beside those that are unexplained."""

CLOCK_STEP_S = 1e-3
"""Change of the machine's time of day against its monotonic clock that counts as a step."""


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


@dataclass(frozen=True)
class Pauses:
    """When the driver waited in a sample because it meant to."""

    asleep: tuple[float, float] = (0.0, 0.0)
    """When it was early."""
    looks: tuple[float, float] = (0.0, 0.0)
    """When it looked for a measurement, for which it waits if there is no recent one."""


class Noted(Crazyflie):
    """The driver, which notes when it waits."""

    pauses = Pauses()

    def _wait_for_sample(self) -> None:
        begins_s = time.monotonic()
        super()._wait_for_sample()
        assert self._due_s is not None  # noqa: S101 - of the sample that follows
        asleep = (begins_s, max(begins_s, self._due_s - self._spec.sample_time_s))
        looks_s = time.monotonic()
        if self._sent_s:
            self._seen = self._flying().newest()
        self.pauses = Pauses(asleep, (looks_s, time.monotonic()))


class Usage:
    """What the machine and Python count of this thread, since the last look at it."""

    def __init__(self) -> None:
        self.pauses_s: list[float] = []
        """How long each collection of garbage on this thread took."""
        self._thread = threading.get_native_id()
        self._collects_s = 0.0
        self._before = self._counted()
        gc.callbacks.append(self._note)

    def spent(self) -> Spent:
        """Return what was counted since the last call."""
        before, self._before = self._before, self._counted()
        stolen = tuple(b - a for a, b in zip(before[1], self._before[1], strict=True))
        counted = [b - a for a, b in zip(before[0], self._before[0], strict=True)]
        return Spent(stolen, *counted)

    def _note(self, phase: str, _: object) -> None:
        if threading.get_native_id() != self._thread:
            return
        now_s = time.monotonic()
        if phase == "start":
            self._collects_s = now_s
        else:
            self.pauses_s.append(now_s - self._collects_s)

    def _counted(self) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return what is counted of the thread, and for how long each processor was taken."""
        processors = Path("/proc/stat").read_text().split("intr", 1)[0].splitlines()[1:]
        stolen_s = [int(one.split()[8]) / os.sysconf("SC_CLK_TCK") for one in processors]
        used = resource.getrusage(resource.RUSAGE_THREAD)
        return (
            time.thread_time(),
            used.ru_stime,
            sum(self.pauses_s),
            used.ru_majflt,
            used.ru_minflt,
            time.time() - time.monotonic(),
        ), tuple(stolen_s)


@dataclass(frozen=True)
class Spent:
    """What was counted of a thread and its machine during a sample."""

    stolen: tuple[float, ...]
    """Time in s for which the host took each processor, in steps of 10 ms."""
    cpu_s: float
    """Time on a processor that Linux charged it."""
    kernel_s: float
    """Part of it in the kernel."""
    collecting_s: float
    """Time in collections of garbage."""
    disk_faults: float
    """Pages that were read from a disk."""
    faults: float
    """Pages that were only mapped."""
    day_s: float
    """By how much the time of day was set."""

    def divide(self, lasted_s: dict[str, float], stolen_s: float) -> None:
        """Divide the time in which the thread ran, as the scheduler has it, or had no cause.

        While the host has its processor, the scheduler shows a thread as running, and Linux does
        not charge it for this. It shows one that slept as asleep until the host gives the processor
        back that has to wake it.

        Args:
            lasted_s: Time of each cause, which is changed.
            stolen_s: Time for which the host took a processor.
        """
        ran_s = lasted_s.pop(RAN, 0.0)
        uncharged_s = max(0.0, ran_s - self.cpu_s)
        lasted_s[UNKNOWN] += uncharged_s
        lasted_s[HOST] = min(stolen_s, lasted_s[UNKNOWN])
        lasted_s[UNKNOWN] -= lasted_s[HOST]
        charged_s = ran_s - uncharged_s
        lasted_s[COLLECTED] = min(self.collecting_s, charged_s)
        lasted_s[KERNEL] = min(self.kernel_s, charged_s - lasted_s[COLLECTED])
        lasted_s[RAN] = charged_s - lasted_s[COLLECTED] - lasted_s[KERNEL]


@dataclass
class Late:
    """One late sample."""

    delay_s: float
    causes_s: dict[str, float]
    """Time of each cause, and under `UNKNOWN` the time without one."""
    spent: Spent
    stolen_s: float = 0.0
    """Longest time for which the host took a processor, until the sample after this one: Linux
    counts that with its next tick."""

    def ends(self, after: Spent) -> None:
        """Take what was counted during the sample after this one, and divide the time."""
        both = zip(self.spent.stolen, after.stolen, strict=True)
        self.stolen_s = max(now + then for now, then in both)
        self.spent.divide(self.causes_s, self.stolen_s)

    @property
    def largest(self) -> str:
        """The cause that took the most time, other than being early."""
        return max(set(self.causes_s) - {EARLY}, key=self.causes_s.__getitem__)


@dataclass
class Counts:
    """What happened to the samples of all motions."""

    played: int = 0
    late: list[Late] = field(default_factory=list)
    ended: list[str] = field(default_factory=list)
    """Why motions ended early."""
    steps_s: list[float] = field(default_factory=list)
    """By how much the time of day was set, each time."""
    stolen: int = 0
    """Number of samples, late or not, in which the host took a processor for 10 ms or more."""


def causes(
    timeline: Timeline, thread: int, begins_s: float, ends_s: float, pauses: Pauses
) -> dict[str, float]:
    """Return for how long each cause kept a thread from its next sample."""
    lasted_s: dict[str, float] = defaultdict(float)
    cuts_s = [begins_s, *sorted({*pauses.asleep, *pauses.looks}), ends_s]
    for first_s, last_s in pairwise(np.clip(cuts_s, begins_s, ends_s).tolist()):
        for from_s, to_s in timeline.read(first_s, last_s):
            lasted_s[_cause(timeline, thread, (from_s + to_s) / 2, pauses)] += to_s - from_s
    return lasted_s


def _cause(timeline: Timeline, thread: int, at_s: float, pauses: Pauses) -> str:
    own = timeline.states.get(thread, State.BLOCKED)
    if own is not State.BLOCKED:
        return {State.RUNNING: RAN, State.READY: WAITED}[own]
    if pauses.asleep[0] <= at_s < pauses.asleep[1]:
        return EARLY
    others = {state for other, state in timeline.states.items() if other != thread}
    if State.RUNNING in others:
        return OTHER_RAN
    if State.READY in others:
        return OTHER_WAITED
    return LOOKED if pauses.looks[0] <= at_s < pauses.looks[1] else UNKNOWN


def fly(
    robot: WatchedRobot,
    driver: Noted,
    samples: int,
    counts: Counts,
    scheduler: Scheduler,
    usage: Usage,
) -> None:
    """Play a reference of 0, and count."""
    zero, thread = np.zeros(len(robot.spec.axes)), threading.get_native_id()
    timeline, before_s = Timeline(), time.monotonic()
    timeline.take(scheduler.changes())
    timeline.states[thread] = State.RUNNING
    usage.spent()
    late: Late | None = None
    for _ in range(samples):
        spent, pauses = usage.spent(), driver.pauses
        if late is not None:
            late.ends(spent)
        late, counted = None, robot.late_samples
        try:
            robot.step(zero)
        except RobotError as error:
            counts.ended.append(str(error))
            break
        begins_s = robot._stepped_s  # noqa: SLF001 - by which samples are found to be late
        assert begins_s is not None  # noqa: S101 - it has made a step
        counts.played += 1
        counts.stolen += max(spent.stolen) > 0
        timeline.take(scheduler.changes())
        lasted_s = causes(timeline, thread, before_s, begins_s, pauses)
        if robot.late_samples > counted:  # it began late, since the one before lasted long
            late = Late(begins_s - before_s - robot.spec.sample_time_s, lasted_s, spent)
            counts.late.append(late)
        if abs(spent.day_s) > CLOCK_STEP_S:
            counts.steps_s.append(spent.day_s)
        before_s = begins_s
    if late is not None:
        late.ends(usage.spent())
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
    counts, received, prompt, usage = Counts(), 0, Promptness(), Usage()
    theirs, ours = multiprocessing.Pipe()
    serving = multiprocessing.get_context("spawn").Process(target=serve, args=(ours,))
    serving.start()
    try:
        settings = CrazyflieSettings(uri=theirs.recv(), sample_time_s=1 / given.rate, parameters={})
        driver = Noted("drone", settings)
        robot = WatchedRobot(driver, realtime=None)
        with Scheduler() as scheduler:
            robot.connect()
            gc.freeze()  # as agents do
            try:
                robot.begin()
                scheduler.follow()
                samples = round(60 * given.minutes * given.rate)
                while counts.played < samples:
                    left = min(samples - counts.played, round(60 * given.rate))
                    with prompt.motion():
                        fly(robot, driver, left, counts, scheduler, usage)
                robot.end()
                theirs.send("count")
                received = theirs.recv()
            finally:
                robot.disconnect()
    finally:
        theirs.send(None)
        serving.join()
    print(
        f"{counts.played} samples at {given.rate:g} Hz; the drone received {received} set-points, "
        f"those of its take-off and rest included; {len(counts.ended)} motions ended early; "
        f"{len(usage.pauses_s)} collections of garbage, "
        f"{1e3 * max(usage.pauses_s, default=0.0):.2g} ms at most; "
        f"{len(counts.steps_s)} steps of the time of day, "
        f"{1e3 * max(map(abs, counts.steps_s), default=0.0):.3g} ms at most; "
        f"the host took 10 ms or more of a processor in {counts.stolen} samples; "
        f"{scheduler.lost} losses of records; load {os.getloadavg()[0]:.0f}"
    )
    show(counts)


def show(counts: Counts) -> None:
    """Print how many samples were late, by their largest cause, and those without one."""
    late = counts.late
    worst_s = max((one.delay_s for one in late), default=0.0)
    unexplained = [one for one in late if one.causes_s.get(UNKNOWN, 0.0) > UNTOLD_S]
    print(
        f"{len(late)} late ({100 * len(late) / counts.played:.2g} %), by {1e3 * worst_s:.0f} ms at "
        f"most; {len(unexplained)} of them unexplained"
    )
    for cause in (RAN, KERNEL, COLLECTED, WAITED, HOST, OTHER_RAN, OTHER_WAITED, LOOKED, UNKNOWN):
        lasted_s = [one.causes_s.get(cause, 0.0) for one in late]
        first = sum(one.largest == cause for one in late)
        print(
            f"{cause}: {sum(lasted_s):.2f} s in all, {1e3 * max(lasted_s, default=0.0):.1f} ms at "
            f"most, the largest cause of {first}"
        )
    for why, times in Counter(counts.ended).items():
        print(f"ended, {times} times: {why}")
    worst = sorted(late, key=lambda one: -one.delay_s)[:WORST]
    for one in {id(one): one for one in (*unexplained, *worst)}.values():
        each = ", ".join(
            f"{name}: {1e3 * s:.1f} ms" for name, s in one.causes_s.items() if s > 5e-4
        )
        print(
            f"{1e3 * one.delay_s:.1f} ms late: {each}; {one.spent.faults:.0f} pages mapped, "
            f"{one.spent.disk_faults:.0f} read from a disk; the host took a processor for "
            f"{1e3 * one.stolen_s:.0f} ms"
        )


if __name__ == "__main__":
    main()
