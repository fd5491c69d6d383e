"""What each robot would do in a round of tests, from its spec alone: nothing moves."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence

from nufleet.orchestrator.flights.planned import Outlook, PlannedMotion, measured_limits, unit_of
from nufleet.orchestrator.study.interface import Question, StudyPlan
from nufleet.shared.frequency_test.duration import duration_s
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.robots.joint_limits import HEADROOM
from nufleet.shared.robots.spec import RobotSpec


def outlook(
    plan: StudyPlan,
    question: Question,
    specs: Mapping[str, RobotSpec],
    robots: Collection[str] | None = None,
) -> Outlook:
    """Return what a round of a study would have each robot do.

    Args:
        plan: Checked plan of the study.
        question: Round of tests to preview.
        specs: Spec of each robot, by name.
        robots: Names of the robots whose tests are still to be done; None for all.
    """
    low, high = plan.band_rad_s
    axes = f"ax{'e' if plan.also else 'i'}s {', '.join(plan.axes)}"
    later = "further rounds depend on what this one shows"
    return Outlook(
        headline=(
            f"round {question.iteration} of at most {plan.iterations}, all robots at the same "
            f"time: {axes}, {low:g} to {high:g} rad/s"
        ),
        later=later if question.iteration < plan.iterations else "",
        motions=tuple(
            planned_test(robot, test, specs[robot])
            for robot, test in question.tests.items()
            if robots is None or robot in robots
        ),
    )


def planned_test(
    robot: str, test: Excitation, spec: RobotSpec, *, times: int = 1, what: str | None = None
) -> PlannedMotion:
    """Return a frequency test as a motion.

    Where the test leaves the amplitude to the robot, the robot stays below all limits of its axes
    by the margin `HEADROOM`, so that these bound the motion.

    Args:
        robot: Name of the robot.
        test: Frequency test to play.
        spec: Spec of the robot.
        times: How many times it is played.
        what: What it is, in words; None for its tones.
    """
    axes = [spec.axis(played.axis) for played in test.played]
    share = HEADROOM if test.amplitude is None else 1.0
    reach = {
        played.axis: played.amplitude or HEADROOM * spec.axis(played.axis).amplitude_max
        for played in test.played
    }
    return PlannedMotion(
        robot=robot,
        simulated=spec.simulated,
        what=what or _tones(test.omega_rad_s),
        times=times,
        duration_s=duration_s(test, spec),
        unit=unit_of(axes),
        low={axis: -most for axis, most in reach.items()},
        high=reach,
        velocity=share * max(axis.velocity_max for axis in axes),
        acceleration=share * max(axis.acceleration_max for axis in axes),
        measured=measured_limits(axes),
    )


def _tones(omega_rad_s: Sequence[float]) -> str:
    if len(omega_rad_s) == 1:
        return f"tone at {omega_rad_s[0]:.3g} rad/s"
    return f"{len(omega_rad_s)} tones, {omega_rad_s[0]:.3g} to {omega_rad_s[-1]:.3g} rad/s"
