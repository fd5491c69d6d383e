"""How well responses and distances hold that are measured through the driver `mavlink`.

The driver flies simulated vehicles of known loops over a link with jitter and losses, on a virtual
clock, so that neither the machine's load nor its speed matters. `--tests` compares every tone with
the truth: it should lie in the disc that its test claims to hold it with 95 %. `--studies` ranks
one vehicle against another, by agents and `nufleet.rank`, and compares ψ* with the closed form.

    python -m benchmarks.mavlink_figures --tests 40
    python -m benchmarks.mavlink_figures --studies 20
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import nufleet
from nufleet.robot_agent.agent import Agent
from nufleet.robot_agent.drivers.mavlink.robot import MavlinkRobot
from nufleet.robot_agent.drivers.mavlink.settings import MavlinkAxis, MavlinkSettings
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.robot_agent.motion.pace import HaltSwitch
from nufleet.robot_agent.motion.perform import AxisMotion, perform
from nufleet.robot_agent.robot import Robot, RobotAround
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import estimate_frequency_response
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import Outcome
from nufleet.shared.wire.transport import open_client, open_router
from nufleet.sims.mavlink_vehicle.loop import LoopSettings, frequency_response
from nufleet.sims.mavlink_vehicle.vehicle import SimulatedVehicle, VehicleSettings
from nufleet.sims.mavlink_vehicle.virtual_line import LinkSettings, VirtualClock, VirtualLine

OMEGAS_RAD_S = (1.0, 2.0, 3.0, 4.0, 5.0)
BAND_RAD_S = (1.0, 5.0)
SEGMENTS = 4
ALPHA = 0.05
NORMAL_95 = 1.96
SETTINGS = MavlinkSettings(
    profile="px4",
    url="udpin://127.0.0.1:14540",
    axes=(MavlinkAxis(name="x", amplitude_max=0.5, velocity_max=1.0, acceleration_max=3.0),),
    idle_s=3600.0,
)


class Unpaced(RobotAround):
    """A robot on a virtual clock, which is not watched for gaps in real time."""

    @property
    def spec(self) -> RobotSpec:
        """Its description."""
        return self._robot.spec.model_copy(update={"simulated": True})


Build = Callable[[LoopSettings, np.random.Generator], "Bench"]
"""Function that builds a robot of a loop, disconnected."""


@dataclass(frozen=True)
class Bench:
    """A robot, and the exact response of the vehicle behind its link."""

    robot: Robot
    loop: LoopSettings
    link: LinkSettings
    feed_forward: bool

    def truth(self, omega_rad_s: FloatArray) -> NDArray[np.complex128]:
        """Return z, shape (frequencies,)."""
        return frequency_response(
            self.loop,
            omega_rad_s,
            self.robot.spec.sample_time_s,
            feed_forward=self.feed_forward,
            link_delay_s=self.link.delay_s,
            link_jitter_s=self.link.jitter_s,
            link_loss=self.link.loss,
        )


def bench(
    own: MavlinkSettings, loop: LoopSettings, link: LinkSettings, rng: np.random.Generator
) -> Bench:
    """Build a robot, disconnected."""
    settings = VehicleSettings(loop=loop, clock_drift=float(rng.uniform(-4e-5, 4e-5)))
    clock = VirtualClock()
    vehicle = SimulatedVehicle(settings, rng.spawn(1)[0], clock.now_s)
    line = VirtualLine(vehicle, link, rng.spawn(1)[0], clock)
    robot = Unpaced(MavlinkRobot("vehicle", own, lambda: line))
    return Bench(robot, loop, link, own.feed_forward)


def some_loop(rng: np.random.Generator) -> LoopSettings:
    """Draw a loop."""
    return LoopSettings(
        omega_rad_s=float(rng.uniform(4.5, 8.0)),
        damping=float(rng.uniform(0.5, 0.9)),
        delay_s=float(rng.uniform(0.02, 0.05)),
    )


def tones(one: Bench, seed: int) -> Iterator[tuple[float, float, float]]:
    """Play one test; yield each tone's error and the radius of its disc.

    The last number is the radius with the unknown delay that the driver's spec declares.
    """
    phases = 2 * np.pi * np.random.default_rng(seed).random(len(OMEGAS_RAD_S))
    asked = tuple(
        Tone(omega_rad_s=omega, phase_rad=float(phase))
        for omega, phase in zip(OMEGAS_RAD_S, phases, strict=True)
    )
    spec = one.robot.spec
    plan = plan_excitation(Excitation(axis="x", tones=asked, segments=SEGMENTS), spec, "vehicle")
    switch = HaltSwitch()
    motion = AxisMotion(
        one.robot,
        ("x",),
        reference_of(plan),
        realtime=None,
        switch=switch,
        on_samples=lambda *_: None,
    )
    played = perform(one.robot, motion, switch, on_resting=lambda: None)
    if played.outcome is not Outcome.COMPLETED:
        print(f"a test failed: {played.reason}", flush=True)
        return
    response = estimate_frequency_response(played.samples.reference, played.samples.response, plan)
    if played.samples.timing is not None:
        response = response.delayed(played.samples.timing.clock_std_s)
    errors = np.abs(response.z - one.truth(response.omega_rad_s))
    radii = response.radius(ALPHA)
    delayed = NORMAL_95 * response.omega_rad_s * spec.delay_uncertainty_s * np.abs(response.z)
    yield from zip(errors, radii, np.hypot(radii, delayed), strict=True)


def psi_exact(one: Bench, other: Bench) -> float:
    """Return the largest chordal distance in the band."""
    omega = np.linspace(*BAND_RAD_S, 401)
    z, w = one.truth(omega), other.truth(omega)
    return float(np.max(np.abs(z - w) / np.sqrt((1 + np.abs(z) ** 2) * (1 + np.abs(w) ** 2))))


def study(build: Build, seed: int) -> tuple[float, float, float]:
    """Rank one vehicle against another; return ψ*, its standard deviation, and the truth."""
    rng = np.random.default_rng([7, seed])
    pair = {name: build(some_loop(rng), rng) for name in ("target", "other")}
    keys = FleetKeys("figures")
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        endpoint = f"unixsock-stream/{folder}/r.sock"
        stack.enter_context(open_router([endpoint]))
        for name, one in pair.items():
            session = stack.enter_context(open_client(endpoint, timeout_s=60.0))
            stack.enter_context(Agent(session, keys, name, one.robot, realtime=None))
        found = nufleet.rank(
            connect=endpoint,
            fleet_name=keys.fleet,
            target="target",
            band_rad_s=BAND_RAD_S,
            iterations=3,
            seed=seed,
            wait_s=60.0,
            draws=False,
            rehearses=False,
            runs_root=Path(folder),
        )
    (estimate,) = found.ranking
    sigma = (estimate.psi_high - estimate.psi_low) / (2 * NORMAL_95)
    return estimate.psi, sigma, psi_exact(pair["target"], pair["other"])


def fly_tests(build: Build, tests: int, seed: int) -> None:
    """Play tests on one loop each, and print how many tones lie in their discs."""
    rows: list[tuple[float, float, float]] = []
    for number in range(tests):
        rng = np.random.default_rng([seed, number])
        one = build(some_loop(rng), rng)
        one.robot.connect()
        one.robot.begin()
        rows += tones(one, number)
        one.robot.end()
        one.robot.disconnect()
    errors, radii, with_delay = np.array(rows).T
    print(
        f"{int((errors <= radii).sum())} of {len(rows)} tones lie in their discs of 95 %, "
        f"{int((errors <= with_delay).sum())} with the declared delay; median error "
        f"{np.median(errors):.2g}, median radius {np.median(radii):.2g}"
    )


def given_figures(description: str) -> argparse.ArgumentParser:
    """Return a parser of what both drivers' figures are asked for by."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--tests", type=int, default=0, help="tests of five tones each")
    parser.add_argument("--studies", type=int, default=0, help="rankings of two vehicles")
    parser.add_argument("--delay", type=float, default=0.002, metavar="S", help="least delay")
    parser.add_argument("--jitter", type=float, default=0.008, metavar="S", help="mean of it")
    parser.add_argument("--loss", type=float, default=0.01, help="share of lost packets")
    parser.add_argument("--seed", type=int, default=0)
    return parser


def show(build: Build, given: argparse.Namespace) -> None:
    """Fly, and print the shares."""
    if given.tests:
        fly_tests(build, given.tests, given.seed)
    held = 0
    for number in range(given.seed, given.seed + given.studies):
        psi, sigma, truth = study(build, number)
        off = abs(psi - truth) / sigma
        held += off <= 2
        print(
            f"study {number}: {psi:.4f} ± {sigma:.4f}, truth {truth:.4f}: {off:.1f} σ", flush=True
        )
    if given.studies:
        print(f"{held} of {given.studies} studies within 2 σ")


def main() -> None:
    """Parse the command line, fly, and print the shares."""
    parser = given_figures(__doc__.splitlines()[0])
    parser.add_argument(
        "--odometry", action="store_true", help="measure by ODOMETRY, whose stamps are in µs"
    )
    given = parser.parse_args()
    link = LinkSettings(delay_s=given.delay, jitter_s=given.jitter, loss=given.loss)
    settings = SETTINGS
    if given.odometry:
        settings = settings.model_copy(update={"measured_by": "ODOMETRY"})
    show(lambda loop, rng: bench(settings, loop, link, rng), given)


if __name__ == "__main__":
    main()
