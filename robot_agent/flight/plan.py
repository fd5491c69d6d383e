"""Checks a requested flight against the robot's limits and memory before anything moves."""

from __future__ import annotations

import numpy as np

from nufleet.robot_agent.flight.forecast import forecast_of
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.own_model import basis_of
from nufleet.shared.errors import InvalidInputError, RefusedError
from nufleet.shared.experience.combined_layout import CombinedLayout
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.experience.manifest import misfit
from nufleet.shared.paths.references import approach, rich_references, step_references
from nufleet.shared.paths.trajectories import check_trajectory
from nufleet.shared.robots.spec import RobotSpec, TrackingLimits
from nufleet.shared.text import in_thousandths
from nufleet.shared.wire.motions import Flight, FlightPlan, RichFlight, StepTest, Tracking


def plan_flight(
    motion: Flight,
    spec: RobotSpec,
    state_names: tuple[str, ...],
    memory: Memory,
    robot: str,
    *,
    allow_unguarded: bool = False,
) -> FlightPlan:
    """Plan a flight, or refuse it.

    Args:
        motion: Flight requested.
        spec: Description of the robot.
        state_names: Names of the states that the robot's `observe` measures.
        memory: Memory of the robot, with its prior and its baseline model.
        robot: Name of the robot, for the error.
        allow_unguarded: Whether the robot may fly with a learned inverse and without a guard.

    Returns:
        The length of the flight in samples, and its duration in seconds, which also covers the
        approach to the path's start and settling.

    Raises:
        RefusedError: The robot cannot or may not fly it; the code is `unknown-axis`, `no-tracking`,
            `trajectory`, `duration`, `layout`, `baseline`, `no-prior`, `other-prior`, `misfit`,
            `unguarded`, `no-own-model`, `vague-own-model` or `no-baseline`.
    """
    match motion:
        case StepTest(axis=axis):
            columns = [known.name for known in spec.axes]
            if axis not in columns:
                reason = f"no axis {axis!r}; there are {', '.join(columns)}"
                raise RefusedError("unknown-axis", reason, robot)
            _tracking_limits(spec, robot)
            samples = before = len(step_references(spec, columns.index(axis)))
        case RichFlight():
            _tracking_limits(spec, robot)
            nobody = np.random.default_rng(motion.seed)
            try:
                samples = before = len(rich_references(spec, motion.duration_s, nobody))
                basis_of(spec).nodes  # noqa: B018 - raises for a robot that none can describe
            except InvalidInputError as error:
                raise RefusedError("baseline", str(error), robot) from error
        case Tracking():
            limits = _tracking_limits(spec, robot)
            _check_path(motion, spec, limits, robot)
            if motion.inverse != "baseline" and not (motion.guarded or allow_unguarded):
                reason = (
                    "it may not fly with a learned inverse and without a guard: request a guarded "
                    "flight, or set allow_unguarded = true for it in its fleet file"
                )
                raise RefusedError("unguarded", reason, robot)
            _check_inverse(motion, spec, state_names, memory, robot)
            samples = len(motion.desired)
            before = samples + len(approach(spec, motion.desired, limits))
    duration_s = before * spec.sample_time_s + spec.settling_time_s
    if duration_s > spec.duration_max_s:
        raise RefusedError(
            "duration",
            f"the flight takes {duration_s:.0f} s; at most {spec.duration_max_s:g} s are accepted",
            robot,
        )
    return FlightPlan(sample_time_s=spec.sample_time_s, samples=samples, duration_s=duration_s)


def _tracking_limits(spec: RobotSpec, robot: str) -> TrackingLimits:
    if spec.tracking is None:
        raise RefusedError("no-tracking", "its spec has no tracking limits", robot)
    return spec.tracking


def _check_path(motion: Tracking, spec: RobotSpec, limits: TrackingLimits, robot: str) -> None:
    desired = motion.desired
    if desired.shape[1] != len(spec.axes):
        reason = f"the path has {desired.shape[1]} columns, the robot has {len(spec.axes)} axes"
        raise RefusedError("trajectory", reason, robot)
    try:
        check_trajectory(desired, spec.sample_time_s, limits)
    except InvalidInputError as error:
        raise RefusedError("trajectory", str(error), robot) from error


def _check_inverse(
    motion: Tracking, spec: RobotSpec, state_names: tuple[str, ...], memory: Memory, robot: str
) -> None:
    if motion.inverse == "baseline":
        return
    if motion.layout is not None:
        _check_layout(motion.layout, spec, state_names, robot)
    elif motion.inverse == "own":
        _check_own_model(motion, spec, memory, robot)
    else:
        _check_priors(motion, spec, state_names, memory, robot)
    if motion.guarded and memory.own_model(spec).model is None:
        reason = (
            "it has no model of its baseline yet, so the flight could not be guarded; it learns "
            "one from any completed motion: a frequency test, a path, or a rich flight"
        )
        raise RefusedError("no-baseline", reason, robot)


def _check_priors(
    motion: Tracking, spec: RobotSpec, state_names: tuple[str, ...], memory: Memory, robot: str
) -> None:
    held = {prior.sha256: prior.manifest for prior in memory.priors}
    if not held:
        reason = "no experience has been transferred to it; use `nufleet transfer`"
        raise RefusedError("no-prior", reason, robot)
    asked = motion.asked
    if any(sha256 not in held for sha256 in asked):
        sources = ", ".join(manifest.robot for manifest in held.values())
        reason = (
            f"its prior is a different one, from {sources}; transfer it again"
            if len(held) == 1
            else f"its priors are different ones, from {sources}; transfer them again"
        )
        raise RefusedError("other-prior", reason, robot)
    for one in motion.prior_by_axis:
        learned = held[one.sha256]
        if one.axis not in learned.axes:
            reason = (
                f"the experience of {learned.robot} was learned on {', '.join(learned.axes)}, not "
                f"on {one.axis}; choose another one for it"
            )
            raise RefusedError("misfit", reason, robot)
    for sha256 in asked:
        for axis in held[sha256].axes:
            # The prior fitted when it was installed, but the robot's settings may have changed.
            changed = misfit(held[sha256], spec, state_names, axis)
            if changed is not None:
                reason = f"its prior no longer fits it: {changed}; transfer a different one"
                raise RefusedError("misfit", reason, robot)
    try:
        CombinedLayout([held[sha256].layout for sha256 in asked])
    except InvalidInputError as error:
        raise RefusedError("misfit", f"its priors do not fit together: {error}", robot) from error


def _check_own_model(motion: Tracking, spec: RobotSpec, memory: Memory, robot: str) -> None:
    forecast = forecast_of(memory.own_model(spec).model, motion.desired)
    more = "let it fly a path, or a rich flight (`nufleet track --rich-flight 30`), first"
    if forecast is None:
        reason = f"it knows nothing of itself yet: {more}"
        raise RefusedError("no-own-model", reason, robot)
    if not forecast.own_helps:
        own = forecast.own
        rms, low, high, baseline = (
            in_thousandths(each, spec.axes[0].unit)
            for each in (own.rms, own.low, own.high, forecast.baseline.rms)
        )
        reason = (
            f"its model of itself is too vague for this path: with it an error of {rms} RMS is "
            f"expected, {low} to {high}, and its baseline is expected to leave {baseline}; {more}"
        )
        raise RefusedError("vague-own-model", reason, robot)


def _check_layout(
    layout: InverseLayout, spec: RobotSpec, state_names: tuple[str, ...], robot: str
) -> None:
    if abs(layout.sample_time_s - spec.sample_time_s) > 1e-9 * spec.sample_time_s:
        reason = (
            f"the layout has a sample time of {layout.sample_time_s:g} s, the robot one of "
            f"{spec.sample_time_s:g} s"
        )
        raise RefusedError("layout", reason, robot)
    needed = layout.measured_states
    if state_names[: len(needed)] != needed:
        reason = (
            f"the layout needs the states {', '.join(needed)}; the robot measures "
            f"{', '.join(state_names) or 'its output alone'}"
        )
        raise RefusedError("layout", reason, robot)
