"""Finds the sources that need no tests, because stored responses of theirs are still valid."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import TYPE_CHECKING

from nufleet.orchestrator.conduct.recipe import recipe_of
from nufleet.orchestrator.repository.records import Origin, ResponseRecord
from nufleet.orchestrator.runs.rank_result import StoredResponses
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.spec import RobotSpec

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.repository import Repository
    from nufleet.orchestrator.repository.study_store import StudyStore


FLIGHTS_MAX = 4
SPEED_RATIO = 1.25
"""Largest number of flights of one robot that are reused, and ratio of two speeds that count as
different."""


@dataclass(frozen=True)
class Reuse:
    """The stored responses that replace tests in a study."""

    known: Mapping[str, tuple[str, ...]]
    """Goal ids of the responses that are reused, oldest first, by source."""
    unusable: Mapping[str, str]
    """Reason why a source has no usable stored response, for every other source."""


def find_stored(
    repository: Repository,
    fleet: str,
    plan: StudyPlan,
    specs: Mapping[str, RobotSpec],
    *,
    newer_than: datetime,
) -> Reuse:
    """Find the sources whose stored responses can replace tests.

    A response is reused if the robot's spec has not changed since, it is of one of the axes and the
    band of its study contains the band of this one; that of a flight or log, if it knows part of
    the band, since what is missing is tested. The target is always tested, because the ranking is
    made for its present state.

    Args:
        repository: Repository to search.
        fleet: Name of the fleet to which the sources belong.
        plan: Plan of the study that is about to begin.
        specs: Spec of each source, by name: the current one, or the last known of an absent robot.
        newer_than: Time before which a measurement is too old to be reused.

    Returns:
        The goals of the reused responses, and for every other source the reason why there are none.
    """
    known: dict[str, tuple[str, ...]] = {}
    unusable: dict[str, str] = {}
    for source in plan.sources:
        stored = _stored(repository, fleet, source, plan.axes, specs[source])
        young = [one for one in stored if one.measured_at >= newer_than]
        fitting = [one for one in young if _fits(one, repository.studies, plan, specs[source])]
        lacking = set(plan.axes).difference(*(one.response.own_entries for one in fitting))
        if not lacking:
            known[source] = tuple(one.goal_id for one in fitting)
        elif fitting:
            unusable[source] = f"none is stored of axis {' and '.join(sorted(lacking))}"
        elif young:
            unusable[source] = "it has changed since then, or was tested over another band"
        elif stored:
            unusable[source] = f"the latest one was measured {_day(stored[-1].measured_at)}"
        else:
            unusable[source] = "none is stored"
    return Reuse(known, unusable)


def _stored(
    repository: Repository, fleet: str, source: str, axes: Sequence[str], spec: RobotSpec
) -> list[ResponseRecord]:
    """Return the stored tests of a robot that played one of some axes, and then its flights."""
    # A test of several axes is stored under the first of them, which may be any of the robot's.
    tests = [
        one
        for first in spec.axes
        for one in repository.studies.responses(fleet, source, first.name)
        if not set(axes).isdisjoint(one.response.own_entries)
    ]
    flights = [
        one
        for axis in axes
        for one in _different(repository.flights.responses(fleet, source, axis))
    ]
    return [*sorted(tests, key=lambda one: (one.measured_at, one.goal_id)), *flights]


def check_absent(absent: Sequence[str], reuse: Reuse, fleet: str) -> None:
    """Check that stored responses replace the tests of every absent robot.

    Args:
        absent: Names of the sources that are not alive.
        reuse: Stored responses that were found.
        fleet: Name of the fleet, for the message.

    Raises:
        InvalidInputError: An absent robot has no usable stored response.
    """
    for robot in absent:
        if robot not in reuse.known:
            raise InvalidInputError(
                f"robot {robot} of fleet {fleet} is not there, and no stored response can replace "
                f"its tests: {reuse.unusable[robot]}; start it, or leave it out with --sources"
            )


def oldest_reused(days: float, now: datetime) -> datetime:
    """Return the time before which a response is too old to be reused, `days` before `now`."""
    return now - timedelta(days=days)


def stored_responses(
    studies: StudyStore, goals: Mapping[str, tuple[str, ...]]
) -> dict[str, StoredResponses]:
    """Return a summary of the stored responses that replaced tests, by source.

    Args:
        studies: Store of the responses.
        goals: Goal ids of the reused responses, at least one, by source.

    Raises:
        RepositoryError: A response cannot be read.
    """
    found = {robot: [studies.response(goal) for goal in ids] for robot, ids in goals.items()}
    return {
        robot: StoredResponses(
            tests=sum(one.origin is Origin.TEST for one in records),
            flights=sum(one.origin is not Origin.TEST for one in records),
            measured_from=_iso(min(one.measured_at for one in records)),
            measured_to=_iso(max(one.measured_at for one in records)),
            studies=tuple(dict.fromkeys(one.study_id for one in records)),
        )
        for robot, records in found.items()
    }


def said_of(robot: str, stored: StoredResponses, now: datetime) -> str:
    """Return a sentence that says which data replaced a robot's first test, and their age."""
    measured = (stored.measured_to, stored.measured_from)
    ages = dict.fromkeys(age_text(now - datetime.fromisoformat(when)) for when in measured)
    return (
        f"{robot} needed no first test: {stored.counted} replaced it, measured "
        f"{' to '.join(ages)} ago ({', '.join(stored.studies)}){stored.reservation}"
    )


def _different(flights: Sequence[ResponseRecord]) -> tuple[ResponseRecord, ...]:
    """Return the latest flights, of those at nearly one speed the latest alone, oldest first.

    Flights at other speeds show whether a robot is linear; more of the same would weigh as much as
    a test each, and tell little.
    """
    found: dict[int, ResponseRecord] = {}
    for one in flights:
        if one.flown is not None:
            level = round(math.log(max(one.flown.flight.speed, 1e-9)) / math.log(SPEED_RATIO))
            found.pop(level, None)
            found[level] = one
    return tuple(found.values())[-FLIGHTS_MAX:]


def _fits(one: ResponseRecord, studies: StudyStore, plan: StudyPlan, spec: RobotSpec) -> bool:
    if one.flown is not None:
        low, high = one.flown.band_rad_s
        overlap = low < plan.band_rad_s[1] and high > plan.band_rad_s[0]
        return overlap and one.flown.spec == spec
    study = studies.study(one.study_id)
    (low, high), (wanted_low, wanted_high) = study.plan.band_rad_s, plan.band_rad_s
    if not low <= wanted_low < wanted_high <= high:
        return False
    return recipe_of(study).specs.get(one.robot) == spec


def _iso(when: datetime) -> str:
    return when.astimezone(UTC).isoformat(timespec="seconds")


def _day(when: datetime) -> str:
    return f"on {when.astimezone(UTC):%Y-%m-%d}"


def age_text(age: timedelta) -> str:
    """Return an age in words, in minutes, hours or days, such as "3 days"."""
    minutes = max(0.0, age.total_seconds() / 60)
    if minutes < 120:
        return f"{minutes:.0f} min"
    return f"{minutes / 60:.0f} h" if minutes < 48 * 60 else f"{minutes / 60 / 24:.0f} days"
