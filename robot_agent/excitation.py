"""Turns a request for a frequency test into the samples a robot plays, or refuses it."""

from __future__ import annotations

import math

import numpy as np

from shared.arrays import FloatArray
from shared.errors import RefusedError
from shared.excitation import Excitation, ExcitationPlan
from shared.robot_spec import AxisSpec, RobotSpec

HEADROOM = 0.8
"""Share of the tightest limit that is used when the robot chooses the amplitude itself."""

RAMP_MAX_S = 5.0
RAMP_MIN_PERIODS = 1 / 8
"""A ramp lasts one period of the slowest tone where that is short. A slow tone is ramped over 5 s
or an eighth of its period: a whole one would cost minutes, and at worst this triples the peak
velocity of a motion that is slow anyway."""

RESOLUTION_PERIODS = 2.0
"""Periods of the slowest beat between two tones that the measuring part has to hold. At one the
least squares can just tell them apart; at two its variance is that of each tone alone."""


def plan_excitation(excitation: Excitation, spec: RobotSpec, robot: str) -> ExcitationPlan:
    """Choose what a request leaves open, and check the whole reference against every limit.

    A segment lasts one period of the slowest tone, `segment_min_s`, or what it takes for all
    segments together to hold `RESOLUTION_PERIODS` beats of the closest tones, whichever is longest.
    Without `settle_s` the measuring part begins `spec.settling_time_s` after the ramp: a transient
    decays at the robot's own rate, whatever the tone's frequency.

    Args:
        excitation: the request.
        spec: the robot's description.
        robot: the robot's name, for the error.

    Raises:
        RefusedError: with code `unknown-axis`, `omega-out-of-band`, `duration`, `amplitude`,
            `velocity` or `acceleration`. Nothing is ever clipped to a limit.
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
    """Return the reference, sample by sample, in the axis's unit; shape (samples,).

    Its first and last sample are 0, and no sample exceeds the plan's amplitude.
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
    """Return the largest first and second difference quotient of a reference between two rests."""
    padded = np.concatenate([[0.0, 0.0], reference, [0.0, 0.0]])
    velocity = np.diff(padded) / sample_time_s
    acceleration = np.diff(velocity) / sample_time_s
    return float(np.max(np.abs(velocity))), float(np.max(np.abs(acceleration)))


def _envelope(plan: ExcitationPlan) -> FloatArray:
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
                f"{spec.omega_min_rad_s:.6g} rad/s; one period would take "
                f"{2 * math.pi / omega:.4g} s, and at 0 rad/s it never ends",
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
    """Choose the lengths of all parts; the plan returned has amplitude 1."""
    omegas = sorted(tone.omega_rad_s for tone in excitation.tones)
    period_s = 2 * math.pi / omegas[0]
    segment_s = max(period_s, excitation.segment_min_s)
    if len(omegas) > 1:
        closest_rad_s = min(np.diff(omegas))
        beat_s = 2 * math.pi / float(closest_rad_s)
        segment_s = max(segment_s, RESOLUTION_PERIODS * beat_s / excitation.segments)
    settle_s = spec.settling_time_s if excitation.settle_s is None else excitation.settle_s
    ramp_s = min(period_s, max(RAMP_MAX_S, RAMP_MIN_PERIODS * period_s))

    # Compared as numbers first: a request may ask for more samples than there is memory.
    asked_s = 2 * ramp_s + settle_s + excitation.segments * segment_s
    if asked_s > spec.duration_max_s:
        raise _too_long(asked_s, spec, robot)
    sample_time_s = spec.sample_time_s
    plan = ExcitationPlan(
        axis=excitation.axis,
        tones=excitation.tones,
        amplitude=1.0,
        sample_time_s=sample_time_s,
        ramp_samples=math.ceil(ramp_s / sample_time_s),
        settle_samples=math.ceil(settle_s / sample_time_s),
        segments=excitation.segments,
        segment_samples=max(4, math.ceil(segment_s / sample_time_s)),
    )
    if plan.duration_s > spec.duration_max_s:
        raise _too_long(plan.duration_s, spec, robot)
    return plan


def _too_long(duration_s: float, spec: RobotSpec, robot: str) -> RefusedError:
    return RefusedError(
        "duration",
        f"the test would take {duration_s:.4g} s, and the robot moves for at most "
        f"{spec.duration_max_s:.4g} s; ask for fewer segments, higher or less close tones",
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
                f"limit is {limit:.6g} {unit}; leave the amplitude out and the robot chooses one",
                robot,
            )
