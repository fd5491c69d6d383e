"""Whether what a robot measures can be the answer to its references; pure, without a clock.

Made for robots of every kind, so it asks little: nothing that a noisy, slow, lightly damped or
badly tuned robot does ends its motion, nor do single spikes or samples that are lost.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

REST_DEVIATIONS = 4.0
"""At rest the mean may be off by so many standard deviations of the noise, which keeps a loop
that is closed over it wandering, besides `rest_error_max`."""

FROZEN_SHARE = 0.1
"""A sensor is frozen when its axis's reference has moved by this share of its whole range, and a
settling time later the output is still bit for bit the same."""

FROZEN_SAMPLES_MIN = 10
"""Fewer identical samples are a matter of resolution or of samples that were lost."""

SPEED_RATIO = 12.0
FLIGHT_SPEED_RATIO = 5.0
"""From one sample to the next an output moves at most so many times as fast as its reference may:
a frequency test may meet a resonance (damping ratio 0.05: 10 times), a flight should not."""

NOISE_DEVIATIONS = 20.0
"""And by so many standard deviations of the noise at rest besides: in flight there is more."""

BAD_SAMPLES = 5.0
GOOD_SAMPLE = 0.2
"""A motion ends with the fifth bad sample in a row; each good one makes up for a fifth of a bad
one, so that up to every sixth sample may be a spike."""

LOST_MAX_S = 0.5
"""Samples may be lost for so long; the output may have gone on meanwhile."""

FOLLOWED_RANGE = 2.0
FOLLOWED_SHARE = 0.5
"""In a flight the output stays among the references of the last settling time, up to so many times
their range to either side, and half of the furthest one for a loop whose gain is not one."""


@dataclass(frozen=True, eq=False)
class Failure:
    """Why a motion has to end, and how many samples of those given were good."""

    good: int
    reason: str


def rest_error_max(spec: RobotSpec, axis: AxisSpec) -> float:
    """Return how far from its first reference an axis may rest, noise apart, in its unit.

    As far as it may go in one sample, or the amplitude that its limits allow at the upper edge of
    its band if that is more: a reference that jumps by as much asks of the robot no more
    acceleration than a test may. At 1 kHz no robot rests within one sample of its origin.
    """
    omega = spec.omega_max_rad_s
    amplitude = min(axis.amplitude_max, axis.velocity_max / omega, axis.acceleration_max / omega**2)
    return max(axis.velocity_max * spec.sample_time_s, amplitude)


def rest_measurements(spec: RobotSpec) -> int:
    """Return how often to measure before a motion: half a second, three to eight times."""
    return min(8, max(3, round(0.5 / spec.sample_time_s)))


def rest_failure(spec: RobotSpec, measured: FloatArray, first: FloatArray) -> str | None:
    """Return why a robot may not begin where it rests; None when it may.

    Args:
        spec: of the robot.
        measured: its output at rest, shape (measurements, axes).
        first: the first reference, shape (axes,).
    """
    if not np.isfinite(measured).all():
        return "the sensor returned a number that is not finite before the motion began"
    noise = measured.std(axis=0, ddof=1)
    away = np.abs(measured.mean(axis=0) - first)
    for i, axis in enumerate(spec.axes):
        most = rest_error_max(spec, axis) + REST_DEVIATIONS * float(noise[i])
        if away[i] > most:
            return (
                f"it was not begun: axis {axis.name} rests at {measured[:, i].mean():.3g} "
                f"{axis.unit}, at most {most:.3g} {axis.unit} from its first reference, "
                f"{first[i]:.3g} {axis.unit}, are allowed, and the reference would jump; a robot "
                "has to rest at reference 0: bring it back there (its driver's `rest` should), "
                "then ask again"
            )
    return None


class Monitor:
    """Watches one motion, sample by sample or many at once with the same verdict."""

    def __init__(
        self, spec: RobotSpec, measured: FloatArray, span: FloatArray, *, flight: bool
    ) -> None:
        """Begin at rest.

        Args:
            spec: of the robot.
            measured: its output at rest, shape (measurements, axes).
            span: how far the references of the motion range, shape (axes,).
            flight: whether the output should stay among the references, as in every motion but a
                frequency test, which asks for just that.
        """
        noise = measured.std(axis=0, ddof=1).tolist()
        rests_at = measured.mean(axis=0).tolist()
        self._axes = [
            _AxisMonitor(spec, axis, noise[i], rests_at[i], float(span[i]), flight=flight)
            for i, axis in enumerate(spec.axes)
        ]
        self._samples = 0

    def check(self, references: FloatArray, outputs: FloatArray) -> Failure | None:
        """Take the next samples, both (samples, axes); return why the motion has to end.

        Nothing is to be checked any more after a failure.
        """
        finite = np.isfinite(outputs).all(axis=1)
        good = len(outputs) if finite.all() else int(np.argmin(finite))
        failures = [
            axis.check(references[:good, i], outputs[:good, i]) for i, axis in enumerate(self._axes)
        ]
        if good < len(outputs):
            at = self._samples + good
            reason = f"the sensor returned a number that is not finite at sample {at}"
            failures.append(Failure(good, reason))
        self._samples += good
        found = [failure for failure in failures if failure is not None]
        return min(found, key=lambda failure: failure.good, default=None)


class _AxisMonitor:
    """Watches one axis; in plain numbers, since a real robot has one sample at a time."""

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
        # Of the samples that are identical to the latest: the reference at the first of them, and
        # how far it had moved since at each of the latest; those are a settling time at most.
        self._last, self._origin, self._run = math.nan, 0.0, 0
        self._shifts: deque[float] = deque()
        self._still = FROZEN_SHARE * span if span > 0 else math.inf
        # References of the last settling time that can be the least or the largest of them, each
        # with its sample; before the motion there was rest.
        self._lowest: deque[tuple[int, float]] = deque([(0, 0.0)])
        self._highest: deque[tuple[int, float]] = deque([(0, 0.0)])
        self._sample = 0
        self._offset = rest_error_max(spec, axis) + axis.amplitude_max / 4
        self._offset += NOISE_DEVIATIONS / 2 * noise
        self._furthest = 0.0

    def check(self, references: FloatArray, outputs: FloatArray) -> Failure | None:
        """Take the next samples, both (samples,) and finite."""
        if not self._flight and self._plain(references, outputs):
            return None
        pairs = zip(references.tolist(), outputs.tolist(), strict=True)
        for k, (reference, output) in enumerate(pairs):
            reason = self._frozen(reference, output) or self._implausible(reference, output)
            if reason is not None:
                return Failure(k, reason)
        return None

    def _plain(self, references: FloatArray, outputs: FloatArray) -> bool:
        """Take many samples of a frequency test at once, if there is nothing about them."""
        if len(outputs) < 2 or self._since:
            return False
        steps = np.abs(np.diff(outputs, prepend=self._good))
        if not (steps <= self._leap).all() or not steps.all():
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
        # What is off stays so however long it lasts, unless it moved there within the limits.
        leapt = abs(output - good) > self._leap + self._since * self._moved
        far = self._flight and self._far(reference, output)
        self._bad = self._bad + 1.0 if leapt or far else max(0.0, self._bad - GOOD_SAMPLE)
        # A sample that only repeats the one before may have been lost.
        if leapt or output == good:
            self._since = min(self._since + 1, self._lost_max)
        else:
            self._good, self._since = output, 0
        if self._bad < BAD_SAMPLES:
            return None
        name, unit = self._axis.name, self._axis.unit
        if leapt:
            return (
                f"the output of axis {name} leaps from {good:.4g} to {output:.4g} {unit} faster "
                "than the robot can move: spikes, noise, or a sensor that lost its place"
            )
        return (
            f"the output of axis {name}, {output:.4g} {unit}, does not follow its reference: it is "
            "far from all that was asked within the last settling time"
        )

    def _far(self, reference: float, output: float) -> bool:
        """Return whether an output is far from all references of the last settling time."""
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
