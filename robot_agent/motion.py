"""Plays one planned motion on the robot and brings it to rest, whatever happens."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from robot_agent.robot import Robot
from shared.arrays import FloatArray
from shared.errors import RobotError
from shared.messages import Outcome

CHUNK_SAMPLES = 256
"""A simulation as fast as it can plays so many samples between two looks at the switch."""

GAP_MAX_S = 2.0
"""A paced motion whose samples are this far apart ends: the process was frozen, or the robot hung.
Whoever commands it will have given it up by then."""

CATCH_UP_MAX_S = 0.25
"""A paced simulation that is later than this goes on at its pace and does not catch up."""

_log = logging.getLogger(__name__)

OnSamples = Callable[[int, FloatArray, FloatArray], None]


@dataclass(frozen=True)
class Played:
    """What was played and measured until the motion ended; both shape (samples,).

    `fault` is why the robot cannot be trusted with another motion; None when it can.
    """

    outcome: Outcome
    reason: str
    reference: FloatArray
    response: FloatArray
    fault: str | None = None


class HaltSwitch:
    """Set from any thread to end a motion; keeps the first outcome and reason it was given."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._thrown = threading.Event()
        self._order: tuple[Outcome, str] | None = None

    def halt(self, outcome: Outcome, reason: str) -> None:
        """Ask the motion to end."""
        with self._lock:
            if self._order is None:
                self._order = (outcome, reason)
        self._thrown.set()

    @property
    def order(self) -> tuple[Outcome, str] | None:
        """How the motion is to end; None while it may go on."""
        return self._order

    def wait(self, timeout_s: float) -> None:
        """Wait for so long, or until the switch is thrown."""
        self._thrown.wait(timeout_s)


def play(
    robot: Robot,
    axis: str,
    reference: FloatArray,
    *,
    realtime: float | None,
    switch: HaltSwitch,
    on_samples: OnSamples,
    on_resting: Callable[[], None] = lambda: None,
) -> Played:
    """Play a reference on one axis from rest to rest.

    A robot that breaks its interface (raises anything but `RobotError`, or does not come to rest)
    gives a failed motion with a fault; nothing that it raises leaves this function.

    Args:
        robot: connected and at rest.
        axis: the axis that follows; the others hold zero.
        reference: shape (samples,), in the axis's unit.
        realtime: paces a simulated robot at this multiple of real time; None lets it play as fast
            as it can. A real robot paces itself, one sample at a time.
        switch: ends the motion early.
        on_samples: called with the first index and the samples of each batch.
        on_resting: called when the last sample has been played.
    """
    player = _Player(robot, axis, reference, switch, on_samples)
    fault: str | None = None
    try:
        outcome, reason = player.play(realtime)
    except RobotError as error:
        outcome, reason = Outcome.FAILED, str(error)
    except Exception as error:  # noqa: BLE001 - a driver's mistake must not leave it moving
        _log.exception("a motion ended unexpectedly")
        outcome, reason = Outcome.FAILED, f"an unexpected error: {error!r}"
        fault = reason
    try:
        on_resting()
    finally:
        not_at_rest = _bring_to_rest(robot)
    if not_at_rest is not None:
        outcome = Outcome.FAILED
        reason = f"{reason}; {not_at_rest}" if reason else not_at_rest
        fault = reason
    done = player.done
    return Played(outcome, reason, reference[:done].copy(), player.response[:done].copy(), fault)


def _bring_to_rest(robot: Robot) -> str | None:
    """Bring the robot to rest; return why that failed, None when it is at rest."""
    try:
        robot.rest()
    except RobotError as error:
        return f"could not come to rest: {error}"
    except Exception as error:  # noqa: BLE001 - a driver's mistake, as above
        _log.exception("a robot did not come to rest")
        return f"could not come to rest: {error!r}"
    return None


class _Player:
    """Plays the batches of one motion and keeps what was measured."""

    def __init__(
        self,
        robot: Robot,
        axis: str,
        reference: FloatArray,
        switch: HaltSwitch,
        on_samples: OnSamples,
    ) -> None:
        self._robot = robot
        self._axis = axis
        self._reference = reference
        self._switch = switch
        self._on_samples = on_samples
        self.response = np.empty_like(reference)
        self.done = 0

    def play(self, realtime: float | None) -> tuple[Outcome, str]:
        axes = [axis.name for axis in self._robot.spec.axes]
        column = axes.index(self._axis)
        for start, stop in self._batches(realtime):
            if self._switch.order is not None:
                return self._switch.order
            references = np.zeros((stop - start, len(axes)))
            references[:, column] = self._reference[start:stop]
            measured = (
                self._robot.run(references)
                if stop - start > 1
                else self._robot.step(references[0])[np.newaxis, :]
            )
            good = int(np.argmin(np.append(np.isfinite(measured).all(axis=1), False)))
            self.response[start : start + good] = measured[:good, column]
            self.done = start + good
            self._on_samples(
                start, self._reference[start : self.done], self.response[start : self.done]
            )
            if good < stop - start:
                reason = f"the sensor returned a number that is not finite at sample {self.done}"
                return Outcome.FAILED, reason
        return Outcome.COMPLETED, ""

    def _batches(self, realtime: float | None) -> Iterator[tuple[int, int]]:
        """Yield the next samples to play: many at once, or single ones at their time."""
        samples, spec = len(self._reference), self._robot.spec
        if realtime is None and spec.simulated:
            for start in range(0, samples, CHUNK_SAMPLES):
                yield start, min(start + CHUNK_SAMPLES, samples)
            return
        period_s = spec.sample_time_s / (realtime if realtime and spec.simulated else 1.0)
        due_s = last_s = time.monotonic()
        for k in range(samples):
            if spec.simulated:
                self._switch.wait(max(0.0, due_s - time.monotonic()))
            now_s = time.monotonic()
            if now_s - last_s > GAP_MAX_S + period_s:
                gap = f"nothing happened for {now_s - last_s:.1f} s before sample {k}"
                self._switch.halt(Outcome.ABORTED, gap)
            last_s = now_s
            due_s = max(due_s, now_s - CATCH_UP_MAX_S) + period_s
            yield k, k + 1
