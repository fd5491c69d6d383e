"""The trajectory that a ranking is made for: a drawing that the target flies at some speed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from nufleet.orchestrator.flights.legs import Leg, legs_of
from nufleet.orchestrator.study.interface import DesiredMotion
from nufleet.orchestrator.study.trajectory_spectrum import spectrum_of
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.paths.installed import find_drawing
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Description


@dataclass(frozen=True, eq=False)
class TimedPath:
    """A drawing to be flown, and its speed."""

    name: str
    """Name of the drawing."""
    points: FloatArray
    """Points along the drawing in m, shape (points, 2)."""
    speed_m_s: float | None
    """Largest speed in m/s; None takes the largest that the target may go along it."""


def read_motion(path_or_name: str, speed_m_s: float | None) -> TimedPath:
    """Read a drawing, given as a file path or as the name of an installed drawing.

    Args:
        path_or_name: Path of a drawing file, or the name of an installed drawing.
        speed_m_s: Largest speed in m/s; None leaves it to the target.

    Raises:
        InvalidInputError: There is no such drawing, or it is not a path that can be flown.
    """
    path = find_drawing(path_or_name)
    return TimedPath(path.stem, read_drawing(path), speed_m_s)


def leg_of(drawing: TimedPath, target: Description) -> Leg:
    """Return a drawing as the path that a target flies.

    Args:
        drawing: Drawing to be flown, and its speed.
        target: Description of the target.

    Raises:
        InvalidInputError: The target does not track, or may not fly the drawing like this.
    """
    speed = _speed(drawing, target.spec, target.spec.axes[0].name)
    (leg,) = legs_of({drawing.name: drawing.points}, (speed,), target)
    return leg


def _speed(drawing: TimedPath, spec: RobotSpec, axis: str) -> float:
    """Return the largest speed along a drawing, in the unit of the axis per second."""
    if drawing.speed_m_s is not None:
        return drawing.speed_m_s
    most = spec.axis(axis).velocity_max
    return most if spec.tracking is None else min(most, spec.tracking.speed_max)


def axes_along(drawing: TimedPath, spec: RobotSpec, axes: Sequence[str]) -> tuple[str, ...]:
    """Return the axes to test for a drawing: those that fly it, or the first where one is lacking.

    Args:
        drawing: Drawing to be flown.
        spec: Spec of the target.
        axes: Names of all axes that can be compared.
    """
    flown = spec.axes[: drawing.points.shape[1]]
    comparable = all(axis.name in axes and axis.unit == "m" for axis in flown)
    return tuple(axis.name for axis in flown) if comparable else tuple(axes[:1])


def desired_motion(drawing: TimedPath, spec: RobotSpec, axes: Sequence[str]) -> DesiredMotion:
    """Return the spectrum of a drawing's motion when the target flies it.

    The first axes of the target fly the drawing's, and each of several tested axes has its own
    spectrum. Where a single axis is tested, the power of both axes of the drawing is summed,
    because their responses are assumed to be similar, as in the paper (Sec. VI-B).

    Args:
        drawing: Drawing to be flown, and its speed.
        spec: Spec of the target, whose axes limit the speed (m/s) and acceleration (m/s²).
        axes: Names of the axes under test.

    Raises:
        InvalidInputError: An axis does not move in m, none of several moves along the drawing, or
            the drawing cannot be flown.
    """
    axis, *also = axes
    for name in axes:
        if spec.axis(name).unit != "m":
            raise InvalidInputError(
                f"a drawing is in m, and axis {name} of the target moves in "
                f"{spec.axis(name).unit}: leave --trajectory out"
            )
    flown = [one.name for one in spec.axes[: drawing.points.shape[1]]]
    if also and not set(flown) <= set(axes):
        raise InvalidInputError(
            f"axes {', '.join(flown)} of the target move along a drawing, and "
            f"{', '.join(axes)} would be tested: test all of them, or one with --axis"
        )
    limits, speed_m_s = spec.axis(axis), _speed(drawing, spec, axis)
    positions = travel(drawing.points, speed_m_s, limits.acceleration_max, spec.sample_time_s)
    spectrum = spectrum_of(positions, spec.sample_time_s)
    told_apart = spectrum.by_column if also else None
    return DesiredMotion(
        name=f"{drawing.name} at {speed_m_s:g} m/s",
        omega_rad_s=tuple(spectrum.omega_rad_s.tolist()),
        power=tuple(spectrum.power.tolist()),
        power_by_axis={}
        if told_apart is None
        else {name: tuple(power.tolist()) for name, power in zip(flown, told_apart.T, strict=True)},
    )


def amplitude_of(motion: DesiredMotion) -> float:
    """Return the amplitude in m of a sinusoid as large as a motion on one of its axes.

    A sinusoid's power is half of its amplitude squared. Each of the two axes of a drawing counts as
    half of its power where they are not told apart, and otherwise the one that moves most.

    Args:
        motion: Spectrum of the motion.
    """
    each = [sum(power) for power in motion.power_by_axis.values()]
    return math.sqrt(2 * max(each, default=sum(motion.power) / 2))
