"""How often a response that is measured through a driver of real robots holds the truth.

A loop of known response flies behind the other end of the driver's own link, whose packets are
delayed and lost. Every tone is compared with the truth: it must lie in the disc that the test
claims to hold it with 95 %, once by the test's own variance, and once with the unknown delay that
the driver's spec declares. Takes real time, about a minute for five tones.

    python -m benchmarks.real_drivers --driver crazyflie --tests 40
    python -m benchmarks.real_drivers --driver crazyflie --tests 2 --jitter 0 --loss 0
    .venv-ros2/bin/python -m benchmarks.real_drivers --driver ros2 --tests 8

A driver takes part through an entry in `BENCHES`.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.ros2_plant import PlantSettings
from nufleet.robot_agent.drivers.crazyflie.robot import Crazyflie
from nufleet.robot_agent.drivers.crazyflie.settings import CrazyflieSettings
from nufleet.robot_agent.drivers.ros2 import driver as ros2_driver
from nufleet.robot_agent.drivers.ros2.settings import Ros2Settings
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.robot_agent.motion.pace import HaltSwitch
from nufleet.robot_agent.motion.perform import AxisMotion, perform
from nufleet.robot_agent.robot import Robot
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import estimate_frequency_response
from nufleet.shared.wire.messages import Outcome
from nufleet.sims.crazyflies.firmware import Firmware
from nufleet.sims.crazyflies.peer import Air, Peer
from nufleet.sims.crazyflies.plant import KnownLoop, LoopSettings

OMEGAS_RAD_S = (1.0, 2.0, 3.0, 4.0, 5.0)
SEGMENTS = 4
ALPHA = 0.05
ROS2_ROBOT = {
    "kind": "drone",
    "command": {"topic": "command", "type": "geometry_msgs/msg/PoseStamped"},
    "measurement": {"topic": "measured", "type": "nav_msgs/msg/Odometry"},
    "axes": [
        {
            "name": "x",
            "unit": "m",
            "amplitude_max": 0.3,
            "velocity_max": 0.6,
            "acceleration_max": 1.6,
        }
    ],
    "sample_time_s": 0.02,
    "omega_min_rad_s": 0.3,
    "omega_max_rad_s": 10.0,
    "duration_max_s": 240.0,
    "settling_time_s": 2.0,
}
NORMAL_95 = 1.96


@dataclass(frozen=True)
class Link:
    """What the link does to packets."""

    jitter_s: float
    loss: float


@dataclass(frozen=True)
class Bench:
    """A connected robot whose response is known."""

    robot: Robot
    truth: Callable[[float], complex]
    """Function that returns z at a frequency in rad/s."""


@dataclass(frozen=True)
class Found:
    """One tone of one test."""

    omega_rad_s: float
    error: float
    """|ẑ − z|."""
    z: tuple[float, float]
    truth: tuple[float, float]
    radius: float
    """Radius of the disc that holds z with 95 % by the test's variance."""
    radius_with_delay: float
    """The same with the delay uncertainty of the spec."""
    period_ms: float
    jitter_ms: float


@contextmanager
def crazyflie(link: Link, loop: LoopSettings, seed: int) -> Iterator[Bench]:
    """A Crazyflie over UDP, flown through cflib."""
    rng = np.random.default_rng(seed)
    plant = KnownLoop(loop, (0.0, 0.0, 0.0))
    firmware = Firmware(plant, rng, now_s=time.monotonic(), noise_m=0.001)
    with Peer(firmware, rng, Air(jitter_s=link.jitter_s, loss=link.loss)) as peer:
        settings = CrazyflieSettings(uri=peer.uri, takeoff_s=1.0, landing_s=1.0)
        robot = Crazyflie("drone", settings)
        robot.connect()
        try:
            yield Bench(robot, lambda omega: received(link, loop, omega, settings.sample_time_s))
        finally:
            robot.disconnect()


@contextmanager
def ros2(link: Link, loop: LoopSettings, seed: int) -> Iterator[Bench]:
    """A robot on ROS 2, in another process; run by .venv-ros2/bin/python (see `make test-ros2`)."""
    # So late that a process which waits for a processor has taken the set-points in time.
    loop = loop.model_copy(update={"delay_s": 0.2})
    plant = PlantSettings(
        domain_id=1 + os.getpid() % 100,
        omega_0_rad_s=loop.omega_rad_s,
        damping=loop.damping_ratio,
        delay_s=loop.delay_s,
        jitter_s=link.jitter_s,
        loss=link.loss,
        seed=seed,
    )
    given = [sys.executable, "-m", "benchmarks.ros2_plant", json.dumps(asdict(plant))]
    with subprocess.Popen(given, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL) as running:
        settings = Ros2Settings.model_validate_json(
            json.dumps({**ROS2_ROBOT, "domain_id": plant.domain_id})
        )
        robot = ros2_driver.DRIVER.build({"drone": settings}, np.random.default_rng(seed))["drone"]
        try:
            robot.connect()
            yield Bench(robot, lambda omega: received(link, loop, omega, settings.sample_time_s))
        finally:
            robot.disconnect()
            running.communicate()


BENCHES: dict[str, Callable[[Link, LoopSettings, int], AbstractContextManager[Bench]]] = {
    "crazyflie": crazyflie,
    "ros2": ros2,
}


def received(link: Link, loop: LoopSettings, omega_rad_s: float, sample_time_s: float) -> complex:
    """Return the mean response of a loop whose references arrive late or never.

    The delay is evenly distributed up to twice its mean, and shorter than a sample, so that the
    response is the mean over delays. A lost reference leaves the one before in force.
    """
    nodes, weights = np.polynomial.legendre.leggauss(12)
    delays_s = link.jitter_s * (1 + nodes)
    responses = [loop.response(omega_rad_s, sample_time_s, delay_s) for delay_s in delays_s]
    late = complex(np.dot(weights / 2, responses))
    shift = np.exp(-1j * omega_rad_s * sample_time_s)
    return complex(late * (1 - link.loss) / (1 - link.loss * shift))


def test(bench: Bench, seed: int) -> Iterator[Found]:
    """Play one test and compare its tones with the truth."""
    phases = 2 * np.pi * np.random.default_rng(seed).random(len(OMEGAS_RAD_S))
    excitation = Excitation(
        axis="x",
        tones=tuple(
            Tone(omega_rad_s=omega, phase_rad=float(phase))
            for omega, phase in zip(OMEGAS_RAD_S, phases, strict=True)
        ),
        segments=SEGMENTS,
    )
    spec = bench.robot.spec
    plan = plan_excitation(excitation, spec, "drone")
    switch = HaltSwitch()
    motion = AxisMotion(
        bench.robot,
        ("x",),
        reference_of(plan),
        realtime=None,
        switch=switch,
        on_samples=lambda *_: None,
    )
    played = perform(bench.robot, motion, switch, on_resting=lambda: None)
    if played.outcome is not Outcome.COMPLETED or played.samples.timing is None:
        print(f"a test failed: {played.reason}", flush=True)
        return
    timing = played.samples.timing
    response = estimate_frequency_response(played.samples.reference, played.samples.response, plan)
    if not response.quality.usable:
        print(f"a test is not usable: {response.quality.reasons}", flush=True)
        return
    for omega, z, radius in zip(
        response.omega_rad_s, response.z, response.radius(ALPHA), strict=True
    ):
        truth = bench.truth(float(omega))
        delayed = NORMAL_95 * omega * spec.delay_uncertainty_s * abs(z)
        yield Found(
            omega_rad_s=float(omega),
            error=float(abs(z - truth)),
            z=(float(z.real), float(z.imag)),
            truth=(truth.real, truth.imag),
            radius=float(radius),
            radius_with_delay=float(np.hypot(radius, delayed)),
            period_ms=1e3 * timing.period_s,
            jitter_ms=1e3 * timing.jitter_std_s,
        )


def main() -> None:
    """Parse the command line, fly, and print each test and the shares."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--driver", choices=sorted(BENCHES), default="crazyflie")
    parser.add_argument("--tests", type=int, default=4, help="tests of five tones each")
    parser.add_argument("--jitter", type=float, default=0.008, metavar="S", help="mean delay")
    parser.add_argument("--loss", type=float, default=0.01, help="share of lost packets")
    parser.add_argument("--omega", type=float, default=6.0, help="natural frequency of the loop")
    parser.add_argument("--damping", type=float, default=0.7, help="damping ratio of the loop")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", type=Path, help="also write every tone to this file")
    given = parser.parse_args()
    link = Link(given.jitter, given.loss)
    loop = LoopSettings(omega_rad_s=given.omega, damping_ratio=given.damping)
    rows: list[Found] = []
    with BENCHES[given.driver](link, loop, given.seed) as bench:
        bench.robot.begin()
        for number in range(given.tests):
            found = list(test(bench, given.seed + number))
            rows += found
            if not found:
                continue
            errors = ", ".join(f"{1e3 * one.error:.2f}/{1e3 * one.radius:.2f}" for one in found)
            print(
                f"test {number}: |error|/radius in 1/1000: {errors}; period "
                f"{found[0].period_ms:.3f} ms, jitter {found[0].jitter_ms:.2f} ms",
                flush=True,
            )
        bench.robot.end()
    held = sum(one.error <= one.radius for one in rows)
    with_delay = sum(one.error <= one.radius_with_delay for one in rows)
    print(
        f"{held} of {len(rows)} tones lie in their discs, {with_delay} with the declared delay; "
        f"median error {np.median([one.error for one in rows]):.2g}"
    )
    if given.json:
        given.json.write_text(json.dumps([asdict(one) for one in rows], indent=2))


if __name__ == "__main__":
    main()
