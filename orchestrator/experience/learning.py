"""The flights that a robot learns its own experience from, which also choose its horizon."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from nufleet.orchestrator.experience.horizon import (
    CANDIDATES_S,
    HorizonChoice,
    candidate_layouts,
    choose_horizon,
)
from nufleet.orchestrator.experience.lesson_record import LearningRecord, pooled_pairs
from nufleet.orchestrator.experience.prior_custody import install, prior_put_back
from nufleet.orchestrator.experience.relative_degree import relative_degree
from nufleet.orchestrator.experience.training import Origin, TrainingData
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.legs import practice_path
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.orchestrator.flights.planned import PlannedMotion, lesson_motions
from nufleet.shared.errors import InvalidInputError, RobotError, StudyError
from nufleet.shared.experience.file import Experience, encode_experience
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.wire.messages import Description
from nufleet.shared.wire.motions import Way

FLIGHT_S = 120.0
"""Duration of a rich flight. At 50 samples per second it yields about 6000 training pairs, of which
training takes 2100."""

FIRST_FLIGHT_S = 30.0
"""Duration of the rich flight of a robot that knows nothing of itself yet. A robot that has been
tested needs none."""


@dataclass(frozen=True, eq=False)
class Lesson:
    """The data of a robot's flights for one experience: everything that its training needs."""

    robot: str
    """Name of the robot that flew."""
    data: TrainingData
    """Training pairs of all axes, for the chosen horizon."""
    origin: Origin
    """Robot and axes that the experience comes from."""
    choice: HorizonChoice
    """Layout of the inverse model, and the trials that chose its horizon."""


Say = Callable[[str, str], None]
"""Reports progress: the robot's name, and a phrase that says what it does now."""


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
    """Have a robot fly the lessons for its experiences, one for each architecture.

    The robot flies a persistently exciting reference, then steps on every axis, and then a practice
    path under guard with linear inverses of every horizon. If it holds a prior, that prior is put
    back afterwards.

    Args:
        pilot: Pilot that has the robot fly.
        fleet: Client of the fleet; installs the candidates on the robot.
        description: Description of the robot that learns.
        architectures: Architectures of the experiences to learn.
        seed: Seed of the rich flight's reference.
        duration_s: Duration of the rich flight.
        say: Callback that receives the robot's name and its present activity.

    Returns:
        One lesson per architecture, in the given order.

    Raises:
        InvalidInputError: The robot cannot track, has axes of different units, or lacks the states
            of an architecture; nothing moved.
        StudyError: The robot does not respond to steps, or no horizon can be flown.
        RobotError: A flight failed.
    """
    check_lessons(description, architectures)
    robot, spec = description.robot, description.spec
    path, unit = practice_path(spec, robot), _unit(description)
    say(robot, f"flies a persistently exciting reference for {duration_s:.0f} s")
    result, details = pilot.rich(robot, duration_s=duration_s, seed=seed)
    record = LearningRecord(result.reference, details.states, details.state_names)
    say(robot, "flies a step test on each axis")
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
        way = Way(inverse="prior", prior_sha256=sha256, learn=False)
        flight = pilot.along(robot, way, path, "practice")
        if flight.failure is not None:
            pick_up(fleet, description, flight.failure)
            return math.inf
        event = flight.details.taken_back
        if event is not None:
            say(robot, f"does not fly it to the end, the guard withdrew it: {event.reason}")
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


def check_lessons(description: Description, architectures: tuple[Architecture, ...]) -> None:
    """Raise InvalidInputError if a robot cannot fly lessons; see `fly_lessons`."""
    robot = description.robot
    practice_path(description.spec, robot)
    _unit(description)
    if "state" in architectures and not description.state_names:
        raise InvalidInputError(
            f"robot {robot} measures its output alone, and an inverse of its state needs its state "
            "measured: let it learn a preview (--architecture preview)"
        )


def planned_lessons(
    description: Description,
    architectures: tuple[Architecture, ...],
    *,
    seed: int,
    duration_s: float = FLIGHT_S,
) -> tuple[PlannedMotion, ...]:
    """Return the motions of `fly_lessons`, for the same arguments, before any of them.

    Raises:
        InvalidInputError: The robot cannot track.
    """
    # An inverse of the state may be flown twice with each horizon; see `choose_horizon`.
    flights = {"state": 2, "preview": 1}
    trials = sum(flights[architecture] * len(CANDIDATES_S) for architecture in architectures)
    return lesson_motions(description, duration_s=duration_s, seed=seed, trials=trials)


def know_itself(
    fleet: Fleet, pilot: Pilot, robot: str, *, seed: int, say: Callable[[str], None]
) -> None:
    """Have a robot fly until its guard knows its baseline, unless an earlier motion has shown it.

    Args:
        fleet: Client of the robot's fleet.
        pilot: Pilot that has the robot fly.
        robot: Name of the robot.
        seed: Seed of the rich flight's reference.
        say: Called with one line before the flight.

    Raises:
        RobotError: The flight failed.
    """
    if fleet.describe(robot).baseline_known:
        return
    say(f"{robot} flies for {FIRST_FLIGHT_S:.0f} s first, so that its guard knows its baseline")
    pilot.rich(robot, duration_s=FIRST_FLIGHT_S, seed=seed)


def pick_up(fleet: Fleet, description: Description, failure: str) -> None:
    """Make a simulated robot ready again after a failed flight.

    Args:
        fleet: Client of the robot's fleet.
        description: Description of the robot.
        failure: Reason why its flight failed.

    Raises:
        RobotError: The robot is real: only a person may judge whether it can fly again.
    """
    if not description.spec.simulated:
        raise RobotError(
            f"robot {description.robot} failed: {failure}; inspect it, then `nufleet release` it"
        )
    fleet.release(description.robot)


def _degree(pilot: Pilot, robot: str, column: int, axis: str) -> int:
    result = pilot.steps(robot, axis)
    try:
        return relative_degree(result.reference[:, column], result.response[:, column])
    except StudyError as error:
        raise StudyError(
            f"robot {robot}, axis {axis}: {error}; check whether it moves at all, with "
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
