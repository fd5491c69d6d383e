"""What a robot in a lab has and a simulation has not: a slow link, a battery, a ground."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from nufleet.robot_agent.robot import Record, Robot, RobotAround
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotDownError, RobotError
from nufleet.shared.robots.health import Health
from nufleet.shared.strict import NonNegative, Positive, Strict

RESERVE = 0.1
"""Share of the battery that is kept for coming back and landing."""

CRITICAL = 0.02
"""Share of the battery below which the robot is not ready."""


class FieldSettings(Strict):
    """The conditions under which a simulated robot plays a real one."""

    delay_s: NonNegative = 0.0
    """Time from a measurement until it arrives."""
    jitter_s: NonNegative = 0.0
    """Mean of the further time, which is distributed exponentially."""
    loss: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of the measurements that never arrive."""
    battery_s: Positive | None = None
    """Time of motion from a full battery to an empty one; None for a robot with a cable."""
    takes_off: bool = False
    """Whether it stays on the ground until `begin`."""
    switch: bool = False
    """Whether its motors can be cut."""


class FieldRobot(RobotAround):
    """A simulated robot that is measured late, runs on a battery, and takes off."""

    def __init__(self, robot: Robot, settings: FieldSettings, rng: np.random.Generator) -> None:
        """Wrap a robot.

        Args:
            robot: The robot inside, disconnected.
            settings: Conditions.
            rng: Generator of the link's jitter and losses.
        """
        super().__init__(robot)
        self._settings, self._rng = settings, rng
        self._left_s = settings.battery_s
        self._flying = self._cut = False
        self._forget()

    def connect(self) -> None:
        """Connect the robot inside; a switch that was thrown is reset, and the battery is not."""
        self._cut = self._flying = False
        self._forget()
        self._robot.connect()

    def begin(self) -> None:
        """Take off."""
        self._check_switch()
        self._robot.begin()
        self._flying = True

    def end(self) -> None:
        """Land."""
        self._check_switch()
        self._robot.end()
        self._flying = False

    def measure_output(self) -> FloatArray:
        """Measure the output at rest, shape (axes,)."""
        self._check_flying()
        return self._robot.measure_output()

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference, shape (axes,), for one sample; return the newest measurement."""
        output: FloatArray = self.run(reference[np.newaxis])[0]
        return output

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a signal, shape (samples, axes); return the newest measurement at each sample."""
        self._check_flying()
        if self._left_s is not None:
            self._left_s -= len(references) * self.spec.sample_time_s
            if self._left_s <= 0:
                raise RobotDownError("its battery is empty")
        outputs = self._robot.run(references)
        return np.array([self._newest(output) for output in outputs]).reshape(outputs.shape)

    @property
    def state_names(self) -> tuple[str, ...]:
        """No names: the link carries the output alone."""
        return ()

    def observe(self) -> FloatArray:
        """Return no states, shape (axes, 0)."""
        return np.empty((len(self.spec.axes), 0))

    def record(self) -> Record:
        """Return the measurements that have arrived until now or are on their way."""
        sent_s = self.spec.sample_time_s * np.arange(self._samples, dtype=np.float64)
        axes = len(self.spec.axes)
        outputs = np.array([output for _, _, output in self._sent]).reshape(-1, axes)
        return Record(sent_s, np.array([taken_s for _, taken_s, _ in self._sent]), outputs)

    def health(self) -> Health:
        """Return the charge of the battery."""
        whole_s, left_s = self._settings.battery_s, self._left_s
        if self._cut:
            return Health(ready=False, reason="its motors were cut")
        if whole_s is None or left_s is None:
            return Health()
        charge = max(0.0, left_s / whole_s)
        empty = charge < CRITICAL
        return Health(
            ready=not empty,
            reason="its battery is empty: charge it" if empty else "",
            battery=charge,
            endurance_s=max(0.0, left_s - RESERVE * whole_s),
        )

    def kill(self) -> None:
        """Cut the motors."""
        if not self._settings.switch:
            super().kill()
        self._cut = True

    def rest(self) -> None:
        """Bring the robot inside to rest."""
        self._check_switch()
        self._forget()
        self._robot.rest()

    def disconnect(self) -> None:
        """Disconnect the robot inside."""
        self._forget()
        self._robot.disconnect()

    def _forget(self) -> None:
        self._samples = 0
        # Measurements that are not lost: when each arrives, when it was taken, and what it says.
        self._sent: list[tuple[float, float, FloatArray]] = []

    def _newest(self, output: FloatArray) -> FloatArray:
        """Send a measurement on its way, and return the newest one that has arrived."""
        settings, now_s = self._settings, self._samples * self.spec.sample_time_s
        late_s = settings.delay_s + settings.jitter_s * self._rng.exponential()
        if self._rng.random() >= settings.loss:
            self._sent.append((now_s + late_s, now_s, output))
        self._samples += 1
        arrived = (one for one in reversed(self._sent) if one[0] <= now_s)
        newest = next(arrived, None)
        return np.zeros_like(output) if newest is None else newest[2]

    def _check_flying(self) -> None:
        self._check_switch()
        if self._settings.takes_off and not self._flying:
            raise RobotError("it stands on the ground: `begin` has to be called first")

    def _check_switch(self) -> None:
        if self._cut:
            raise RobotDownError("its motors were cut")
