"""Checks of a study that are made before any robot moves."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping

from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.spec import AxisSpec
from nufleet.shared.wire.messages import Description

ALL_AXES = "all"
"""Word for all axes of the target that the sources have, too, on the command line."""


def check_band(band_rad_s: tuple[float, float]) -> None:
    """Raise InvalidInputError unless a band is finite, positive and rising, in rad/s."""
    low, high = band_rad_s
    if not (math.isfinite(low) and math.isfinite(high)):
        raise InvalidInputError(f"the band must be two finite frequencies, got {low} {high}")
    if low <= 0:
        raise InvalidInputError(
            f"the band must begin above 0 rad/s, got {low:g}: a test at 0 rad/s would never end, "
            "since its period is infinite. Use the lowest frequency that your trajectories contain"
        )
    if low >= high:
        raise InvalidInputError(
            f"the band is {'empty' if low == high else 'reversed'}: got {low:g} to {high:g} rad/s; "
            "give the lower frequency first"
        )


def check_names(target: str, sources: tuple[str, ...], there: tuple[str, ...]) -> None:
    """Raise InvalidInputError unless target and sources are different robots of the fleet.

    Args:
        target: Name of the target.
        sources: Names of the sources, at least one.
        there: Names of the robots that may take part.
    """
    check_robots((target, *sources), there)
    if target in sources:
        raise InvalidInputError(f"the target {target!r} is among the sources; take it out of them")
    if len(set(sources)) != len(sources):
        raise InvalidInputError("a source is named twice")
    if not sources:
        raise InvalidInputError(f"there is no source besides the target {target!r}")


def check_robots(robots: tuple[str, ...], there: tuple[str, ...]) -> None:
    """Raise InvalidInputError unless at least one robot is named, and all are in `there`."""
    for robot in robots:
        if robot not in there:
            raise InvalidInputError(
                f"no robot {robot!r} in this fleet; there are {', '.join(there) or 'none'}"
            )
    if not robots:
        raise InvalidInputError("no robot is there; start some with `nufleet fleet up FLEET`")


def chosen_axes(
    axes: tuple[str, ...] | None, target: Description, others: Iterable[Description] = ()
) -> tuple[str, ...]:
    """Return the axes to test: those requested, all that can be compared, or the first for None.

    Args:
        axes: Names of the axes; the single name `all` stands for all axes of the target that every
            other robot has, too, in the same unit, or for the first where there is none.
        target: Description of the target.
        others: Descriptions of the other robots.

    Raises:
        InvalidInputError: An axis is named twice.
    """
    names = tuple(axis.name for axis in target.spec.axes)
    if axes is None:
        return names[:1]
    if len(set(axes)) != len(axes):
        raise InvalidInputError(f"an axis is named twice in {', '.join(axes)}")
    if axes != (ALL_AXES,) or ALL_AXES in names:
        return axes
    lacking = {axis for other in others for axis in _lacking(target, other)}
    return tuple(axis for axis in names if axis not in lacking) or names[:1]


def axes_left_out(plan: StudyPlan, descriptions: Mapping[str, Description]) -> tuple[str, ...]:
    """Return in words which axes of the target are not compared, since a source differs in them."""
    target = descriptions[plan.target]
    return tuple(
        f"axis {axis} is not compared: {source} {why}"
        for source in plan.sources
        for axis, why in _lacking(target, descriptions[source]).items()
        if axis not in plan.axes
    )


def _lacking(target: Description, other: Description) -> dict[str, str]:
    """Return why axes of the target cannot be compared with another robot's, by axis."""
    units = {axis.name: axis.unit for axis in other.spec.axes}
    found = {}
    for axis in target.spec.axes:
        if axis.name not in units:
            found[axis.name] = f"has no such axis, but {', '.join(units)}"
        elif units[axis.name] != axis.unit:
            found[axis.name] = f"has it in {units[axis.name]}, and the target in {axis.unit}"
    return found


def check_plan(plan: StudyPlan, descriptions: Mapping[str, Description]) -> None:
    """Raise InvalidInputError unless every robot can be tested on all axes over the whole band."""
    units = [_axis(axis, plan.target, descriptions[plan.target]).unit for axis in plan.axes]
    if plan.amplitude is not None and len(set(units)) > 1:
        named = ", ".join(f"{axis} in {unit}" for axis, unit in zip(plan.axes, units, strict=True))
        raise InvalidInputError(
            f"one amplitude cannot hold for axes in several units ({named}): choose one with --axis"
        )
    check_band(plan.band_rad_s)
    low, high = plan.band_rad_s
    for robot in (plan.target, *plan.sources):
        spec = descriptions[robot].spec
        if low < spec.omega_min_rad_s or high > spec.omega_max_rad_s:
            raise InvalidInputError(
                f"the band {low:g} to {high:g} rad/s exceeds the range in which robot {robot} can "
                f"be tested: {spec.omega_min_rad_s:g} to {spec.omega_max_rad_s:g} rad/s"
            )
        for axis in plan.axes:
            unit = _axis(axis, robot, descriptions[robot]).unit
            at_target = _axis(axis, plan.target, descriptions[plan.target]).unit
            if unit != at_target:
                raise InvalidInputError(
                    f"axis {axis} of robot {robot} is in {unit}, that of the target {plan.target} "
                    f"in {at_target}: their responses cannot be compared"
                )


def _axis(axis: str, robot: str, description: Description) -> AxisSpec:
    try:
        return description.spec.axis(axis)
    except KeyError as error:
        names = ", ".join(a.name for a in description.spec.axes)
        raise InvalidInputError(f"robot {robot} has no axis {axis!r}; it has {names}") from error
