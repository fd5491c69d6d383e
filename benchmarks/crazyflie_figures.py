"""How well responses and distances hold that are measured by the Crazyflie driver's own parts.

Set-points are packed as the driver packs them, and packets are late or lost on their way to a
simulated drone of known loop and back. What it logs passes the driver's own telemetry, clock and
record, on a virtual clock, so that the machine's load does not matter. cflib, sockets and threads
take no part here: `benchmarks.real_drivers --driver crazyflie` measures with them, in real time.
`--tests` and `--studies` mean what they do in `benchmarks.mavlink_figures`.

    python -m benchmarks.crazyflie_figures --tests 40
    python -m benchmarks.crazyflie_figures --studies 20
"""

from __future__ import annotations

import heapq
import itertools
import struct

import numpy as np
from numpy.typing import NDArray

from benchmarks.mavlink_figures import Bench, given_figures, show
from benchmarks.real_drivers import Link, received
from nufleet.robot_agent.drivers.crazyflie.link import _whole_mm
from nufleet.robot_agent.drivers.crazyflie.robot import STAMP_STD_S
from nufleet.robot_agent.drivers.crazyflie.settings import AXES, CrazyflieSettings, spec_of
from nufleet.robot_agent.drivers.crazyflie.telemetry import STATE_VARIABLES, Telemetry
from nufleet.robot_agent.robot import Record, Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.robots.spec import RobotSpec
from nufleet.sims.crazyflies.firmware import Firmware
from nufleet.sims.crazyflies.plant import KnownLoop, LoopSettings
from nufleet.sims.crazyflies.tables import LOGGED
from nufleet.sims.mavlink_vehicle.loop import LoopSettings as DrawnLoop
from nufleet.sims.mavlink_vehicle.virtual_line import LinkSettings

SKEW_MAX = 3e-5
"""Largest relative error of the drone's clock."""

_KINDS = {"float": 7, "FP16": 8, "uint32_t": 3}
_BLOCK = b"".join(
    struct.pack("<BH", _KINDS[kind or ""], list(LOGGED).index(name))
    for name, kind in STATE_VARIABLES
)
_ARM, _SET_UP, _START = b"\x91\x01\x01", b"\x51\x06\x00" + _BLOCK, b"\x51\x03\x00\x01"


class VirtualCrazyflie(Robot):
    """A drone of known response that hovers at its origin; nothing watches over it."""

    def __init__(
        self,
        settings: CrazyflieSettings,
        loop: LoopSettings,
        link: LinkSettings,
        rng: np.random.Generator,
    ) -> None:
        self._settings, self._link, self._rng = settings, link, rng
        self._delay_s = loop.delay_s + link.delay_s
        self._spec = spec_of(settings).model_copy(update={"simulated": True})
        self._origin_m = np.array(settings.origin_m)
        self._columns = [AXES.index(axis) for axis in settings.axes]
        self._now_s = 0.0
        self._firmware = Firmware(
            KnownLoop(loop, settings.origin_m), rng.spawn(1)[0], now_s=0.0, noise_m=0.001
        )
        rate, phase_ms = 1 + rng.uniform(-SKEW_MAX, SKEW_MAX), rng.random()
        self._firmware.ailments.stamp_ms = lambda ms: int(rate * ms + phase_ms)
        self._telemetry = Telemetry(settings.log_period_s)
        self._under_way: list[tuple[float, int, bool, bytes]] = []
        self._count = itertools.count()
        self._reached_s = 0.0
        self._sent_s: list[float] = []
        self._last = np.zeros(3)

    @property
    def spec(self) -> RobotSpec:
        """Description of the drone, which agents need not watch for gaps in real time."""
        return self._spec

    def connect(self) -> None:
        """Arm it, and have it log."""
        for packet in (_ARM, _SET_UP, _START):
            self._down(self._firmware.take(packet, self._now_s))
        self._settle()

    def measure_output(self) -> FloatArray:
        """Return the next measurement, shape (axes,)."""
        self._pass(self._settings.log_period_s)
        return self._output()

    def step(self, reference: FloatArray) -> FloatArray:
        """Send a reference, shape (axes,); return the newest output."""
        if not self._sent_s:
            self._telemetry.begin_recording()
        measured = self._output()
        offset = np.zeros(3)
        offset[self._columns] = reference
        self._sent_s.append(self._now_s)
        self._send(offset)
        self._pass(self._spec.sample_time_s)
        return measured

    def record(self) -> Record:
        """Return the measurements of the motion."""
        for _ in range(50):
            if self._telemetry.dated_newest() <= self._sent_s[-1]:
                self._pass(self._settings.log_period_s)
        measured_s, positions = self._telemetry.dated()
        offsets = (positions - self._origin_m)[:, self._columns]
        return Record(np.array(self._sent_s), measured_s, offsets, STAMP_STD_S)

    def rest(self) -> None:
        """Hold reference 0 until it has settled."""
        self._telemetry.end_recording()
        self._sent_s = []
        self._settle()

    def disconnect(self) -> None:
        """Do nothing."""

    def _settle(self) -> None:
        for _ in range(round(self._spec.settling_time_s / self._spec.sample_time_s)):
            self._send(np.zeros(3))
            self._pass(self._spec.sample_time_s)

    def _output(self) -> FloatArray:
        newest = self._telemetry.newest
        if newest is None:
            return np.zeros(len(self._columns))
        output: FloatArray = (newest.position_m - self._origin_m)[self._columns]
        return output

    def _send(self, offset: FloatArray) -> None:
        velocity = (offset - self._last) / self._spec.sample_time_s
        self._last = offset
        numbers = [*_whole_mm(self._origin_m + offset), *_whole_mm(velocity)]
        packet = b"\x70\x06" + struct.pack("<hhhhhh", *(int(1000 * one) for one in numbers))
        late_s = self._delay_s + 2 * self._link.jitter_s * self._rng.random()
        if self._rng.random() >= self._link.loss:
            self._reached_s = max(self._reached_s, self._now_s + late_s)
            self._fly(self._reached_s, packet, up=True)

    def _fly(self, arrives_s: float, packet: bytes, *, up: bool) -> None:
        heapq.heappush(self._under_way, (arrives_s, next(self._count), up, packet))

    def _down(self, packets: list[tuple[float, bytes]]) -> None:
        for sent_s, packet in packets:
            if packet[0] == 0x52 and self._rng.random() >= self._link.loss:
                self._fly(sent_s + self._link.jitter_s * self._rng.exponential(), packet, up=False)

    def _pass(self, lasts_s: float) -> None:
        until_s = self._now_s + lasts_s
        while self._under_way and self._under_way[0][0] <= until_s:
            at_s, _, up, packet = heapq.heappop(self._under_way)
            if up:
                self._down(self._firmware.take(packet, at_s))
            else:
                values = struct.unpack("<fffeeeI", packet[5:])
                state = dict(zip((name for name, _ in STATE_VARIABLES), values, strict=True))
                self._telemetry.take_state(int.from_bytes(packet[2:5], "little"), state, at_s)
        self._down(self._firmware.advance(until_s))
        self._now_s = until_s


class DroneBench(Bench):
    """A drone, and its exact response."""

    def truth(self, omega_rad_s: FloatArray) -> NDArray[np.complex128]:
        """Return z, shape (frequencies,)."""
        known, link = _known(self.loop), Link(self.link.jitter_s, self.link.loss)
        late = known.model_copy(update={"delay_s": known.delay_s + self.link.delay_s})
        period_s = self.robot.spec.sample_time_s
        return np.array([received(link, late, one, period_s) for one in omega_rad_s.tolist()])


def _known(loop: DrawnLoop) -> LoopSettings:
    return LoopSettings(
        omega_rad_s=loop.omega_rad_s, damping_ratio=loop.damping, delay_s=loop.delay_s
    )


def main() -> None:
    """Parse the command line, fly, and print the shares."""
    given = given_figures(__doc__.splitlines()[0]).parse_args()
    link = LinkSettings(delay_s=given.delay, jitter_s=given.jitter, loss=given.loss)
    own = CrazyflieSettings(uri="udp://127.0.0.1:19850", axes=("x",), parameters={})

    def build(loop: DrawnLoop, rng: np.random.Generator) -> Bench:
        robot = VirtualCrazyflie(own, _known(loop), link, rng)
        return DroneBench(robot, loop, link, feed_forward=False)

    show(build, given)


if __name__ == "__main__":
    main()
