"""Whether what a prior answers on the paths that a robot flies is anything that it could follow."""

from __future__ import annotations

import numpy as np

from nufleet.robot_agent.flight.inverse_model import InverseModel
from nufleet.robot_agent.flight.rich_flight import rich_references
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.robots.spec import RobotSpec, TrackingLimits

BOUND_RATIO = 10.0
"""A prior's γ is at most so many times what a correction within its bounds comes to."""

_ROWS_MAX = 2000
_DURATION_S = 60.0


def gamma_max(layout: InverseLayout, limits: TrackingLimits) -> float:
    """Return the largest |γ| that a prior may answer with, in unit/s.

    γ is a speed of the reference, or a correction over the horizon; both are bounded in flight.
    """
    speed = limits.speed_max + limits.correction_speed_max
    return BOUND_RATIO * max(speed, limits.correction_max / layout.horizon_s)


def out_of_bounds(inverse: InverseModel, layout: InverseLayout, spec: RobotSpec) -> str | None:
    """Return why a prior cannot be one for a robot; None when its answers are in bounds.

    It is asked along paths as fast, as wide and as quickly turning as the robot may fly, followed
    without an error. In flight every reference is bounded besides, and the guard judges what comes
    of it; this keeps out what is no inverse at all.

    Args:
        inverse: of the prior.
        layout: of its inputs.
        spec: of the robot; one that does not track asks no prior anything.
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
        return "its answers on paths that the robot may fly are not finite"
    largest, most = float(np.abs(gamma).max()), gamma_max(layout, limits)
    if largest > most:
        return (
            f"its answers reach {largest:.3g} unit/s on paths that the robot may fly, and no "
            f"correction within its bounds needs more than {most:.3g}: it is no inverse of such "
            "a robot"
        )
    return None


def _followed(path: FloatArray, layout: InverseLayout) -> FloatArray:
    """Return the states of a robot on its path, (samples, states); what else it measures is 0."""
    states = np.zeros((len(path), len(layout.states)))
    states[:, 0] = path
    if "velocity" in layout.states:
        states[:, layout.states.index("velocity")] = np.gradient(path, layout.sample_time_s)
    return states
