"""Decides whether a robot's measured outputs can be the answer to its references.

Pure functions of the samples, without a clock. The checks are lenient because they serve robots of
every kind: a noisy, slow, lightly damped or badly tuned robot may finish its motion, and so may one
with single spikes or lost samples.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from nufleet.robot_agent.motion.lag_watch import LagWatch
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import OutsideLimitsError, RobotError
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

REST_DEVIATIONS = 4.0
"""Standard deviations of the noise by which the mean at rest may be off, on top of
`rest_error_max`: a loop closed over a noisy sensor wanders even at rest."""

FROZEN_SHARE = 0.1
"""Share of the motion's range by which a reference must have moved before a sensor counts as
frozen, that is, before an output still identical bit for bit one settling time later is a fault."""

FROZEN_SAMPLES_MIN = 10
"""Fewest identical samples that count as frozen; shorter runs can come from the sensor's
resolution or from lost samples."""

SPEED_RATIO = 12.0
FLIGHT_SPEED_RATIO = 5.0
"""Largest plausible speed of an output between two samples, as a multiple of the speed allowed to
its reference. A frequency test may excite a resonance, which amplifies by 1/(2ζ) (10 times at
damping ratio ζ = 0.05); a flight should not."""

NOISE_DEVIATIONS = 20.0
"""Standard deviations of the noise at rest by which an output may move between two samples, on top
of `SPEED_RATIO` or `FLIGHT_SPEED_RATIO`; generous because a moving robot's sensor is noisier."""

BAD_SAMPLES = 5.0
GOOD_SAMPLE = 0.2
"""A motion ends at the fifth bad sample in a row. Each good sample cancels a fifth of a bad one, so
that up to every sixth sample may be a spike."""

LOST_MAX_S = 0.5
"""How long samples may be lost; the output may have kept moving during that time."""

FOLLOWED_RANGE = 2.0
FOLLOWED_SHARE = 0.5
"""Margins on how far an output in flight may lie outside the references of the last settling time:
on either side `FOLLOWED_RANGE` times the range of those references, plus `FOLLOWED_SHARE` times the
largest reference of the motion, for a loop whose gain is not one."""


@dataclass(frozen=True, eq=False)
class Failure:
    """The finding that ends a motion."""

    good: int
    """Number of samples before the failing one, among those passed to the check."""

    reason: str
    """What is wrong, for a person to read."""

    outside: bool = False
    """Whether the robot left the limits of its measured output."""

    @property
    def error(self) -> RobotError:
        """The error that ends the motion."""
        return OutsideLimitsError(self.reason) if self.outside else RobotError(self.reason)


def rest_error_max(spec: RobotSpec, axis: AxisSpec) -> float:
    """Return how far from its first reference an axis may rest, not counting noise.

    With the limits A on amplitude, v on velocity and a on acceleration, the sample time T and the
    upper band edge ω, this is max(v T, min(A, v/ω, a/ω²)): the distance covered in one sample or,
    where that is larger, the amplitude that the limits allow at ω. A reference that jumps by this
    much demands no more acceleration than a test may. The distance of one sample alone would be too
    strict: at 1 kHz no robot rests that close to its origin.

    Args:
        spec: Description of the robot.
        axis: The axis that rests.

    Returns:
        The largest distance, in the axis's unit.
    """
    omega = spec.omega_max_rad_s
    amplitude = min(axis.amplitude_max, axis.velocity_max / omega, axis.acceleration_max / omega**2)
    return max(axis.velocity_max * spec.sample_time_s, amplitude)


def rest_measurements(spec: RobotSpec) -> int:
    """Return the number of measurements before a motion: half a second's, but three to eight."""
    return min(8, max(3, round(0.5 / spec.sample_time_s)))


def rest_failure(spec: RobotSpec, measured: FloatArray, first: FloatArray) -> str | None:
    """Return why a robot may not begin a motion where it rests.

    Args:
        spec: Description of the robot.
        measured: Outputs measured at rest, shape (measurements, axes), in the axes' units.
        first: First reference of the motion, shape (axes,), in the axes' units.

    Returns:
        The reason for a person to read; None when the motion may begin.
    """
    if not np.isfinite(measured).all():
        return "the sensor returned a value that is not finite before the motion began"
    noise = measured.std(axis=0, ddof=1)
    away = np.abs(measured.mean(axis=0) - first)
    for i, axis in enumerate(spec.axes):
        most = rest_error_max(spec, axis) + REST_DEVIATIONS * float(noise[i])
        if away[i] > most:
            return (
                f"the motion did not start: axis {axis.name} rests at {measured[:, i].mean():.3g} "
                f"{axis.unit}; at most {most:.3g} {axis.unit} from its first reference, "
                f"{first[i]:.3g} {axis.unit}, are allowed, since the reference would jump; a robot "
                "has to rest at reference 0: bring it back there (the `rest` method of its driver "
                "should), then request the motion again"
            )
    return None


class Monitor:
    """Watches one motion; checking samples singly or in batches gives the same verdict."""

    def __init__(
        self, spec: RobotSpec, measured: FloatArray, span: FloatArray, *, flight: bool
    ) -> None:
        """Begin at rest.

        Args:
            spec: Description of the robot.
            measured: Outputs measured at rest, shape (measurements, axes), in the axes' units.
            span: Largest minus smallest reference of the motion, shape (axes,), in the axes' units.
            flight: Whether the output should stay close to the references. True for every motion
                but a frequency test, which may drive the robot into a resonance on purpose.
        """
        noise = measured.std(axis=0, ddof=1).tolist()
        rests_at = measured.mean(axis=0).tolist()
        self._axes = [
            _AxisMonitor(spec, axis, noise[i], rests_at[i], float(span[i]), flight=flight)
            for i, axis in enumerate(spec.axes)
        ]
        self._samples = 0

    def check(self, references: FloatArray, outputs: FloatArray) -> Failure | None:
        """Check the next samples of the motion; not to be called again after a failure.

        Args:
            references: References played, shape (samples, axes), in the axes' units.
            outputs: Outputs measured at the start of each sample, shape (samples, axes).

        Returns:
            The earliest failure among the axes; None when the motion may continue.
        """
        finite = np.isfinite(outputs).all(axis=1)
        good = len(outputs) if finite.all() else int(np.argmin(finite))
        failures = [
            axis.check(references[:good, i], outputs[:good, i]) for i, axis in enumerate(self._axes)
        ]
        if good < len(outputs):
            at = self._samples + good
            reason = f"the sensor returned a value that is not finite at sample {at}"
            failures.append(Failure(good, reason))
        self._samples += good
        found = [failure for failure in failures if failure is not None]
        return min(found, key=lambda failure: failure.good, default=None)


class _AxisMonitor:
    """Watches one axis.

    It computes with Python floats rather than arrays: a real robot delivers one sample at a time,
    and arrays of one element would be slower.
    """

    def __init__(
        self,
        spec: RobotSpec,
        axis: AxisSpec,
        noise: float,
        rests_at: float,
        span: float,
        *,
        flight: bool,
    ) -> None:
        self._axis, self._flight = axis, flight
        tracking = spec.tracking
        path_speed = tracking.speed_max + tracking.correction_speed_max if tracking else 0.0
        self._moved = max(axis.velocity_max, path_speed) * spec.sample_time_s
        ratio = FLIGHT_SPEED_RATIO if flight else SPEED_RATIO
        # A robot that rests beside its first reference may come to it at once.
        self._leap = ratio * self._moved + NOISE_DEVIATIONS * noise + abs(rests_at)
        self._lost_max = math.ceil(LOST_MAX_S / spec.sample_time_s)
        self._good, self._since, self._bad = rests_at, 0, 0.0
        settling = math.ceil(spec.settling_time_s / spec.sample_time_s)
        self._past = max(FROZEN_SAMPLES_MIN, settling)
        # Run of samples identical to the latest one: `_origin` is the reference at its first
        # sample, and `_shifts` says how far the reference had moved from there at each sample of
        # the last settling time.
        self._last, self._origin, self._run = math.nan, 0.0, 0
        self._shifts: deque[float] = deque()
        self._still = FROZEN_SHARE * span if span > 0 else math.inf
        # Monotonic queues for the minimum and maximum over a sliding window: (sample, reference)
        # pairs of the last settling time that can still become the smallest or the largest one.
        # They start with 0 because the robot rested before the motion.
        self._lowest: deque[tuple[int, float]] = deque([(0, 0.0)])
        self._highest: deque[tuple[int, float]] = deque([(0, 0.0)])
        self._sample = 0
        self._lag = LagWatch(rests_at, span, self._past)
        self._offset = rest_error_max(spec, axis) + axis.amplitude_max / 4
        self._offset += NOISE_DEVIATIONS / 2 * noise
        self._furthest = 0.0
        self._low = -math.inf if axis.output_min is None else axis.output_min
        self._high = math.inf if axis.output_max is None else axis.output_max

    def check(self, references: FloatArray, outputs: FloatArray) -> Failure | None:
        """Check the next samples of this axis; both arrays have shape (samples,) and are finite."""
        if not self._flight and self._plain(references, outputs):
            return None
        pairs = zip(references.tolist(), outputs.tolist(), strict=True)
        for k, (reference, output) in enumerate(pairs):
            reason = (
                self._frozen(reference, output)
                or self._implausible(reference, output)
                or self._late(reference, output)
            )
            if reason is not None:
                return Failure(k, reason)
            if self._last_is_outside:
                return Failure(k, self._outside(output), outside=True)
        return None

    def _plain(self, references: FloatArray, outputs: FloatArray) -> bool:
        """Accept a batch of a frequency test in array operations if nothing in it is suspicious.

        Return False, with nothing taken, when the samples must be checked one by one.
        """
        if len(outputs) < 2 or self._since:
            return False
        before = np.concatenate(([self._good], outputs[:-1]))
        steps = np.abs(outputs - before)
        if not (steps <= self._leap).all() or not steps.all():
            return False
        if outputs.min() < self._low or outputs.max() > self._high:
            return False
        if not self._lag.none_in(references, outputs):
            return False
        self._good = self._last = float(outputs[-1])
        self._bad = max(0.0, self._bad - GOOD_SAMPLE * len(outputs))
        self._origin, self._run = float(references[-1]), 1
        self._shifts = deque([0.0])
        return True

    def _frozen(self, reference: float, output: float) -> str | None:
        if output != self._last:
            self._last, self._origin, self._run = output, reference, 0
            self._shifts.clear()
        self._run += 1
        self._shifts.append(abs(reference - self._origin))
        if len(self._shifts) <= self._past or self._shifts.popleft() <= self._still:
            return None
        return (
            f"the output of axis {self._axis.name} stays at exactly {output:.6g} {self._axis.unit} "
            f"for {self._run} samples while the reference moves"
        )

    def _implausible(self, reference: float, output: float) -> str | None:
        good = self._good
        # An output that is off stays bad however long it lasts, unless it moved there within the
        # limits: compared with the last good output, it may have moved by one plausible step, and
        # at the axis's speed limit for as long as samples have been bad or lost (`LOST_MAX_S`).
        leapt = abs(output - good) > self._leap + self._since * self._moved
        far = self._flight and self._far(reference, output)
        self._bad = self._bad + 1.0 if leapt or far else max(0.0, self._bad - GOOD_SAMPLE)
        # A sample that exactly repeats the one before may be a lost one.
        if leapt or output == good:
            self._since = min(self._since + 1, self._lost_max)
        else:
            self._good, self._since = output, 0
        if self._bad < BAD_SAMPLES:
            return None
        name, unit = self._axis.name, self._axis.unit
        if leapt:
            return (
                f"the output of axis {name} jumps from {good:.4g} to {output:.4g} {unit} faster "
                "than the robot can move: spikes, noise, or a sensor that lost its position"
            )
        return (
            f"the output of axis {name}, {output:.4g} {unit}, does not follow its reference: it is "
            "far from every reference of the last settling time"
        )

    def _late(self, reference: float, output: float) -> str | None:
        samples = self._lag.take(reference, output)
        if samples is None:
            return None
        return (
            f"the output of axis {self._axis.name} begins to move {samples} samples after its "
            "reference, long after the robot should have settled: its sensor lags, or its settling "
            "time is stated much too short"
        )

    @property
    def _last_is_outside(self) -> bool:
        # A single spike is no position; `_good` is the last output that the robot can have reached.
        return not self._low <= self._good <= self._high

    def _outside(self, output: float) -> str:
        axis = self._axis
        return (
            f"the output of axis {axis.name}, {output:.4g} {axis.unit}, is outside the limits of "
            f"the robot, {self._low:g} to {self._high:g} {axis.unit}"
        )

    def _far(self, reference: float, output: float) -> bool:
        """Return whether an output is far from every reference of the last settling time.

        With the least and the largest of these references, l and h, and the largest magnitude m of
        any reference until now, outputs in [l − d, h + d] are near, where
        d = `FOLLOWED_RANGE` (h − l) + `FOLLOWED_SHARE` m + offset.
        """
        self._sample += 1
        lowest, highest, oldest = self._lowest, self._highest, self._sample - self._past
        while lowest and lowest[-1][1] >= reference:
            lowest.pop()
        while highest and highest[-1][1] <= reference:
            highest.pop()
        lowest.append((self._sample, reference))
        highest.append((self._sample, reference))
        if lowest[0][0] < oldest:
            lowest.popleft()
        if highest[0][0] < oldest:
            highest.popleft()
        low, high = lowest[0][1], highest[0][1]
        self._furthest = max(self._furthest, abs(reference))
        margin = FOLLOWED_RANGE * (high - low) + FOLLOWED_SHARE * self._furthest + self._offset
        return not low - margin <= output <= high + margin
