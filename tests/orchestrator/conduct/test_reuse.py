"""Sources that need not fly, since what was measured of them earlier stands for their tests."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta

import pytest
from archived_studies import DESCRIPTIONS, PLAN, SPEC, archive, begin, measure

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.recipe import make_study
from nufleet.orchestrator.conduct.replay import round_of
from nufleet.orchestrator.conduct.reuse import (
    Reuse,
    check_absent,
    find_stored,
    oldest_reused,
    said_of,
    stored_responses,
)
from nufleet.orchestrator.runs.rank_result import StoredResponses
from nufleet.shared.errors import InvalidInputError

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


def test_who_is_not_there_must_be_known(measured: Archive) -> None:
    reuse = find(measured)
    check_absent(["near"], reuse, "lab")
    with pytest.raises(InvalidInputError, match="robot far of fleet lab is not there"):
        check_absent(["near", "far"], reuse, "lab")


def test_a_result_says_who_did_not_fly_and_how_old_the_data_are(measured: Archive) -> None:
    stored = stored_responses(measured.repository.studies, find(measured).known)
    assert stored["near"].tests == 1
    assert stored["near"].studies == ("run-adaptive",)
    later = datetime.now(UTC) + timedelta(hours=5)
    said = said_of("near", stored["near"], later)
    assert said.startswith("near did not fly: 1 stored test was used, measured 5 h ago")
    assert said.endswith("(run-adaptive)")


def test_ages_are_in_units_that_can_be_read() -> None:
    stored = StoredResponses(
        tests=4,
        measured_from="2030-01-01T12:00:00+00:00",
        measured_to="2030-01-05T11:30:00+00:00",
        studies=("a", "b"),
    )
    said = said_of("near", stored, datetime(2030, 1, 5, 12, tzinfo=UTC))
    assert "4 stored tests were used, measured 30 min to 4 days ago (a, b)" in said
