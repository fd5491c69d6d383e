"""Turns a request for a frequency test into the samples a robot plays, or refuses it."""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RefusedError
from nufleet.shared.frequency_test.duration import timing
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan, PlannedTones
from nufleet.shared.robots.joint_limits import HEADROOM, joint_share
from nufleet.shared.robots.spec import AxisSpec, RobotSpec


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
            `unknown-axis`, `omega-out-of-band`, `duration`, `amplitude`, `velocity`,
            `acceleration`, or `together` where the axes break one only together.
    """
    axes = [_axis_of(one.axis, spec, robot) for one in excitation.played]
    _check_together(axes, robot)
    _check_band(excitation, spec, robot)
    plan = _timed(excitation, spec, robot)
    step_s = spec.sample_time_s
    unit_references = reference_of(plan).reshape(plan.samples, len(axes))
    velocities, accelerations = _differences(unit_references, step_s)
    peaks = np.stack([np.abs(one).max(axis=0) for one in (velocities, accelerations)], 1).tolist()
    amplitudes = [
        min(axis.amplitude_max, axis.velocity_max / velocity, axis.acceleration_max / acceleration)
        if wanted.amplitude is None
        else wanted.amplitude
        for wanted, axis, (velocity, acceleration) in zip(
            excitation.played, axes, peaks, strict=True
        )
    ]
    share = joint_share(velocities * amplitudes, accelerations * amplitudes, axes)
    if excitation.amplitude is None:
        amplitudes = [HEADROOM * (share * amplitude) for amplitude in amplitudes]
    else:
        for amplitude, (velocity, acceleration), axis in zip(amplitudes, peaks, axes, strict=True):
            _check_motion(amplitude, amplitude * velocity, amplitude * acceleration, axis, robot)
        _check_share(share, axes, robot)
    also = tuple(
        one.model_copy(update={"amplitude": amplitude})
        for one, amplitude in zip(plan.also, amplitudes[1:], strict=True)
    )
    return plan.model_copy(update={"amplitude": amplitudes[0], "also": also})


def reference_of(plan: ExcitationPlan) -> FloatArray:
    """Return the reference of a plan.

    That of each axis is A e(k) s(k) / max|s| with the amplitude A, the envelope e that ramps from 0
    to 1 and back, and the sum of tones s(k) = Σ w_i sin(ω_i k T + φ_i), w_i relative to the largest
    weight. Its first and last samples are 0, and no sample exceeds the amplitude.

    Args:
        plan: Plan of the frequency test.

    Returns:
        The reference in the axes' units, shape (samples,), or (samples, axes) for a test of several
        axes in the order of `plan.played`.
    """
    references = [_reference_of(one, plan) for one in plan.played]
    return references[0] if len(references) == 1 else np.stack(references, axis=1)


def _reference_of(played: PlannedTones, plan: ExcitationPlan) -> FloatArray:
    times_s = np.arange(plan.samples) * plan.sample_time_s
    heaviest = max(tone.weight for tone in played.tones)
    total = np.zeros(plan.samples)
    for tone in played.tones:
        share = tone.weight / heaviest
        total += share * np.sin(tone.omega_rad_s * times_s + tone.phase_rad)
    shape: FloatArray = _envelope(plan) * (total / np.max(np.abs(total)))
    return played.amplitude * shape


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
    velocity, acceleration = _differences(reference[:, None], sample_time_s)
    return float(np.max(np.abs(velocity))), float(np.max(np.abs(acceleration)))


def _differences(references: FloatArray, sample_time_s: float) -> tuple[FloatArray, FloatArray]:
    """Return velocities and accelerations, shape (samples + 3 or + 2, axes), of (samples, axes)."""
    # Two zeros on either side, since the robot rests at 0 before the first and after the last
    # sample and the steps from and to rest count too.
    padded = np.zeros((len(references) + 4, references.shape[1]))
    padded[2:-2] = references
    velocity = np.diff(padded, axis=0) / sample_time_s
    return velocity, np.diff(velocity, axis=0) / sample_time_s


def _check_together(axes: list[AxisSpec], robot: str) -> None:
    alone = [axis.name for axis in axes if not axis.together]
    if len(axes) > 1 and alone:
        raise RefusedError(
            "together",
            f"axis {alone[0]} may not move at the same time as another; request a test of it alone",
            robot,
        )


def _check_share(share: float, axes: list[AxisSpec], robot: str) -> None:
    if share < 1:
        names = " and ".join(axis.name for axis in axes)
        raise RefusedError(
            "together",
            f"the references of axes {names} together would reach {1 / share:.4g} times what their "
            "limits on velocity and acceleration allow; omit the amplitudes to let the robot "
            "choose them",
            robot,
        )


def _envelope(plan: ExcitationPlan) -> FloatArray:
    # Raised cosine (1 − cos(π k / n)) / 2: both ends have zero slope, so the ramp adds no jump in
    # velocity.
    ramp = 0.5 - 0.5 * np.cos(np.pi * np.arange(plan.ramp_samples) / plan.ramp_samples)
    flat = np.ones(plan.samples - 2 * plan.ramp_samples)
    return np.concatenate([ramp, flat, ramp[::-1]])


def _axis_of(name: str, spec: RobotSpec, robot: str) -> AxisSpec:
    try:
        return spec.axis(name)
    except KeyError as error:
        raise RefusedError("unknown-axis", str(error.args[0]), robot) from error


def _check_band(excitation: Excitation, spec: RobotSpec, robot: str) -> None:
    for omega in excitation.omega_rad_s:
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
        also=tuple(
            PlannedTones(axis=one.axis, tones=one.tones, amplitude=1.0) for one in excitation.also
        ),
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
