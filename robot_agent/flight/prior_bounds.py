"""Checks that a prior's output on the paths a robot may fly is one that the robot could follow."""

from __future__ import annotations

import numpy as np

from nufleet.robot_agent.flight.inverse_model import InverseModel
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.paths.references import rich_references
from nufleet.shared.robots.spec import RobotSpec, TrackingLimits

BOUND_RATIO = 10.0
"""Largest |γ| of a prior, as a multiple of the γ of a correction within its bounds."""

_ROWS_MAX = 2000
_DURATION_S = 60.0


def gamma_max(layout: InverseLayout, limits: TrackingLimits) -> float:
    """Return the largest |γ| that a prior may output.

    γ is a speed of the reference, or a correction divided by the horizon. Both are bounded in
    flight, so the bound is `BOUND_RATIO` max(v + v_c, c / (hT)) with the largest speed v of a path,
    the largest speed v_c and size c of a correction, and the horizon hT.

    Args:
        layout: Inputs and output of the prior.
        limits: Tracking limits of the robot.

    Returns:
        The bound, in unit/s.
    """
    speed = limits.speed_max + limits.correction_speed_max
    return BOUND_RATIO * max(speed, limits.correction_max / layout.horizon_s)


def out_of_bounds(
    inverse: InverseModel, layout: InverseLayout, spec: RobotSpec, *, most: float | None = None
) -> str | None:
    """Return why a model cannot serve as a robot's prior.

    The model is evaluated along paths as fast, as wide and as quickly turning as the robot may fly,
    followed without error. In flight every reference is bounded as well, and the guard judges the
    result; this check rejects models that are no inverse at all.

    Args:
        inverse: Inverse model of the prior.
        layout: Inputs and output of that model.
        spec: Description of the robot; one without tracking limits never uses a prior.
        most: Largest |γ| in unit/s that the robot's owner allows; None for `gamma_max`.

    Returns:
        The reason for a person to read; None when the outputs are within bounds.
    """
    limits = spec.tracking
    if limits is None:
        return None
    duration_s = max(_DURATION_S, 2 * layout.span_samples * spec.sample_time_s)
    path = rich_references(spec, duration_s, np.random.default_rng(0))[:, 0]
    inputs, _ = layout.pairs(path, _followed(path, layout))
    inputs = inputs[:: max(1, len(inputs) // _ROWS_MAX)]
    with np.errstate(over="ignore", invalid="ignore"):
        gamma = inverse(inputs)
    if not np.isfinite(gamma).all():
        return "its outputs on paths that the robot may fly are not finite"
    largest, bound = float(np.abs(gamma).max()), gamma_max(layout, limits) if most is None else most
    if largest <= bound:
        return None
    why = f"its fleet file allows {bound:.3g} (`prior_output_max`)"
    if most is None:
        why = (
            f"no correction within its bounds needs more than {bound:.3g}: it is not an inverse of "
            "such a robot"
        )
    return f"its outputs reach {largest:.3g} unit/s on paths that the robot may fly, and {why}"


def _followed(path: FloatArray, layout: InverseLayout) -> FloatArray:
    """Return the states of a robot that is exactly on a path, shape (samples, states).

    The path has shape (samples,); states other than position and velocity are 0.
    """
    states = np.zeros((len(path), len(layout.states)))
    states[:, 0] = path
    if "velocity" in layout.states:
        states[:, layout.states.index("velocity")] = np.gradient(path, layout.sample_time_s)
    return states
