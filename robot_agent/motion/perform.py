"""Performs one motion on the robot and brings it to rest, even when the motion fails."""

from __future__ import annotations

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np

from nufleet.robot_agent.motion.monitored_robot import begun
from nufleet.robot_agent.motion.pace import HaltSwitch, Pace
from nufleet.robot_agent.motion.paced_robot import Halted, play, play_observed
from nufleet.robot_agent.motion.resampling import outputs_at_samples
from nufleet.robot_agent.motion.steps import Steps, make
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import OutsideLimitsError, RobotDownError, RobotError
from nufleet.shared.frequency_test.timing import Timing
from nufleet.shared.wire.messages import Outcome
from nufleet.shared.wire.motions import FlightDetails

OBSERVE_SAMPLES = 64
"""Samples from one observation of a robot's states to the next in a test, which does not need them:
some twenty tell how they follow from the output."""
OBSERVE_RUN = 3
"""Number of samples in a row at each observation, which tell how noisy the states are."""

_log = logging.getLogger(__name__)

OnSamples = Callable[[int, FloatArray, FloatArray], None]
"""Callback for a batch: index of its first sample, its references and outputs (see `Samples`)."""


@dataclass(frozen=True, eq=False)
class Samples:
    """The samples of a motion: (samples,) for a test of one axis, else (samples, axes).

    Those of a test of several axes are the axes that play, in the order of the plan.
    """

    reference: FloatArray
    """References played, in the axes' units."""

    response: FloatArray
    """Outputs measured at the start of each sample, in the axes' units."""

    details: FlightDetails | None = None
    """Other signals of a flight; None for a motion that has none."""

    columns: tuple[int, ...] | None = None
    """Indices of the axes that a test moves; None for a flight."""

    timing: Timing | None = None
    """Times of a test's samples, for a robot that records them."""

    states: FloatArray | None = None
    """All states of the axes that a test moves, shape (samples, axes, states), NaN where they were
    not observed; None for a flight, and for a robot that measures its output alone."""


@dataclass(frozen=True, eq=False)
class Played:
    """A motion that has ended, with the samples played and measured until then."""

    outcome: Outcome
    """How the motion ended."""

    reason: str
    """Why it ended so; empty for a completed motion."""

    samples: Samples
    """Samples played and measured."""

    fault: str | None = None
    """Why the robot cannot be trusted with another motion; None when it can."""


class Performance(Protocol):
    """Moves the robot, and keeps the samples measured even if it raises."""

    def play(self) -> tuple[Outcome, str]:
        """Play the motion and return its outcome and reason; may raise RobotError or Halted."""

    def measured(self) -> Samples:
        """Return the samples measured until now."""


def perform(
    robot: Robot, performance: Performance, switch: HaltSwitch, *, on_resting: Callable[[], None]
) -> Played:
    """Perform a motion on this thread, from rest to rest; see `performed`."""
    return make(performed(robot, performance, switch, on_resting=on_resting))


def performed(
    robot: Robot, performance: Performance, switch: HaltSwitch, *, on_resting: Callable[[], None]
) -> Steps[Played]:
    """Perform a motion, from rest to rest.

    A robot that breaks its interface (raises anything but `RobotError`, or does not come to rest)
    yields a failed motion with a fault; no exception of the robot leaves this procedure. A robot
    that is down (`RobotDownError`) is not asked to come to rest.

    Args:
        robot: The robot, connected and at rest.
        performance: Motion to play.
        switch: Switch that ends the motion early.
        on_resting: Callback for when the last sample has been played and the robot comes to rest.

    Returns:
        The outcome of the motion and its samples.
    """
    fault: str | None = None
    down = False
    try:
        outcome, reason = yield performance.play
    except Halted:
        outcome, reason = switch.order or (Outcome.ABORTED, "halted")
    except Exception as error:  # noqa: BLE001 - a driver's mistake must not leave it moving
        outcome, reason, down, fault = _failed(error, "")
    samples = performance.measured()
    try:
        on_resting()
        if not down and samples.columns is not None:
            samples = yield partial(_recorded, robot, samples)
    except Exception as error:  # noqa: BLE001 - as above
        outcome, reason, down, also = _failed(error, reason)
        fault = also or fault
    if not down:
        try:
            yield robot.rest
        except Exception as error:  # noqa: BLE001 - as above
            words = str(error) if isinstance(error, RobotError) else repr(error)
            _log.error("a robot could not come to rest", exc_info=error)
            outcome, fault = Outcome.FAILED, _joined(reason, f"could not come to rest: {words}")
            reason = fault
    return Played(outcome, reason, samples, fault)


def _failed(error: Exception, reason: str) -> tuple[Outcome, str, bool, str | None]:
    """Return what an error makes of a motion: outcome, reason, whether it is down, and its fault.

    Args:
        error: Error that the robot raised.
        reason: Why the motion had ended before; empty if it had not.
    """
    if isinstance(error, RobotError):
        reason = _joined(reason, str(error))
        down = isinstance(error, RobotDownError)
        broken = down or isinstance(error, OutsideLimitsError)
        return Outcome.FAILED, reason, down, reason if broken else None
    _log.error("a motion ended unexpectedly", exc_info=error)
    reason = _joined(reason, f"an unexpected error: {error!r}")
    return Outcome.FAILED, reason, False, reason


def _joined(reason: str, more: str) -> str:
    return f"{reason}; {more}" if reason else more


def _recorded(robot: Robot, samples: Samples) -> Samples:
    """Return a test's samples with the outputs that the robot recorded, if it records them."""
    record = robot.record()
    if record is None:
        return samples
    outputs, timing = outputs_at_samples(record, len(samples.reference), robot.spec)
    played = outputs[:, samples.columns].reshape(samples.reference.shape)
    return replace(samples, response=played, timing=timing)


class AxisMotion:
    """A motion that follows references known ahead on some axes; the other axes hold zero."""

    def __init__(
        self,
        robot: Robot,
        axes: Sequence[str],
        reference: FloatArray,
        *,
        realtime: float | None,
        switch: HaltSwitch,
        on_samples: OnSamples,
        watched: Callable[[], bool] = lambda: True,
    ) -> None:
        """Prepare the motion.

        Args:
            robot: The robot, connected and at rest.
            axes: Names of the axes that follow the reference.
            reference: Reference in the axes' units, shape (samples,) for one axis, else
                (samples, axes).
            realtime: Multiple of real time at which a simulated robot is paced; None lets it play
                as fast as it can. A real robot paces itself, one sample at a time.
            switch: Switch that ends the motion early.
            on_samples: Callback that receives each batch: the index of its first sample, and its
                references and outputs, both shaped like the reference.
            watched: Function that returns whether a program watches them; if none does, a paced
                simulation may play more of them at once.
        """
        self._robot, self._reference = robot, reference
        names = [known.name for known in robot.spec.axes]
        self._columns = tuple(names.index(axis) for axis in axes)
        self._switch, self._on_samples = switch, on_samples
        self._pace = Pace(robot.spec, realtime, switch, watched)
        self._response = np.empty_like(reference)
        states = len(robot.state_names)
        shape = (len(reference), len(axes), states)
        self._states = np.full(shape, np.nan) if states > 1 else None
        self._done = 0

    def measured(self) -> Samples:
        """Return the samples measured until now; both arrays are shaped like the reference."""
        done = slice(0, self._done)
        states = None if self._states is None else self._states[done].copy()
        return Samples(
            self._reference[done].copy(),
            self._response[done].copy(),
            columns=self._columns,
            states=states,
        )

    def play(self) -> tuple[Outcome, str]:
        """Play the reference to its end, or until the switch is thrown."""
        columns = self._columns
        if self._switch.order is not None:
            return self._switch.order
        whole = np.zeros((len(self._reference), len(self._robot.spec.axes)))
        whole[:, columns] = self._reference.reshape(len(whole), len(columns))
        _, monitor = begun(self._robot, whole, flight=False)
        for batch in self._pace.batches(len(self._reference)):
            if self._switch.order is not None:
                return self._switch.order
            start, stop = batch.start, batch.stop
            references = whole[batch]
            measured = self._played(references, start)
            failure = monitor.check(references, measured)
            good = stop - start if failure is None else failure.good
            played = measured[:good, columns]
            self._response[start : start + good] = played.reshape(good, *self._response.shape[1:])
            self._done = start + good
            self._on_samples(
                start, self._reference[start : self._done], self._response[start : self._done]
            )
            if failure is not None:
                raise failure.error
        return Outcome.COMPLETED, ""

    def _played(self, references: FloatArray, start: int) -> FloatArray:
        """Play one batch, whose first sample is `start`; return the outputs, (samples, axes)."""
        every = range(start, start + len(references))
        observed = [k for k in every if k % OBSERVE_SAMPLES < OBSERVE_RUN]
        if self._states is None or not observed:
            return play(self._robot, references)
        outputs, states = play_observed(self._robot, references, [k - start for k in observed])
        self._states[observed] = states[:, self._columns, :]
        return outputs
