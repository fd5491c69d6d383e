"""Sources that need not fly, since what was measured of them earlier stands for their tests."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from archived_studies import DESCRIPTIONS, PLAN, SPEC, archive, begin, measure

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.recipe import AWAY, Recipe, make_study, recipe_of
from nufleet.orchestrator.conduct.replay import round_of
from nufleet.orchestrator.conduct.reuse import (
    Reuse,
    check_absent,
    find_stored,
    oldest_reused,
    said_of,
    stored_responses,
)
from nufleet.orchestrator.repository.records import (
    FlightCircumstances,
    Origin,
    ResponseRecord,
    RobotRecord,
)
from nufleet.orchestrator.runs.rank_result import StoredResponses
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.frequency_response import Flight, FrequencyResponse
from nufleet.shared.frequency_test.quality import Quality
from nufleet.shared.robots.spec import RobotSpec

__all__ = ["archive"]

NOW = datetime.now(UTC)
SPECS = dict.fromkeys(DESCRIPTIONS, SPEC)


@pytest.fixture
def measured(archive: Archive) -> Archive:
    """An archive in which the target and `near` were tested, and `far` was not."""
    study = begin(archive, "adaptive")
    question = make_study(study, archive.repository.studies).ask()
    assert question is not None
    for test in round_of(study.study_id, question).tests:
        if test.robot != "far":
            measure(archive, test)
    return archive


def find(archive: Archive, days: float = 30.0, **changes: object) -> Reuse:
    arguments = {"plan": PLAN, "specs": SPECS, **changes}
    newer_than = oldest_reused(days, NOW)
    return find_stored(archive.repository, "lab", newer_than=newer_than, **arguments)  # type: ignore[arg-type]


def test_a_source_with_responses_is_known_and_the_target_is_tested_all_the_same(
    measured: Archive,
) -> None:
    reuse = find(measured)
    assert reuse.known == {"near": ("run-adaptive.1.near.1",)}
    assert reuse.unusable == {"far": "none is stored"}


def test_part_of_a_band_is_covered_by_tests_of_the_whole(measured: Archive) -> None:
    low, high = PLAN.band_rad_s
    assert "near" in find(measured, plan=replace(PLAN, band_rad_s=(2 * low, high / 2))).known
    wider = find(measured, plan=replace(PLAN, band_rad_s=(low, 1.1 * high)))
    assert "another band" in wider.unusable["near"]


def test_a_robot_that_has_changed_or_was_measured_long_ago_flies(measured: Archive) -> None:
    altered = SPEC.model_copy(update={"settling_time_s": 2 * SPEC.settling_time_s})
    assert "has changed" in find(measured, specs={**SPECS, "near": altered}).unusable["near"]
    assert f"{datetime.now(UTC):%Y-}" in find(measured, days=-1.0).unusable["near"]


def test_stored_tests_must_cover_every_axis_that_is_ranked(measured: Archive) -> None:
    along_y = find(measured, plan=replace(PLAN, axis="y"))
    assert along_y.unusable["near"] == "none is stored"
    both = find(measured, plan=replace(PLAN, also=("y",)))
    assert both.unusable["near"] == "none is stored of axis y"


def test_who_is_not_there_must_be_known(measured: Archive) -> None:
    reuse = find(measured)
    check_absent(["near"], reuse, "lab")
    with pytest.raises(InvalidInputError, match="robot far of fleet lab is not there"):
        check_absent(["near", "far"], reuse, "lab")


def add_flight(
    archive: Archive, robot: str = "far", *, speed: float = 0.6, spec: RobotSpec = SPEC, n: int = 0
) -> None:
    omega = np.linspace(1.0, 8.0, 5)
    flight = Flight(speed, 0.003)
    response = FrequencyResponse(
        omega, 1 / (1 + 0.1j * omega), np.full(5, 1e-4), 3, Quality(), flight=flight
    )
    archive.repository.robots.describe(RobotRecord("lab", robot, spec, "boot-1"))
    archive.repository.flights.add(
        ResponseRecord(
            fleet="lab",
            robot=robot,
            axis="x",
            goal_id=f"log.{robot}.{n}",
            study_id="morning.ulg",
            kind=spec.kind,
            measured_at=NOW + timedelta(seconds=n),
            response=response,
            origin=Origin.LOG,
            flown=FlightCircumstances(spec, (1.0, 8.0), flight, 25.0),
        )
    )


def test_flights_count_after_the_tests_of_their_robot(measured: Archive) -> None:
    for robot in ("near", "far"):
        add_flight(measured, robot)
    reuse = find(measured)
    assert reuse.known == {"near": ("run-adaptive.1.near.1", "log.near.0"), "far": ("log.far.0",)}
    stored = stored_responses(measured.repository.studies, reuse.known)
    assert (stored["near"].tests, stored["near"].flights) == (1, 1)
    assert stored["far"].studies == ("morning.ulg",)
    assert "1 stored test and 1 stored flight replaced it" in said_of("near", stored["near"], NOW)


def test_flights_alone_are_said_to_claim_nothing_about_other_motions(measured: Archive) -> None:
    for robot in ("near", "far"):
        add_flight(measured, robot)
    stored = stored_responses(measured.repository.studies, find(measured).known)
    assert "until a test of it confirms them" in said_of("far", stored["far"], NOW)
    assert "until a test" not in said_of("near", stored["near"], NOW)


def test_of_flights_at_one_speed_the_latest_counts_and_those_at_others_are_kept(
    measured: Archive,
) -> None:
    for n, speed in enumerate((0.3, 0.6, 0.31, 0.9)):
        add_flight(measured, speed=speed, n=n)
    assert find(measured).known["far"] == ("log.far.1", "log.far.2", "log.far.3")


def test_a_flight_of_a_robot_that_has_changed_since_does_not_count(measured: Archive) -> None:
    altered = SPEC.model_copy(update={"settling_time_s": 2 * SPEC.settling_time_s})
    add_flight(measured, spec=altered)
    assert "it has changed since then" in find(measured).unusable["far"]


def test_a_study_is_built_again_from_flights_and_knows_who_is_absent(archive: Archive) -> None:
    for robot in ("near", "far"):
        add_flight(archive, robot)
    away = DESCRIPTIONS["far"].model_copy(update={"boot_id": AWAY})
    study = archive.begin(
        *("run-flights", "adaptive", PLAN, 1, {**DESCRIPTIONS, "far": away}),
        {"near": ("log.near.0",), "far": ("log.far.0",)},
    )
    recipe = recipe_of(archive.repository.studies.study("run-flights"))
    assert recipe.untestable == {"far"}
    question = make_study(study, archive.repository.studies).ask()
    assert question is not None
    assert question.robots == ("target",)
    known = make_study(study, archive.repository.studies).responses["near"][0]
    assert known.flight == Flight(0.6, 0.003)


def test_a_study_of_an_older_nufleet_goes_on_without_testing_stored_robots(
    archive: Archive,
) -> None:
    recipe = Recipe(specs=SPECS, stored={"near": ("run-1.1.near.1",)})
    assert recipe.untestable == {"near"}


def test_a_result_says_who_did_not_fly_and_how_old_the_data_are(measured: Archive) -> None:
    stored = stored_responses(measured.repository.studies, find(measured).known)
    assert stored["near"].tests == 1
    assert stored["near"].studies == ("run-adaptive",)
    later = datetime.now(UTC) + timedelta(hours=5)
    said = said_of("near", stored["near"], later)
    assert said.startswith("near needed no first test: 1 stored test replaced it, measured 5 h ago")
    assert said.endswith("(run-adaptive)")


def test_ages_are_in_units_that_can_be_read() -> None:
    stored = StoredResponses(
        tests=4,
        measured_from="2030-01-01T12:00:00+00:00",
        measured_to="2030-01-05T11:30:00+00:00",
        studies=("a", "b"),
    )
    said = said_of("near", stored, datetime(2030, 1, 5, 12, tzinfo=UTC))
    assert "4 stored tests replaced it, measured 30 min to 4 days ago (a, b)" in said
