"""How many samples of a real robot are late on a busy machine, with and without real-time priority?

A whole agent, with its network, its journal and its heartbeat, plays a frequency test on a robot
that keeps time by the machine's clock. A sample is late if it begins more than a sample time after
its turn, as results count them. Other programs keep the machine busy: give a number of them.

    sudo python -m benchmarks.late_samples --rates 100 500 --busy 8
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from pathlib import Path

import numpy as np

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.goal_runner import GoalRunner
from nufleet.orchestrator.fleet.processes import FleetProcesses
from nufleet.robot_agent.agent import Agent
from nufleet.robot_agent.motion.promptness import Promptness
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import GoalResult
from nufleet.shared.wire.transport import open_client

KEYS = FleetKeys("late")
PATIENCE_S = 60.0
ANSWER_RAD_S = 20.0
"""Bandwidth of the robot, which answers its reference as a first-order lag."""


class ClockedLag(Robot):
    """A robot that takes a reference at each tick of the machine's clock."""

    def __init__(self, rate_hz: float) -> None:
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
        self._output = np.zeros(1)
        self._tick_s = 0.0

    @property
    def spec(self) -> RobotSpec:
        """What the robot is."""
        return self._spec

    def connect(self) -> None:
        """Rest at 0."""
        self._output = np.zeros(1)

    def measure_output(self) -> FloatArray:
        """Return the output, shape (1,)."""
        return self._output

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference until the next tick; one that is late counts from there."""
        measured, period_s = self._output, self._spec.sample_time_s
        self._output = measured + (reference - measured) * (1 - np.exp(-ANSWER_RAD_S * period_s))
        self._tick_s = max(self._tick_s, time.monotonic() - period_s) + period_s
        time.sleep(max(0.0, self._tick_s - time.monotonic()))
        return np.asarray(measured)

    def rest(self) -> None:
        """Return to 0."""
        self._output = np.zeros(1)

    def disconnect(self) -> None:
        """Do nothing."""


@contextmanager
def busy(programs: int) -> Iterator[None]:
    """Keep the machine busy with programs that compute."""
    started: list[subprocess.Popen[bytes]] = []
    try:
        computing = [sys.executable, "-c", "while True: pass"]
        started.extend(subprocess.Popen(computing) for _ in range(programs))
        yield
    finally:
        for program in started:
            program.kill()
            program.wait()


def flown(
    endpoint: str,
    folder: Path,
    rate_hz: float,
    omega_rad_s: float,
    prompt: Callable[[], AbstractContextManager[None]],
) -> GoalResult:
    """Play one test and return its result."""
    with ExitStack() as stack:
        session = stack.enter_context(open_client(endpoint, timeout_s=PATIENCE_S))
        robot = ClockedLag(rate_hz)
        agent = Agent(
            session, KEYS, "robot", robot, realtime=None, state_folder=folder, prompt=prompt
        )
        stack.enter_context(agent)
        desk = stack.enter_context(open_client(endpoint, timeout_s=PATIENCE_S))
        fleet = Fleet(desk, KEYS, "orchestrator-1")
        fleet.wait_for(("robot",), timeout_s=PATIENCE_S)
        test = Excitation(axis="x", tones=(Tone(omega_rad_s=omega_rad_s),))
        return GoalRunner(fleet).run("robot", folder.name, test)


def main() -> None:
    """Parse the command line, fly, and print the shares of late samples."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rates", type=float, nargs="+", default=[100.0, 500.0])
    parser.add_argument("--busy", type=int, default=2 * (os.cpu_count() or 1))
    parser.add_argument("--omega", type=float, default=1.0, help="rad/s; slower tests last longer")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as place, FleetProcesses() as started:
        endpoint = f"unixsock-stream/{place}/router.sock"
        started.start_router(endpoint)
        ways = {"normal": nullcontext, "real-time": Promptness().motion}
        with busy(arguments.busy):
            for rate_hz in arguments.rates:
                for name, prompt in ways.items():
                    folder = Path(place, f"{rate_hz:g}-{name}")
                    result = flown(endpoint, folder, rate_hz, arguments.omega, prompt)
                    samples = len(result.reference)
                    print(
                        f"{rate_hz:5g} Hz, {name:9s} priority: {result.late_samples} of {samples} "
                        f"samples late ({100 * result.late_samples / samples:.3f} %), "
                        f"{result.outcome}; load {os.getloadavg()[0]:.1f}",
                        flush=True,
                    )


if __name__ == "__main__":
    main()
