"""Estimates a robot's outputs at its samples from measurements that were taken at other times."""

from __future__ import annotations

import numpy as np

from nufleet.robot_agent.motion.monitor import LOST_MAX_S
from nufleet.robot_agent.robot import Record
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.frequency_test.timing import Timing
from nufleet.shared.robots.spec import RobotSpec


def outputs_at_samples(
    record: Record, samples: int, spec: RobotSpec
) -> tuple[FloatArray, Timing | None]:
    """Return the outputs at the moments when the references were sent.

    These moments are irregular on a busy machine. Where they shift slowly, the reference and the
    estimate shift alike, and the response is unbiased; where they jump, the outputs scatter.

    Args:
        record: Measurements of the motion.
        samples: Number of samples played, from the motion's first.
        spec: Description of the robot.

    Returns:
        The outputs, shape (samples, axes), and the timing; None for fewer than two samples.

    Raises:
        RobotError: The record does not describe the motion, its times do not increase, or nothing
            was measured for too long.
    """
    sent_s, measured_s, outputs = record.sample_s[:samples], record.measured_s, record.outputs
    if len(sent_s) < samples:
        raise RobotError(
            f"the driver's record holds the times of {len(sent_s)} samples, and {samples} were "
            "played: `record` has to cover all calls of `step` since the robot rested"
        )
    if outputs.shape != (len(measured_s), len(spec.axes)):
        raise RobotError(
            f"the driver's record has {len(measured_s)} time stamps and outputs of shape "
            f"{outputs.shape}, for a robot of {len(spec.axes)} axes"
        )
    for times_s, what in ((sent_s, "the references"), (measured_s, "the measurements")):
        _check_times(times_s, what)
    if not np.isfinite(outputs).all():
        raise RobotError("the driver's record holds an output that is not finite")
    if samples < 2:
        return outputs[:samples].copy(), None
    # Before the first measurement and after the last one the robot rests, or nearly so.
    reached_s = np.clip(measured_s, sent_s[0], sent_s[-1])
    gaps_s = np.diff(np.concatenate([sent_s[:1], reached_s, sent_s[-1:]]))
    worst = int(np.argmax(gaps_s))
    if not len(measured_s) or gaps_s[worst] > LOST_MAX_S + spec.sample_time_s:
        at_s = float(np.concatenate([sent_s[:1], reached_s])[worst] - sent_s[0])
        raise RobotError(
            f"nothing was measured for {gaps_s[worst]:.2f} s, from {at_s:.2f} s of the motion on: "
            "check the link to the robot, or its motion capture"
        )
    return _interpolated(measured_s, outputs, sent_s), _timing(record, sent_s, gaps_s, spec)


def _check_times(times_s: FloatArray, what: str) -> None:
    if not np.isfinite(times_s).all():
        raise RobotError(f"a time of {what} in the driver's record is not finite")
    steps_s = np.diff(times_s)
    if len(steps_s) and steps_s.min() <= 0:
        at = int(np.argmin(steps_s))
        raise RobotError(
            f"the time stamps of {what} go back by {-steps_s[at]:.3g} s after number {at} of "
            f"{len(times_s)}: the clock was set, or two devices share an address"
        )


def _interpolated(measured_s: FloatArray, outputs: FloatArray, sent_s: FloatArray) -> FloatArray:
    from scipy.interpolate import CubicSpline

    within_s = np.clip(sent_s, measured_s[0], measured_s[-1])
    if len(measured_s) < 4:
        columns = [np.interp(within_s, measured_s, column) for column in outputs.T]
        return np.stack(columns, axis=1)
    # A straight line between measurements would lower the gain by (ω Δt)² / 12.
    spline: FloatArray = CubicSpline(measured_s, outputs, axis=0, bc_type="natural")(within_s)
    return spline


def _timing(record: Record, sent_s: FloatArray, gaps_s: FloatArray, spec: RobotSpec) -> Timing:
    measured_s = record.measured_s
    period_s, start_s = np.polyfit(np.arange(len(sent_s)), sent_s - sent_s[0], 1)
    regular_s = start_s + period_s * np.arange(len(sent_s))
    after = np.clip(np.searchsorted(measured_s, sent_s), 1, max(1, len(measured_s) - 1))
    nearest_s = np.minimum(
        np.abs(sent_s - measured_s[after - 1]),
        np.abs(sent_s - measured_s[np.minimum(after, len(measured_s) - 1)]),
    )
    return Timing(
        period_s=float(period_s),
        jitter_std_s=float(np.std(sent_s - sent_s[0] - regular_s)),
        gap_max_s=float(gaps_s.max()),
        unmeasured=float(np.mean(nearest_s > spec.sample_time_s)),
        clock_std_s=record.clock_std_s,
    )
