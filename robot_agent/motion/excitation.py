"""Turns a request for a frequency test into the samples a robot plays, or refuses it."""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RefusedError
from nufleet.shared.frequency_test.duration import timing
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

HEADROOM = 0.8
"""Share of the tightest limit used when the robot chooses the amplitude itself."""


def plan_excitation(excitation: Excitation, spec: RobotSpec, robot: str) -> ExcitationPlan:
    """Choose what a request leaves open, and check the whole reference against every limit.

    The lengths of the reference's parts come from `nufleet.shared.frequency_test.duration`.

    Args:
        excitation: Frequency test requested.
        spec: Description of the robot.
        robot: Name of the robot, for the error.

    Returns:
        The plan, with every length in samples and the amplitude in the axis's unit.

    Raises:
        RefusedError: The reference would break a limit, which it is never clipped to; the code is
            `unknown-axis`, `omega-out-of-band`, `duration`, `amplitude`, `velocity` or
            `acceleration`.
    """
    axis = _axis_of(excitation, spec, robot)
    _check_band(excitation, spec, robot)
    plan = _timed(excitation, spec, robot)
    unit_reference = reference_of(plan)
    velocity, acceleration = peak_velocity_and_acceleration(unit_reference, spec.sample_time_s)
    if excitation.amplitude is None:
        limits = (
            axis.amplitude_max,
            axis.velocity_max / velocity,
            axis.acceleration_max / acceleration,
        )
        return plan.model_copy(update={"amplitude": HEADROOM * min(limits)})
    amplitude = excitation.amplitude
    _check_motion(amplitude, amplitude * velocity, amplitude * acceleration, axis, robot)
    return plan.model_copy(update={"amplitude": amplitude})


def reference_of(plan: ExcitationPlan) -> FloatArray:
    """Return the reference of a plan.

    It is A e(k) s(k) / max|s| with the amplitude A, the envelope e that ramps from 0 to 1 and back,
    and the sum of tones s(k) = Σ w_i sin(ω_i k T + φ_i), w_i relative to the largest weight. Its
    first and last samples are 0, and no sample exceeds the amplitude.

    Args:
        plan: Plan of the frequency test.

    Returns:
        The reference, shape (samples,), in the axis's unit.
    """
    times_s = np.arange(plan.samples) * plan.sample_time_s
    heaviest = max(tone.weight for tone in plan.tones)
    total = np.zeros(plan.samples)
    for tone in plan.tones:
        share = tone.weight / heaviest
        total += share * np.sin(tone.omega_rad_s * times_s + tone.phase_rad)
    shape: FloatArray = _envelope(plan) * (total / np.max(np.abs(total)))
    return plan.amplitude * shape


def peak_velocity_and_acceleration(
    reference: FloatArray, sample_time_s: float
) -> tuple[float, float]:
    """Return the largest first and second difference quotients of a reference between two rests.

    Args:
        reference: Reference of one axis, shape (samples,), in the axis's unit.
        sample_time_s: Sample time in seconds.

    Returns:
        The peak velocity in unit/s and the peak acceleration in unit/s².
    """
    # Two zeros on either side, since the robot rests at 0 before the first and after the last
    # sample and the steps from and to rest count too.
    padded = np.concatenate([[0.0, 0.0], reference, [0.0, 0.0]])
    velocity = np.diff(padded) / sample_time_s
    acceleration = np.diff(velocity) / sample_time_s
    return float(np.max(np.abs(velocity))), float(np.max(np.abs(acceleration)))


def _envelope(plan: ExcitationPlan) -> FloatArray:
    # Raised cosine (1 − cos(π k / n)) / 2: both ends have zero slope, so the ramp adds no jump in
    # velocity.
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.arange(plan.ramp_samples) / plan.ramp_samples)
    flat = np.ones(plan.samples - 2 * plan.ramp_samples)
    return np.concatenate([ramp, flat, ramp[::-1]])


def _axis_of(excitation: Excitation, spec: RobotSpec, robot: str) -> AxisSpec:
    try:
        return spec.axis(excitation.axis)
    except KeyError as error:
        raise RefusedError("unknown-axis", str(error.args[0]), robot) from error


def _check_band(excitation: Excitation, spec: RobotSpec, robot: str) -> None:
    for tone in excitation.tones:
        omega = tone.omega_rad_s
        if omega < spec.omega_min_rad_s:
            raise RefusedError(
                "omega-out-of-band",
                f"a tone of {omega:.6g} rad/s is below the band, which begins at "
                f"{spec.omega_min_rad_s:.6g} rad/s; one period of it would take "
                f"{2 * math.pi / omega:.4g} s",
                robot,
            )
        if omega > spec.omega_max_rad_s:
            raise RefusedError(
                "omega-out-of-band",
                f"a tone of {omega:.6g} rad/s is above the band, which ends at "
                f"{spec.omega_max_rad_s:.6g} rad/s",
                robot,
            )


def _timed(excitation: Excitation, spec: RobotSpec, robot: str) -> ExcitationPlan:
    """Return the plan with the lengths of all parts chosen, and amplitude 1."""
    lengths = timing(excitation, spec)
    # Compare durations before making samples: a request may ask for more than memory can hold.
    if lengths.asked_s > spec.duration_max_s:
        raise _too_long(lengths.asked_s, spec, robot)
    ramp_samples, settle_samples, segment_samples = lengths.sampled(spec.sample_time_s)
    plan = ExcitationPlan(
        axis=excitation.axis,
        tones=excitation.tones,
        amplitude=1.0,
        sample_time_s=spec.sample_time_s,
        ramp_samples=ramp_samples,
        settle_samples=settle_samples,
        segments=excitation.segments,
        segment_samples=segment_samples,
    )
    if plan.duration_s > spec.duration_max_s:
        raise _too_long(plan.duration_s, spec, robot)
    return plan


def _too_long(duration_s: float, spec: RobotSpec, robot: str) -> RefusedError:
    return RefusedError(
        "duration",
        f"the test would take {duration_s:.4g} s, and the robot moves for at most "
        f"{spec.duration_max_s:.4g} s; request fewer segments, or tones that are higher or further "
        "apart",
        robot,
    )


def _check_motion(
    amplitude: float, velocity: float, acceleration: float, axis: AxisSpec, robot: str
) -> None:
    for code, value, limit, unit in (
        ("amplitude", amplitude, axis.amplitude_max, axis.unit),
        ("velocity", velocity, axis.velocity_max, f"{axis.unit}/s"),
        ("acceleration", acceleration, axis.acceleration_max, f"{axis.unit}/s²"),
    ):
        if value > limit:
            raise RefusedError(
                code,
                f"the reference of axis {axis.name} would reach {code} {value:.6g} {unit}, and its "
                f"limit is {limit:.6g} {unit}; omit the amplitude to let the robot choose it",
                robot,
            )
