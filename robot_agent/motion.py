"""Plays one planned motion on the robot and brings it to rest, whatever happens."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from robot_agent.robot import Robot
from shared.arrays import FloatArray
from shared.errors import RobotError
from shared.messages import Outcome

CHUNK_SAMPLES = 256
"""A robot that plays as fast as it can plays this many samples between two looks at the switch."""

OnSamples = Callable[[int, FloatArray, FloatArray], None]


@dataclass(frozen=True)
class Played:
    """What was played and measured until the motion ended; both shape (samples,)."""

    outcome: Outcome
    reason: str
    reference: FloatArray
    response: FloatArray


class HaltSwitch:
    """Set from another thread to end a motion; keeps the first outcome and reason it was given."""

    def __init__(self) -> None:
        self._order: tuple[Outcome, str] | None = None

    def halt(self, outcome: Outcome, reason: str) -> None:
        """Ask the motion to end."""
        if self._order is None:
            self._order = (outcome, reason)

    @property
    def order(self) -> tuple[Outcome, str] | None:
        """How the motion is to end; None while it may go on."""
        return self._order


def play(
    robot: Robot,
    axis: str,
    reference: FloatArray,
    *,
    realtime: float | None,
    switch: HaltSwitch,
    on_samples: OnSamples,
) -> Played:
    """Play a reference on one axis from rest to rest.

    Args:
        robot: connected and at rest.
        axis: the axis that follows; the others hold zero.
        reference: shape (samples,), in the axis's unit.
        realtime: None lets the robot play as fast as it can (or paces itself); 1.0 is real time.
        switch: ends the motion early.
        on_samples: called with the first index and the samples of each batch.
    """
    column = [spec.name for spec in robot.spec.axes].index(axis)
    response = np.empty_like(reference)
    done = 0
    outcome, reason = Outcome.COMPLETED, ""
    try:
        for start, stop in _batches(len(reference), robot.spec.sample_time_s, realtime):
            if switch.order is not None:
                outcome, reason = switch.order
                break
            references = np.zeros((stop - start, len(robot.spec.axes)))
            references[:, column] = reference[start:stop]
            measured = (
                robot.run(references)
                if stop - start > 1
                else robot.step(references[0])[np.newaxis, :]
            )
            good = int(np.argmin(np.append(np.isfinite(measured).all(axis=1), False)))
            response[start : start + good] = measured[:good, column]
            done = start + good
            on_samples(start, reference[start:done], response[start:done])
            if good < stop - start:
                outcome = Outcome.FAILED
                reason = f"the sensor returned a number that is not finite at sample {done}"
                break
    except RobotError as error:
        outcome, reason = Outcome.FAILED, str(error)
    try:
        robot.rest()
    except RobotError as error:
        outcome = Outcome.FAILED
        reason = f"{reason + '; ' if reason else ''}could not come to rest: {error}"
    return Played(outcome, reason, reference[:done].copy(), response[:done].copy())


def _batches(
    samples: int, sample_time_s: float, realtime: float | None
) -> Iterator[tuple[int, int]]:
    """Yield the next samples to play: large batches at once, or single ones at their time."""
    if realtime is None:
        for start in range(0, samples, CHUNK_SAMPLES):
            yield start, min(start + CHUNK_SAMPLES, samples)
        return
    period_s = sample_time_s / realtime
    began_s = time.monotonic()
    for k in range(samples):
        wait_s = began_s + k * period_s - time.monotonic()
        if wait_s > 0:
            time.sleep(wait_s)
        yield k, k + 1
