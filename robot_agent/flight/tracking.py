"""The control loop that makes a robot follow a path.

The robot flies with its baseline controller alone, or with an inverse model in front of it that
adjusts the reference (paper, Fig. 2: the block diagram of the inverse learning approach).
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from nufleet.robot_agent.flight.guard import Guard
from nufleet.robot_agent.flight.mixture_process import MixtureProcess
from nufleet.robot_agent.flight.online_gp import Correction, OnlineGp
from nufleet.robot_agent.flight.output_feedback import FeedbackLoop, OutputFeedback
from nufleet.robot_agent.flight.tracking_record import STOPPED, TrackingRecord
from nufleet.robot_agent.motion.paced_robot import Halted
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError, RobotError
from nufleet.shared.experience.combined_layout import CombinedLayout
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.paths.references import approach
from nufleet.shared.paths.trajectories import check_trajectory
from nufleet.shared.robots.spec import TrackingLimits

PAIR_SPACING_S = 0.12
"""Time between the pairs that the online process learns from.

A window of fifty pairs then covers six seconds of path and shows the dynamics in several states.
Fifty neighbouring samples would all say the same, and a process fitted to those produces steep
feedback across the path."""


class Watch(Protocol):
    """Callback that receives every sample as it is played, for a live view."""

    def __call__(
        self,
        sample: int,
        desired: FloatArray,
        actual: FloatArray,
        correction: Correction | None,
        share: float,
    ) -> None:
        """Take one sample; must return quickly, since it is called in the control loop.

        Args:
            sample: Index of the sample, from 0.
            desired: Path at that sample, shape (axes,), in the axes' units.
            actual: Output measured at that sample, shape (axes,), in the axes' units.
            correction: Output of the inverse model; None for the baseline alone.
            share: Share of the correction that may act, from 0 to 1.
        """


@dataclass(frozen=True)
class Learner:
    """An inverse model in front of the robot."""

    layout: InverseLayout | CombinedLayout
    """Inputs and output of the inverse model."""

    process: OnlineGp | MixtureProcess
    """Online process on top of the prior or of a mixture of priors, new for each flight."""

    pair_spacing_s: float = PAIR_SPACING_S
    """Time between the pairs that the process learns from, in seconds."""


@dataclass(frozen=True, eq=False)
class Ahead:
    """Corrections of the path that are known before the flight."""

    correction: FloatArray
    """Correction of the reference, shape (samples, axes), in the axes' units."""

    feedback: OutputFeedback | None = None
    """Feedback of the measured output, which adds to them; None where they are all there is."""


def track(
    robot: Robot,
    desired: FloatArray,
    limits: TrackingLimits,
    learner: Learner | Ahead | None = None,
    guard: Guard | None = None,
    *,
    fallback: Ahead | None = None,
    watch: Watch | None = None,
    stopped: Callable[[], bool] = lambda: False,
) -> TrackingRecord:
    """Fly a path, from rest to rest.

    The robot first goes to the path's start and settles there with its baseline alone. It ends at
    rest at its origin unless it failed. Corrections of the path are limited to `correction_max` and
    `correction_speed_max`; the record marks the samples where a limit acted.

    Args:
        robot: The robot, connected and at rest.
        desired: Path, shape (samples, axes), in the axes' units.
        limits: Tracking limits of the robot; the path is checked against them before it moves.
        learner: Inverse model in front of the robot, or corrections known ahead; None for the
            baseline alone.
        guard: Guard that limits the learner's share; None lets the whole correction act.
        fallback: Corrections that act in place of the learner's once the guard withdraws those;
            None for the baseline alone.
        watch: Callback that receives every sample.
        stopped: Function called before every sample; the flight ends when it returns True.

    Returns:
        The record of the samples played, also of a flight that failed on the path.

    Raises:
        InvalidInputError: The path breaks a limit or has another number of axes, the robot lacks a
            state that the learner needs, or a guard was given without a learner.
        RobotError: The robot failed before the path began.
    """
    spec = robot.spec
    if desired.ndim != 2 or desired.shape[1] != len(spec.axes):
        raise InvalidInputError(
            f"the trajectory must have one column for each of {len(spec.axes)} axes, "
            f"got shape {desired.shape}"
        )
    check_trajectory(desired, spec.sample_time_s, limits)
    if isinstance(learner, Learner):
        needed = learner.layout.measured_states
        if robot.state_names[: len(needed)] != needed:
            raise InvalidInputError(
                f"the inverse needs the states {', '.join(needed)}; the robot measures "
                f"{', '.join(robot.state_names) or 'none'}"
            )
    elif learner is None and guard is not None:
        raise InvalidInputError("a guard monitors a learner; the baseline does not need one")
    robot.run(approach(robot.spec, desired, limits))
    flight = _Flight(robot, desired, limits, learner, guard, fallback, watch)
    failure: str | None = None
    try:
        failure = flight.fly(stopped)
        robot.rest()
    except RobotError as error:
        failure = str(error)
    return flight.record(failure)


class _Flight:
    """The state of one flight.

    Rows of `_reference` and `_states` are shifted by `_span` samples at rest before the path, so
    that the first training pair and query need no special case.
    """

    def __init__(
        self,
        robot: Robot,
        desired: FloatArray,
        limits: TrackingLimits,
        learner: Learner | Ahead | None,
        guard: Guard | None,
        fallback: Ahead | None,
        watch: Watch | None,
    ) -> None:
        self._robot, self._desired, self._limits = robot, desired, limits
        self._learner, self._guard, self._watch = learner, guard, watch
        samples, axes = desired.shape
        self._fallback = np.zeros_like(desired) if fallback is None else fallback.correction
        self._back = self._ahead = 0
        self._span = 1
        self._learn_every = 1
        # The output of a robot without states is known only once it has been sent a reference.
        self._late = 0 if robot.state_names else 1
        states, experts = 1, 0
        if isinstance(learner, Learner):
            layout = learner.layout
            self._back, self._ahead = layout.back_samples, layout.horizon_samples
            self._span = layout.span_samples
            states, experts = len(layout.states), len(learner.process.weights)
            spacing = round(learner.pair_spacing_s / robot.spec.sample_time_s)
            self._learn_every = max(1, spacing)
        self._path = np.pad(desired, ((self._back, self._ahead + 1), (0, 0)), mode="edge")
        self._velocity = np.gradient(self._path, robot.spec.sample_time_s, axis=0)
        # Before the first sample of the path, the robot rested at the path's start.
        self._reference = np.concatenate(
            [np.tile(desired[0], (self._span, 1)), np.zeros((samples, axes))]
        )
        rest = np.zeros((self._span, axes, states))
        rest[:, :, 0] = desired[0]
        self._states = np.concatenate([rest, np.zeros((samples, axes, states))])
        self._prior, self._mean = np.zeros((samples, axes)), np.zeros((samples, axes))
        self._variance, self._actual = np.zeros((samples, axes)), np.zeros((samples, axes))
        self._share, self._step_time_s = np.ones(samples), np.zeros(samples)
        self._limited = np.zeros(samples, dtype=bool)
        self._weights = np.zeros((samples, experts))
        self._loop: FeedbackLoop | None = None
        # Corrections known ahead have no fallback: the robot's model of itself flies only once.
        known = learner if isinstance(learner, Ahead) else fallback
        if known is not None and known.feedback is not None:
            self._loop = FeedbackLoop(known.feedback, desired[0], samples)
        self._fed = np.zeros((samples, axes))
        self._fading: FloatArray | None = None
        self._done = 0

    def fly(self, stopped: Callable[[], bool]) -> str | None:
        for k, wanted in enumerate(self._desired):
            if stopped():
                return STOPPED
            observed = self._observed(k) if self._learner is not None else None
            begin_s = time.perf_counter()
            correction, reference = None, wanted
            if observed is not None and not np.isfinite(observed).all():
                return f"the sensor returned a value that is not finite at sample {k}"
            if self._learner is not None and observed is not None:
                correction, reference = self._corrected(self._learner, k, observed)
            self._reference[self._span + k] = reference
            self._step_time_s[k] = time.perf_counter() - begin_s
            if not np.isfinite(reference).all():
                return f"the inverse model asked for a value that is not finite at sample {k}"
            try:
                self._actual[k] = self._robot.step(reference)
            except Halted:
                return STOPPED
            if not np.isfinite(self._actual[k]).all():
                return f"the sensor returned a value that is not finite at sample {k}"
            self._done = k + 1
            if self._watch is not None:
                self._watch(k, wanted, self._actual[k], correction, float(self._share[k]))
        return None

    def _corrected(
        self, learner: Learner | Ahead, k: int, observed: FloatArray
    ) -> tuple[Correction, FloatArray]:
        """Return the correction of a sample, as far as the guard lets it act, and the reference."""
        if self._guard is not None:
            sent = self._reference[self._span + k - 1] - self._desired[max(0, k - 1)]
            error = observed[:, 0] - self._desired[max(0, k - self._late)]
            self._share[k] = self._guard.judge(k, error, sent)
        if self._loop is not None and k > 0:
            previous = self._reference[self._span + k - 1]
            self._fed[k] = self._loop.correction(k, previous, self._actual[k - 1])
        if isinstance(learner, Learner):
            return self._choose(learner, k, observed)
        return self._played(learner, k)

    def _observed(self, k: int) -> FloatArray:
        """Return the latest states, shape (axes, states): those of sample k, or the output before.

        The robot rested at the path's start before its first sample.
        """
        if not self._late:
            return self._robot.observe()
        return np.asarray((self._actual[k - 1] if k else self._desired[0])[:, np.newaxis])

    def _choose(
        self, learner: Learner, k: int, observed: FloatArray
    ) -> tuple[Correction, FloatArray]:
        layout, process, row = learner.layout, learner.process, self._span + k
        known = row - self._late
        self._states[known] = observed[:, : self._states.shape[2]]
        window = slice(known + 1 - self._span, known + 1)
        if k > 0 and k % self._learn_every == 0:
            for axis in range(observed.shape[0]):
                inputs, gamma = layout.pairs(
                    self._reference[window, axis], self._states[window, axis]
                )
                process.learn(axis, inputs[-1], float(gamma[-1]))
        path = self._path[k : k + self._back + self._ahead + 1]
        previous = self._reference[row - 1]
        query = layout.query(
            self._states[known], previous, path, self._velocity[k + self._back + self._ahead]
        )
        correction = process.correct(query)
        self._prior[k], self._mean[k] = correction.prior, correction.mean
        self._variance[k], self._weights[k] = correction.variance, correction.weights
        wished = layout.reference(correction.gamma, previous, path)
        return correction, self._bounded(k, wished, previous)

    def _played(self, ahead: Ahead, k: int) -> tuple[Correction, FloatArray]:
        """Return the correction of a sample and the reference with it.

        Its speed has a part that was known ahead and one that is fed back.
        """
        step_s, previous = self._robot.spec.sample_time_s, self._reference[self._span + k - 1]
        now, before = ahead.correction[k], ahead.correction[max(0, k - 1)]
        fed, fed_before = self._fed[k], self._fed[max(0, k - 1)]
        self._prior[k], self._mean[k] = (now - before) / step_s, (fed - fed_before) / step_s
        reference = self._bounded(k, self._desired[k] + now + fed, previous)
        return Correction(self._prior[k], self._mean[k], np.zeros_like(now), ()), reference

    def _bounded(self, k: int, wished: FloatArray, previous: FloatArray) -> FloatArray:
        """Return the reference that may be sent, shape (axes,).

        It is the path plus the correction: clipped to `correction_max`, multiplied by the guard's
        share, and limited to a change of `correction_speed_max` per second from the last one.
        """
        wanted, limits = self._desired[k], self._limits
        before = previous - self._desired[max(0, k - 1)]
        step = limits.correction_speed_max * self._robot.spec.sample_time_s
        near = np.clip(wished - wanted, -limits.correction_max, limits.correction_max)
        if self._share[k] < 1.0 and self._fading is None:
            self._fading = before
        # Once the prior is withdrawn, the last applied correction fades out; the model's later
        # output is ignored.
        shared = self._share[k] * (near if self._fading is None else self._fading)
        if self._guard is not None:
            own = np.clip(
                self._fallback[k] + self._fed[k], -limits.correction_max, limits.correction_max
            )
            shared = shared + self._guard.fallback_share(k) * own
        held = np.clip(shared, before - step, before + step)
        self._limited[k] = bool((near != wished - wanted).any() or (held != shared).any())
        return np.asarray(wanted + held)

    def record(self, failure: str | None) -> TrackingRecord:
        done = slice(0, self._done)
        learner, guard = self._learner, self._guard
        return TrackingRecord(
            sample_time_s=self._robot.spec.sample_time_s,
            desired=self._desired[done],
            reference=self._reference[self._span :][done],
            actual=self._actual[done],
            prior=self._prior[done],
            mean=self._mean[done],
            variance=self._variance[done],
            weights=self._weights[done],
            share=self._share[done],
            limited=self._limited[done],
            step_time_s=self._step_time_s[done],
            dropped_pairs=learner.process.dropped if isinstance(learner, Learner) else 0,
            taken_back=guard.event if guard is not None else None,
            failure=failure,
        )
