"""A robot's own experience: flown, its horizon chosen in flight, trained, and given back to it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from nufleet.orchestrator.experience.horizon import HorizonChoice, candidate_layouts, choose_horizon
from nufleet.orchestrator.experience.lesson_record import LearningRecord, pooled_pairs
from nufleet.orchestrator.experience.prior_custody import install, prior_put_back
from nufleet.orchestrator.experience.relative_degree import relative_degree
from nufleet.orchestrator.experience.training import Origin, TrainingData
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.legs import practice_path
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.shared.errors import InvalidInputError, RobotError, StudyError
from nufleet.shared.experience.file import Experience, encode_experience
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.wire.messages import Description

FLIGHT_S = 120.0
"""Of a rich flight: five thousand pairs at 50 samples per second, of which training takes 2100."""


@dataclass(frozen=True, eq=False)
class Lesson:
    """What a robot flew for one experience: all that its training needs."""

    robot: str
    data: TrainingData
    origin: Origin
    choice: HorizonChoice


Say = Callable[[str, str], None]


def fly_lessons(
    pilot: Pilot,
    fleet: Fleet,
    description: Description,
    architectures: tuple[Architecture, ...],
    *,
    seed: int,
    duration_s: float = FLIGHT_S,
    say: Say,
) -> tuple[Lesson, ...]:
    """Have a robot fly what its experiences are learned from, one lesson for each architecture.

    A rich flight, steps on every axis, then guarded flights with linear inverses of every horizon.
    The robot's prior, if it has one, is put back afterwards.

    Args:
        pilot: flies.
        fleet: installs the candidates.
        description: of the robot.
        architectures: of the experiences.
        seed: draws the rich flight.
        duration_s: of the rich flight.
        say: is told (robot, what it does now).

    Raises:
        InvalidInputError: it does not track, or has axes of several units; nothing moved.
        StudyError: it does not answer to steps, or no horizon can be flown.
        RobotError: a flight failed.
    """
    robot, spec = description.robot, description.spec
    path, unit = practice_path(spec, robot), _unit(description)
    say(robot, f"flies richly for {duration_s:.0f} s")
    result, details = pilot.rich(robot, duration_s=duration_s, seed=seed)
    record = LearningRecord(result.reference, details.states, details.state_names)
    say(robot, "flies steps")
    columns = tuple(range(len(spec.axes)))
    degree = max(_degree(pilot, robot, i, spec.axes[i].name) for i in columns)
    origin = Origin(
        robot=robot,
        robot_kind=spec.kind,
        axes=tuple(axis.name for axis in spec.axes),
        unit=unit,
        relative_degree=degree,
    )

    def fly(candidate: Experience) -> float:
        horizon = candidate.manifest.layout.horizon_s
        say(robot, f"tries a horizon of {horizon:.2f} s")
        sha256 = install(fleet, robot, "prior", encode_experience(candidate)).sha256
        flight = pilot.with_prior(robot, path, "practice", sha256, learn=False)
        if flight.failure is not None:
            pick_up(fleet, description, flight.failure)
            return math.inf
        event = flight.details.taken_back
        if event is not None:
            say(robot, f"does not fly it to the end: {event.reason}")
            return math.inf
        return flight.rms_error

    lessons = []
    with prior_put_back(fleet, pilot, description):
        for architecture in architectures:
            layouts = candidate_layouts(
                architecture, details.state_names, spec.sample_time_s, degree
            )
            choice = choose_horizon(layouts, record, columns, origin, fly)
            data = TrainingData(*pooled_pairs(choice.layout, record, columns))
            lessons.append(Lesson(robot, data, origin, choice))
    return tuple(lessons)


def pick_up(fleet: Fleet, description: Description, failure: str) -> None:
    """Make a robot that failed ready again, which for a real one is a person's task.

    Raises:
        RobotError: it is a real one.
    """
    if not description.spec.simulated:
        raise RobotError(
            f"robot {description.robot} failed: {failure}; see to it, then `nufleet release` it"
        )
    fleet.release(description.robot)


def _degree(pilot: Pilot, robot: str, column: int, axis: str) -> int:
    result = pilot.steps(robot, axis)
    try:
        return relative_degree(result.reference[:, column], result.response[:, column])
    except StudyError as error:
        raise StudyError(
            f"robot {robot}, axis {axis}: {error}; see whether it moves at all, with "
            f"`nufleet track --target {robot} --inverse baseline --trajectory clover`"
        ) from error


def _unit(description: Description) -> Literal["m", "rad"]:
    units = {axis.unit for axis in description.spec.axes}
    if len(units) > 1:
        raise InvalidInputError(
            f"robot {description.robot} has axes in {' and '.join(sorted(units))}; one experience "
            "covers axes of one unit"
        )
    return description.spec.axes[0].unit
