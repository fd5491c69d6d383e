"""Flies a target along drawings with every source's experience, with none, and with its baseline.

Everything is decided before the flights: each experience on its own robot, and the order of the
sources by frequency tests. The flights only show whether the prediction was right.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any, Literal, Protocol

from nufleet.orchestrator.evaluation.results import FlightRecord
from nufleet.orchestrator.evaluation.ways import sensor_noise_rms
from nufleet.orchestrator.experience.learning import pick_up
from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.experience.prior_custody import prior_put_back
from nufleet.orchestrator.experience.transfer import transfer, transfer_several
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.labels import (
    BASELINE,
    BY_AXIS,
    MIXTURE,
    NO_PRIOR,
    OWN,
    path_label,
)
from nufleet.orchestrator.flights.legs import Leg
from nufleet.orchestrator.flights.pilot import PathFlight, Pilot
from nufleet.orchestrator.flights.start_weights import mixture_of
from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.orchestrator.study.source_by_axis import sources_by_axis, way_with
from nufleet.shared.errors import RefusedError
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.experience.manifest import without_experience
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Description, ForeseenWay
from nufleet.shared.wire.motions import MIXTURE_MAX, PredictedError

_Inverse = Literal["baseline", "zero-prior", "prior", "mixture", "own"]

NO_OWN_MODEL = ("no-own-model", "vague-own-model")
"""Codes of the refusals of a robot that knows too little of itself for a path."""


class FlightObserver(Protocol):
    """An observer of flights, called from the thread that conducts the evaluation."""

    def begins(self, robot: str, label: str, spec: RobotSpec) -> None:
        """Handle the beginning of a flight of a robot, under the label that names it."""

    def ended(self, flight: PathFlight) -> None:
        """Handle the end of the flight, given its measurements."""


class FlightLog(Protocol):
    """An observer of the progress of an evaluation."""

    def begins(self, what: str, flights: int) -> None:
        """Handle the beginning of some flights, named by what they have in common."""

    def flown(self, record: FlightRecord) -> None:
        """Handle the end of a flight."""

    def point_complete(self, records: Sequence[FlightRecord]) -> None:
        """Handle that every way was flown at one point; `records` holds all flights until now."""


def fly_target(
    fleet: Fleet,
    pilot: Pilot,
    library: ExperienceLibrary,
    target: Description,
    sources: Sequence[str],
    legs: Sequence[Leg],
    architecture: Architecture,
    *,
    guarded: bool,
    observers: Sequence[FlightObserver],
    psi: Mapping[str, float] | None = None,
    ranking: Sequence[SourceEstimate] = (),
    own_flight_s: Sequence[float] = (0.0,),
    seed: int = 0,
    rehearse: bool = False,
    log: FlightLog | None = None,
    done: Sequence[FlightRecord] = (),
) -> tuple[FlightRecord, ...]:
    """Fly a target along all legs: own model, baseline, zero prior, every source, their mixture.

    Where axes differ in their closest source, it also flies with that of each axis.

    The target learns nothing of itself from these flights, so that all of them begin with the same
    knowledge. After further rich flights of its own it flies again with its model of itself. A path
    that its model of itself is too vague for is not flown with it. Afterwards the target again
    holds the prior that it held before.

    Args:
        fleet: Client of the fleet, already connected.
        pilot: Pilot that has the target fly.
        library: Experiences of the fleet's robots, those of the sources among them.
        target: Description of the robot that flies.
        sources: Names of the sources, the selected one first.
        legs: Paths to fly with every inverse.
        architecture: Architecture of the sources' experiences to transfer.
        guarded: Whether the guard may withdraw a prior in flight.
        observers: Callbacks for the beginning and the end of each flight.
        psi: Estimated distance of the sources, from which the mixture's weights start; None to
            start from equal ones.
        ranking: Estimates of a ranking, the selected source first, which say what source is the
            closest on each axis.
        own_flight_s: Durations of the target's own flying, rising from 0, after which it flies.
        seed: Seed of its rich flights.
        rehearse: Whether the target first predicts the error of every way on every path. The errors
            of its baseline and of its model of itself are predicted without that.
        log: Observer of the progress; None for none.
        done: Records of the flights that were flown before an interruption, which are not flown
            again.

    Returns:
        One record per flight, in the order in which they were flown.

    Raises:
        RobotError: A real robot failed and needs a person's attention.
        RefusedError: The target refuses a flight, for example because its baseline is not known.
    """
    flown = _Flown(fleet, pilot, target, observers, log, done)
    robot = target.robot

    def way(inverse: _Inverse, **found: Any) -> ForeseenWay:
        # The target remembers none of the flights, so that all of them begin with the same.
        return ForeseenWay(inverse=inverse, guarded=guarded, remember=False, **found)

    own = way("own")
    by_axis = held_by_axis(ranking, sources)
    points = len(own_flight_s)
    if len(done) >= flights_planned(len(sources), len(legs), points, by_axis=bool(by_axis)):
        return tuple(done)
    with prior_put_back(fleet, pilot, target):
        alone = sources[MIXTURE_MAX:]  # more than a robot can hold at a time
        held = transfer_several(fleet, library, sources[:MIXTURE_MAX], target, architecture)
        mixture = mixture_of(fleet.describe(robot).priors, psi)
        ways = {OWN: own, BASELINE: way("baseline")}
        ways[NO_PRIOR] = way(
            "zero-prior", layout=without_experience([one.manifest for one in held])
        )
        ways |= {
            source: way("prior", prior_sha256=given.sha256)
            for source, given in zip(sources, held, strict=False)
        }
        ways[MIXTURE] = way("mixture", mixture=mixture)
        if by_axis:
            each = way_with(by_axis, {one.manifest.robot: one.sha256 for one in held})
            ways[BY_AXIS] = each.model_copy(update={"guarded": guarded, "remember": False})
        for leg in legs:
            flown.along(leg, ways, rehearse=rehearse)
        for source in alone:
            given = transfer(fleet, library, source, target, architecture)
            for leg in legs:
                flown.along(leg, {source: way("prior", prior_sha256=given.sha256)})
        flown.end_point()
        for place, (before_s, after_s) in enumerate(pairwise(own_flight_s)):
            flown.go_further(after_s - before_s, seed + place)
            for leg in legs:
                flown.along(leg, {OWN: own})
            flown.end_point()
    return tuple(flown.records)


def flights_planned(sources: int, legs: int, points: int, *, by_axis: bool = False) -> int:
    """Return how many flights `fly_target` begins."""
    return legs * (sources + by_axis + 4 + points - 1)


def held_by_axis(ranking: Sequence[SourceEstimate], sources: Sequence[str]) -> dict[str, str]:
    """Return the source of each axis, if the target may hold all of their experiences.

    Args:
        ranking: Estimates of a ranking, the selected source first.
        sources: Sources whose experiences are flown, the selected one first.

    Returns:
        Sources by axis; empty where one source is as good on all axes, or an experience is not
        among those that a robot can hold at a time.
    """
    chosen = sources_by_axis(ranking)
    return chosen if set(chosen.values()) <= set(sources[:MIXTURE_MAX]) else {}


class _Flown:
    """Has a target fly legs in several ways, and keeps the records."""

    def __init__(
        self,
        fleet: Fleet,
        pilot: Pilot,
        target: Description,
        observers: Sequence[FlightObserver],
        log: FlightLog | None,
        done: Sequence[FlightRecord],
    ) -> None:
        self._fleet, self._pilot, self._target = fleet, pilot, target
        self._observers, self._log = observers, log
        self.records = list(done)
        self._beyond_tests_s = 0.0

    def along(self, leg: Leg, ways: Mapping[str, ForeseenWay], *, rehearse: bool = False) -> None:
        """Fly one leg in every way that it has not been flown in with the present knowledge."""
        known = {
            record.inverse
            for record in self.records
            if (record.drawing, record.speed_m_s) == (leg.drawing, leg.speed)
            and record.beyond_tests_s == self._beyond_tests_s
        }
        missing = {name: way for name, way in ways.items() if name not in known}
        if not missing:
            return
        if self._log is not None:
            after = f" after {self._beyond_tests_s:.0f} s of its own flying"
            path = path_label(leg.drawing, leg.speed, leg.unit)
            self._log.begins(path + (after if self._beyond_tests_s else ""), len(missing))
        predicted = self._rehearsed(leg, missing) if rehearse else {}
        for name, way in missing.items():
            self._fly(name, way, leg, predicted.get(name))

    def go_further(self, duration_s: float, seed: int) -> None:
        """Have the target fly for itself, unless it did so before an interruption."""
        later = [r for r in self.records if r.beyond_tests_s > self._beyond_tests_s]
        if later:
            self._beyond_tests_s = min(record.beyond_tests_s for record in later)
            return
        robot, before_s = self._target.robot, self.records[-1].own_flight_s
        known_s = self._fleet.describe(robot).least_known_s
        if before_s is not None and known_s - before_s > duration_s / 2:
            # It was interrupted after that flight, and before the next one along a path.
            self._beyond_tests_s += known_s - before_s
            return
        result, _ = self._pilot.rich(robot, duration_s=duration_s, seed=seed)
        self._beyond_tests_s += len(result.reference) * self._target.spec.sample_time_s

    def end_point(self) -> None:
        """Tell the log that every way was flown with the present knowledge."""
        if self._log is not None:
            self._log.point_complete(self.records)

    def _rehearsed(
        self, leg: Leg, ways: Mapping[str, ForeseenWay]
    ) -> dict[str, PredictedError | None]:
        """Have the target predict its error in the ways that learn in flight.

        What it predicts of the others comes with their flights.
        """
        learning = {
            name: way for name, way in ways.items() if way.inverse not in ("baseline", "own")
        }
        if not learning:
            return {}
        found = self._fleet.forecast(self._target.robot, leg.desired, list(learning.values()))
        return {name: one.predicted for name, one in zip(learning, found, strict=True)}

    def _fly(self, name: str, way: ForeseenWay, leg: Leg, expected: PredictedError | None) -> None:
        robot = self._target.robot
        after = f"+{self._beyond_tests_s:.0f}s" if self._beyond_tests_s else ""
        label = leg.label(f"{name}{after}")
        for observer in self._observers:
            observer.begins(robot, label, self._target.spec)
        known_s = self._fleet.describe(robot).least_known_s
        flight: PathFlight | None = None
        try:
            flight = self._pilot.along(robot, way, leg.desired, label)
        except RefusedError as error:
            if error.code not in NO_OWN_MODEL:
                raise
            record = _not_flown(robot, name, leg, error.reason, known_s)
        else:
            record = flight_record(flight, name, leg, known_s, expected)
        record = record.model_copy(update={"beyond_tests_s": self._beyond_tests_s})
        self.records.append(record)
        # First, so that no flight is repeated whose samples are kept already.
        if self._log is not None:
            self._log.flown(record)
        if flight is not None:
            for observer in self._observers:
                observer.ended(flight)
            if flight.failure is not None:
                pick_up(self._fleet, self._target, flight.failure)


def _not_flown(
    robot: str, inverse: str, leg: Leg, reason: str, own_flight_s: float
) -> FlightRecord:
    return FlightRecord(
        target=robot,
        inverse=inverse,
        drawing=leg.drawing,
        speed_m_s=leg.speed,
        rms_m=None,
        taken_back=None,
        failure=f"not flown: {reason}",
        flown=False,
        deadline_misses=0,
        own_flight_s=own_flight_s,
    )


def flight_record(
    flight: PathFlight,
    inverse: str,
    leg: Leg,
    own_flight_s: float | None = None,
    expected: PredictedError | None = None,
) -> FlightRecord:
    """Return the record of a flight along a leg with the named inverse.

    Args:
        flight: The flight, as it was flown.
        inverse: Name of the source, BASELINE, NO_PRIOR or OWN.
        leg: Path of the flight.
        own_flight_s: Duration of the motions by which the robot knew itself before.
        expected: Error that it predicted, if the flight does not say; None if it did not.
    """
    event, predicted = flight.details.taken_back, flight.details.predicted or expected
    return FlightRecord(
        target=flight.robot,
        inverse=inverse,
        drawing=leg.drawing,
        speed_m_s=leg.speed,
        rms_m=None if flight.failure is not None else flight.rms_error,
        taken_back=None if event is None else event.reason,
        failure=flight.failure,
        deadline_misses=flight.deadline_misses,
        weights=flight.mean_weights,
        own_flight_s=own_flight_s,
        predicted_rms_m=None if predicted is None else predicted.rms,
        predicted_low_m=None if predicted is None else predicted.low,
        predicted_high_m=None if predicted is None else predicted.high,
        noise_rms_m=sensor_noise_rms(flight.actual) if len(flight.actual) > 3 else None,
        findings=flight.details.findings,
    )
