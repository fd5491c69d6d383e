"""How well responses and distances hold that are measured through the driver `ros2`.

The driver moves robots of known loops over a link with jitter and losses, on a virtual clock, so
that neither the machine's load nor its speed matters. Their own clocks are ahead, and drift. ROS 2
itself takes no part here: `benchmarks.real_drivers --driver ros2` measures over it, in real time.
`--tests` compares every tone with the truth: it should lie in the disc that its test claims to hold
it with 95 %. `--studies` ranks one robot against another, by agents and `nufleet.rank`, and
compares ψ* with the closed form.

    python -m benchmarks.ros2_figures --tests 40
    python -m benchmarks.ros2_figures --studies 20
"""

from __future__ import annotations

import heapq
import itertools
import json
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.mavlink_figures import Bench, Unpaced, given_figures, show
from benchmarks.real_drivers import ROS2_ROBOT
from nufleet.robot_agent.drivers.ros2.clocks import Arrivals, Arrived
from nufleet.robot_agent.drivers.ros2.link import Link
from nufleet.robot_agent.drivers.ros2.messages import SetPoint
from nufleet.robot_agent.drivers.ros2.robot import Ros2Robot
from nufleet.robot_agent.drivers.ros2.settings import Ros2Settings
from nufleet.sims.mavlink_vehicle.loop import Loop, LoopSettings
from nufleet.sims.mavlink_vehicle.virtual_line import LinkSettings

MEASURED_EVERY_S = 0.01
NOISE_M = 0.001
AHEAD_S = 40.0
"""Time by which the robot's clock is ahead."""


class WaitedArrivals(Arrivals):
    """Measurements that arrive while a link lets time pass."""

    wait: Callable[[float], None]

    def next(self, timeout_s: float) -> Arrived:
        """Let time pass until the next measurement, which comes within a few periods."""
        before = self.newest()
        while self.newest() is before:
            self.wait(MEASURED_EVERY_S)
        arrived = self.newest()
        assert arrived is not None  # noqa: S101 - another one than before has come
        return arrived


class VirtualRos(Link):
    """A robot at the other end of a link that delays and loses messages, on a virtual clock."""

    def __init__(
        self,
        own: Ros2Settings,
        loop: LoopSettings,
        link: LinkSettings,
        rng: np.random.Generator,
    ) -> None:
        """Begin at rest at 0."""
        self._own, self._settings, self._link, self._rng = own, loop, link, rng
        self._loop = Loop(loop, np.zeros(3))
        self._rate = 1 + float(rng.uniform(-4e-5, 4e-5))
        self._time_s = self._at_s = self._measured_s = self._sent_s = 0.0
        self._coming: list[tuple[float, int, Callable[[], None]]] = []
        self._numbers = itertools.count()
        self._newest, self._arrived_s = -1, 0.0
        self._resend: Callable[[], None] | None = None
        self.arrivals = WaitedArrivals("/measured", own.measured, own.measurement.stamps)
        self.arrivals.wait = lambda lasts_s: self.wait_until(self._time_s + lasts_s)
        self.wait_until(1.0)

    def now_s(self) -> float:
        """Return the virtual time."""
        return self._time_s

    def wait_until(self, due_s: float) -> None:
        """Let time pass."""
        while True:
            coming_s = self._coming[0][0] if self._coming else np.inf
            next_s = min(coming_s, self._measured_s)
            if next_s > due_s:
                break
            self._time_s = max(self._time_s, next_s)
            if coming_s <= self._measured_s:
                heapq.heappop(self._coming)[2]()
            else:
                self._measure()
        self._time_s = max(self._time_s, due_s)

    def send(self, point: SetPoint) -> float:
        """Send a set-point on its way."""
        number, self._sent_s = next(self._numbers), self._time_s
        place = np.array([point.positions[name] for name in "xyz"])
        late_s = self._late_s()
        if late_s is not None:
            at_s = self._time_s + late_s + self._settings.delay_s
            heapq.heappush(self._coming, (at_s, number, lambda: self._aim(number, place)))
        return self._time_s

    def keep_sending(self, resend: Callable[[], None] | None) -> None:
        """Call a function whenever one and a half samples pass without a set-point; None stops."""
        self._resend = resend

    def call(self, role: str, engage: bool, timeout_s: float, requests: int = 1) -> None:
        """Do nothing: the robot has no services."""

    def problem(self) -> str | None:
        """Return None: all is well."""

    def charge(self) -> float | None:
        """Return None: the robot has no battery."""

    def close(self) -> None:
        """Do nothing."""

    def _late_s(self) -> float | None:
        """Return how long a message travels; None if it is lost."""
        late_s = self._link.delay_s + self._link.jitter_s * self._rng.exponential()
        return None if self._rng.random() < self._link.loss else late_s

    def _advance(self) -> None:
        self._loop.advance(self._time_s - self._at_s)
        self._at_s = self._time_s

    def _aim(self, number: int, place: np.ndarray[Any, Any]) -> None:
        if number > self._newest:  # one that was overtaken is dropped
            self._advance()
            self._newest = number
            self._loop.aim(place, np.zeros(3))

    def _measure(self) -> None:
        self._advance()
        self._measured_s += MEASURED_EVERY_S
        place = self._loop.position + NOISE_M * self._rng.standard_normal(3)
        values = dict(zip(("x", "y", "z", "yaw"), [*place.tolist(), 0.0], strict=True))
        stamp_s, late_s = AHEAD_S + self._rate * self._time_s, self._late_s()
        if late_s is not None:  # measurements arrive in order
            at_s = self._arrived_s = max(self._arrived_s, self._time_s + late_s)
            taken = (at_s, next(self._numbers), lambda: self.arrivals.take(stamp_s, at_s, values))
            heapq.heappush(self._coming, taken)
        if self._resend is not None and self._time_s - self._sent_s > 1.5 * self._own.sample_time_s:
            self._resend()


def bench(loop: LoopSettings, link: LinkSettings, rng: np.random.Generator) -> Bench:
    """Build a robot, disconnected."""
    own = Ros2Settings.model_validate_json(json.dumps(ROS2_ROBOT))
    robot = Ros2Robot("drone", own, lambda _, described: VirtualRos(described, loop, link, rng))
    return Bench(Unpaced(robot), loop, link, feed_forward=False)


def main() -> None:
    """Parse the command line, fly, and print the shares."""
    given = given_figures(__doc__.splitlines()[0]).parse_args()
    link = LinkSettings(delay_s=given.delay, jitter_s=given.jitter, loss=given.loss)
    show(lambda loop, rng: bench(loop, link, rng.spawn(1)[0]), given)


if __name__ == "__main__":
    main()
