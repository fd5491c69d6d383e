"""A robot that does what a test tells it: it follows perfectly, or fails as one asks."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.robots.health import Health
from nufleet.shared.robots.spec import AxisSpec, RobotSpec


def puppet_spec(*, simulated: bool = True, sample_time_s: float = 0.01) -> RobotSpec:
    return RobotSpec(
        kind="puppet",
        axes=tuple(
            AxisSpec(
                name=name, unit="m", amplitude_max=1.0, velocity_max=10.0, acceleration_max=100.0
            )
            for name in ("x", "y")
        ),
        sample_time_s=sample_time_s,
        omega_min_rad_s=0.01,
        omega_max_rad_s=50.0,
        duration_max_s=3600.0,
        settling_time_s=0.5,
        simulated=simulated,
    )


class PuppetRobot(Robot):
    """Two axes, x and y. The hooks are called before what they are named after is done.

    `on_sample` gets the index of the sample in the motion and may raise or block; what `measure`
    returns is what the robot returns for a batch of references.
    """

    def __init__(self, spec: RobotSpec | None = None) -> None:
        self._spec = puppet_spec() if spec is None else spec
        self._busy = threading.Lock()
        self.on_sample: Callable[[int], None] = lambda k: None
        self.measure: Callable[[FloatArray], FloatArray] = np.copy
        self.rests_at = np.zeros(len(self._spec.axes))
        self.on_rest: Callable[[], None] = lambda: None
        self.on_connect: Callable[[], None] = lambda: None
        self.on_disconnect: Callable[[], None] = lambda: None
        self.on_begin: Callable[[], None] = lambda: None
        self.on_end: Callable[[], None] = lambda: None
        self.on_kill: Callable[[], None] | None = None
        self.reports: Callable[[], Health | None] = lambda: None
        self.begun = 0
        self.ended = 0
        self.connected = False
        self.at_rest = True
        self.motions = 0
        self.samples = 0
        self.batches: list[int] = []
        self.references: list[FloatArray] = []

    @property
    def spec(self) -> RobotSpec:
        return self._spec

    def connect(self) -> None:
        with self._alone():
            self.on_connect()
            self.connected = True

    def begin(self) -> None:
        assert self.connected
        with self._alone():
            self.begun += 1
            self.on_begin()

    def end(self) -> None:
        assert self.connected
        with self._alone():
            self.ended += 1
            self.on_end()

    def health(self) -> Health | None:
        return self.reports()

    def kill(self) -> None:
        if self.on_kill is None:
            super().kill()
        else:
            self.on_kill()

    def measure_output(self) -> FloatArray:
        assert self.connected
        with self._alone():
            return self.rests_at.copy()

    def step(self, reference: FloatArray) -> FloatArray:
        assert reference.shape == (len(self._spec.axes),)
        return np.asarray(self.run(reference[np.newaxis])[0])

    def run(self, references: FloatArray) -> FloatArray:
        assert self.connected
        with self._alone():
            if self.at_rest:
                self.motions += 1
                self.samples = 0
                self.at_rest = False
            self.batches.append(len(references))
            for _ in references:
                self.on_sample(self.samples)
                self.samples += 1
            self.references.append(references.copy())
            return self.measure(references)

    def rest(self) -> None:
        assert self.connected
        with self._alone():
            self.on_rest()
            self.at_rest = True

    def disconnect(self) -> None:
        with self._alone():
            self.on_disconnect()
            self.at_rest = True
            self.connected = False

    @contextmanager
    def _alone(self) -> Iterator[None]:
        """The interface promises drivers that they are called from one thread at a time."""
        assert self._busy.acquire(blocking=False), "called from two threads at once"
        try:
            yield
        finally:
            self._busy.release()
