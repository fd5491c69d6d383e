"""What each robot would do in the first round of a study, from its spec alone: nothing moves."""

from __future__ import annotations

from collections.abc import Mapping

from nufleet.orchestrator.study.interface import Question, StudyPlan
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.duration import duration_s
from nufleet.shared.frequency_test.excitation import AxisTones, Excitation
from nufleet.shared.robots.health import Health
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.strict import Document, Fraction, Name, NonNegative, Strict


class PlannedMotion(Strict):
    """One frequency test that a robot would play."""

    robot: Name
    """Name of the robot."""
    axis: Name
    """Name of the axis."""
    simulated: bool
    """Whether the robot is simulated."""
    tones: int
    """Number of tones."""
    omega_min_rad_s: NonNegative
    """Lowest frequency."""
    omega_max_rad_s: NonNegative
    """Highest frequency."""
    duration_s: NonNegative
    """Duration of the test."""
    reach: NonNegative
    """Largest distance of the reference from where the robot rests, in `unit`."""
    velocity: NonNegative
    """Largest velocity of the reference, in `unit`/s."""
    acceleration: NonNegative
    """Largest acceleration of the reference, in `unit`/s²."""
    unit: str
    """Unit of the axis."""
    measured_min: float | None
    measured_max: float | None
    """Limits on what is measured, in `unit`; None for none."""
    battery: Fraction | None = None
    """Charge of the battery now; None if unknown."""
    endurance_s: NonNegative | None = None
    """Time that the battery lasts; None if unknown."""


class StudyOutlook(Document):
    """The document that `nufleet rank --plan --json` prints."""

    target: Name
    """Target of the study."""
    axis: Name
    """Axis that would be tested."""
    also: tuple[Name, ...] = ()
    """Further axes that would be tested."""
    band_rad_s: tuple[float, float]
    """Band of the study."""
    rounds_max: int
    """Largest number of rounds; later ones depend on what the first shows."""
    first_round: tuple[PlannedMotion, ...]
    """Motions of the first round, all at the same time; they begin and end at rest at 0."""


def outlook(
    plan: StudyPlan,
    question: Question,
    specs: Mapping[str, RobotSpec],
    healths: Mapping[str, Health | None],
) -> StudyOutlook:
    """Return what a study's first round would have each robot do.

    A robot chooses its amplitude itself, so that the limits of its axis bound reach, velocity and
    acceleration; it stays below them.

    Args:
        plan: Checked plan of the study.
        question: First round of the study.
        specs: Spec of each robot, by name.
        healths: Latest health of each robot, by name; None where none is reported.
    """
    return StudyOutlook(
        target=plan.target,
        axis=plan.axis,
        also=plan.also,
        band_rad_s=plan.band_rad_s,
        rounds_max=plan.iterations,
        first_round=tuple(
            _planned(robot, played, test, specs[robot], healths.get(robot))
            for robot, test in question.tests.items()
            for played in test.played
        ),
    )


def check_healths(planned: StudyOutlook, healths: Mapping[str, Health | None]) -> None:
    """Refuse a study whose robots are not ready or cannot finish the first round.

    Raises:
        InvalidInputError: A robot is not ready, or its battery does not last; all are named.
    """
    wrong = []
    for motion in planned.first_round:
        health = healths.get(motion.robot)
        if health is None:
            continue
        if not health.ready:
            wrong.append(f"{motion.robot} is not ready: {health.reason}")
        elif health.endurance_s is not None and health.endurance_s < motion.duration_s:
            wrong.append(
                f"{motion.robot} would move for {motion.duration_s:.3g} s, and its battery lasts "
                f"for {health.endurance_s:.3g} s"
            )
    if wrong:
        raise InvalidInputError(f"{'; '.join(dict.fromkeys(wrong))}; nothing has moved")


def _planned(
    robot: str, played: AxisTones, test: Excitation, spec: RobotSpec, health: Health | None
) -> PlannedMotion:
    axis = spec.axis(played.axis)
    omegas = [tone.omega_rad_s for tone in played.tones]
    return PlannedMotion(
        robot=robot,
        axis=axis.name,
        simulated=spec.simulated,
        tones=len(omegas),
        omega_min_rad_s=min(omegas),
        omega_max_rad_s=max(omegas),
        duration_s=duration_s(test, spec),
        reach=axis.amplitude_max,
        velocity=axis.velocity_max,
        acceleration=axis.acceleration_max,
        unit=axis.unit,
        measured_min=axis.output_min,
        measured_max=axis.output_max,
        battery=None if health is None else health.battery,
        endurance_s=None if health is None else health.endurance_s,
    )
