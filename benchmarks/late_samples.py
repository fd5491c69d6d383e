"""How many samples of a real robot are late on a busy machine, with and without real-time priority?

A whole agent, in a process of its own with its network, its journal and its heartbeat, plays a
frequency test on a robot that keeps time by the machine's clock, and whose driver has a thread that
receives measurements; others ask it questions meanwhile. A sample is late if it begins more than a
sample time after its turn, as results count them. Beside it, a program that has nothing else to do
sleeps from tick to tick with the same priority: it is late when the machine itself is, as when its
host takes a processor away. Other programs keep the machine busy: give a number of them.

    sudo python -m benchmarks.late_samples --rates 100 500 --busy 8
"""

from __future__ import annotations

import argparse
import gc
import multiprocessing
import os
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext, suppress
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.goal_runner import GoalRunner
from nufleet.orchestrator.fleet.processes import FleetProcesses
from nufleet.robot_agent.agent import Agent
from nufleet.robot_agent.motion.promptness import Promptness
from nufleet.robot_agent.motion.watched_robot import WatchedRobot
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import NoReplyError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import GoalResult
from nufleet.shared.wire.transport import open_client

KEYS = FleetKeys("late")
PATIENCE_S = 180.0
AS_DEPLOYED = -5
"""Niceness of agents in `deploy/systemd`. The orchestrator and the router, which run on other
machines then, have it too, so that they are not lost to the agent."""
ANSWER_RAD_S = 20.0
"""Bandwidth of the robot, which answers its reference as a first-order lag."""

_PACKET = struct.Struct("<qd")
"""A time stamp in ns, and the output."""


class ClockedLag(Robot):
    """A robot that takes a reference at each tick of the machine's clock.

    Like the drivers of real robots, it may have a thread of its own that unpacks measurements as
    they arrive, one per sample.
    """

    def __init__(self, rate_hz: float, *, listens: bool) -> None:
        axis = AxisSpec(
            name="x", unit="m", amplitude_max=1.0, velocity_max=10.0, acceleration_max=100.0
        )
        self._spec = RobotSpec(
            kind="clocked-lag",
            axes=(axis,),
            sample_time_s=1 / rate_hz,
            omega_min_rad_s=0.1,
            omega_max_rad_s=6.0,
            duration_max_s=300.0,
            settling_time_s=1.0,
            simulated=False,
        )
        self._listens = listens
        self._output = self._measured = np.zeros(1)
        self._tick_s = 0.0
        self._ended = threading.Event()

    @property
    def spec(self) -> RobotSpec:
        """What the robot is."""
        return self._spec

    def connect(self) -> None:
        """Rest at 0."""
        self._output = self._measured = np.zeros(1)
        if self._listens:
            threading.Thread(target=self._listen, name="measurements", daemon=True).start()

    def measure_output(self) -> FloatArray:
        """Return the output, shape (1,)."""
        return self._measured

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference until the next tick; one that is late counts from there."""
        output, period_s = self._output, self._spec.sample_time_s
        measured = self._measured if self._listens else output
        self._output = output + (reference - output) * (1 - np.exp(-ANSWER_RAD_S * period_s))
        self._tick_s = max(self._tick_s, time.monotonic() - period_s) + period_s
        time.sleep(max(0.0, self._tick_s - time.monotonic()))
        return np.asarray(measured)

    def rest(self) -> None:
        """Return to 0."""
        self._output = self._measured = np.zeros(1)

    def disconnect(self) -> None:
        """Listen no more."""
        self._ended.set()

    def _listen(self) -> None:
        while not self._ended.is_set():
            packet = _PACKET.pack(time.monotonic_ns(), *self._output)
            _, *values = _PACKET.unpack(packet)
            self._measured = np.array(values)
            time.sleep(self._spec.sample_time_s)


@contextmanager
def busy(programs: int) -> Iterator[None]:
    """Keep the machine busy with programs that compute."""
    started: list[subprocess.Popen[bytes]] = []
    try:
        computing = ["nice", "--adjustment=5", sys.executable, "-c", "while True: pass"]
        started.extend(subprocess.Popen(computing) for _ in range(programs))
        yield
    finally:
        for program in started:
            program.kill()
            program.wait()


@contextmanager
def beside(target: Callable[..., None], *arguments: object) -> Iterator[Connection]:
    """Run a function in a process of its own until the context ends.

    It receives a connection before its other arguments, and has to return once that sends
    something or ends.
    """
    ours, theirs = multiprocessing.Pipe()
    spawned = multiprocessing.get_context("spawn")
    process: BaseProcess = spawned.Process(target=target, args=(theirs, *arguments))
    process.start()
    theirs.close()
    try:
        yield ours
    finally:
        ours.close()
        process.join()


def until_end(ours: Connection) -> bool:
    """Wait until something arrives, or the connection ends; return whether something arrived."""
    try:
        ours.recv()
    except EOFError:
        return False
    return True


def agent(
    ours: Connection, endpoint: str, folder: Path, rate_hz: float, urgent: bool, computing: int
) -> None:
    """Serve a robot until the connection ends, while threads of the same process compute."""
    prompt = Promptness().motion if urgent else nullcontext
    for _ in range(computing):
        threading.Thread(target=compute, daemon=True).start()
    with open_client(endpoint, timeout_s=PATIENCE_S) as session:
        robot = ClockedLag(rate_hz, listens=True)
        serving = Agent(
            session, KEYS, "robot", robot, realtime=None, state_folder=folder, prompt=prompt
        )
        with serving:
            gc.freeze()  # as agents do
            until_end(ours)


def compute() -> None:
    """Compute in Python until the process ends."""
    while True:
        pass


def bare(ours: Connection, rate_hz: float, urgent: bool) -> None:
    """Do nothing but keep time; send how many samples were late, of how many."""
    robot = WatchedRobot(ClockedLag(rate_hz, listens=False), realtime=None)
    ended = threading.Event()
    asked: list[bool] = []

    def watch() -> None:
        asked.append(until_end(ours))
        ended.set()

    threading.Thread(target=watch, daemon=True).start()
    played, zero = 0, np.zeros(1)
    robot.connect()
    ours.send("ready")
    gc.freeze()
    with Promptness().motion() if urgent else nullcontext():
        while not ended.is_set():
            robot.step(zero)
            played += 1
    if asked == [True]:
        ours.send((robot.late_samples, played))


def played(
    endpoint: str, goal_id: str, omega_rad_s: float, *, asked_hz: float, programs: int
) -> GoalResult:
    """Have the robot play one test on a busy machine, ask it questions, and return its result."""
    with ExitStack() as stack:
        desk = stack.enter_context(open_client(endpoint, timeout_s=PATIENCE_S))
        fleet = Fleet(desk, KEYS, "orchestrator-1")
        fleet.wait_for(("robot",), timeout_s=PATIENCE_S)
        stack.enter_context(busy(programs))
        ended = threading.Event()
        asking = threading.Thread(target=ask, args=(fleet, asked_hz, ended))
        asking.start()
        stack.callback(asking.join)
        stack.callback(ended.set)
        test = Excitation(axis="x", tones=(Tone(omega_rad_s=omega_rad_s),))
        return GoalRunner(fleet).run("robot", goal_id, test)


def ask(fleet: Fleet, asked_hz: float, ended: threading.Event) -> None:
    """Ask the robot for its description, as often as given, until the event is set."""
    while asked_hz and not ended.wait(1 / asked_hz):
        with suppress(NoReplyError):  # the busy machine was too slow for one of the two
            fleet.describe("robot")


def share(late: int, samples: int) -> str:
    """Return a share of late samples in words."""
    return f"{late} of {samples} ({100 * late / max(1, samples):.3f} %)"


def main() -> None:
    """Parse the command line, fly, and print the shares of late samples."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rates", type=float, nargs="+", default=[100.0, 500.0])
    parser.add_argument("--busy", type=int, default=2 * (os.cpu_count() or 1))
    parser.add_argument("--omega", type=float, default=1.0, help="rad/s; slower tests last longer")
    parser.add_argument("--asked", type=float, default=20.0, help="questions per second")
    parser.add_argument("--urgent", action="store_true", help="with real-time priority alone")
    parser.add_argument(
        "--computing", type=int, default=0, help="threads of the agent that compute without pause"
    )
    given = parser.parse_args()
    os.setpriority(os.PRIO_PROCESS, 0, AS_DEPLOYED)
    with tempfile.TemporaryDirectory() as place, FleetProcesses() as started:
        endpoint = f"unixsock-stream/{place}/router.sock"
        started.start_router(endpoint)
        for rate_hz in given.rates:
            for urgent in (True,) if given.urgent else (False, True):
                name = "real-time" if urgent else "normal"
                goal_id = f"{rate_hz:g}-{name}"
                with (
                    beside(agent, endpoint, Path(place, goal_id), rate_hz, urgent, given.computing),
                    beside(bare, rate_hz, urgent) as empty,
                ):
                    empty.recv()
                    result = played(
                        endpoint, goal_id, given.omega, asked_hz=given.asked, programs=given.busy
                    )
                    empty.send(None)
                    print(
                        f"{rate_hz:5g} Hz, {name:9s} priority: late are "
                        f"{share(result.late_samples, len(result.reference))} samples, and of a "
                        f"program that only keeps time {share(*empty.recv())}; "
                        f"{result.outcome} {result.reason}; load {os.getloadavg()[0]:.1f}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
