"""Which way to fly: the one that is expected to leave least, and what would be better later."""

from __future__ import annotations

import pytest

from nufleet.orchestrator.flights.ways import Foresight, WayRecord, advice, described
from nufleet.shared.wire.messages import Foreseen
from nufleet.shared.wire.motions import PredictedError


def way(name: str, rms_mm: float | None, more_s: float = 0.0) -> WayRecord:
    if rms_mm is None:
        found = Foreseen(code="no-prior", reason="it has learned nothing yet")
    else:
        rms = rms_mm / 1000
        found = Foreseen(predicted=PredictedError(rms=rms, low=0.9 * rms, high=1.2 * rms))
    return WayRecord.of(name, 20.0 + more_s, found)


def foresight(*ways: WayRecord) -> Foresight:
    return Foresight("target", "clover at 0.6 m/s", "m", ways)


BASELINE, NONE = way("baseline", 62.7), way("none", 8.7)
OWN, LATER = way("own", 9.5), (way("own", 3.0, 15.0), way("own", 2.9, 30.0))


def test_the_best_source_is_advised_with_what_own_flying_would_bring_later() -> None:
    found = foresight(BASELINE, NONE, OWN, way("source-1", 5.1), way("source-2", 17.0), *LATER)
    assert found.chosen == "source-1"
    assert advice(found) == (
        "fly first with source-1's experience: 5.1 mm (4.59 to 6.12) expected, the baseline leaves "
        "62.7 mm; after 15 s of rich flight its own model is expected to leave 3 mm"
    )


@pytest.mark.parametrize(
    ("ways", "chosen"),
    [
        ((BASELINE, NONE, way("own", 3.1), way("source-1", 5.1), way("mixture", 4.9)), "own"),
        ((BASELINE, NONE, OWN, way("source-1", 12.0)), "none"),
        ((BASELINE, way("none", 70.0), way("source-1", 80.0)), "baseline"),
    ],
)
def test_a_transfer_that_leaves_more_is_advised_against(
    ways: tuple[WayRecord, ...], chosen: str
) -> None:
    found = foresight(*ways)
    assert found.chosen == chosen
    assert "do not transfer: the best of it" in advice(found)


def test_the_mixture_may_be_the_best_transfer() -> None:
    found = foresight(BASELINE, NONE, OWN, way("source-1", 5.1), way("mixture", 4.2))
    assert found.chosen == "mixture"
    assert advice(found).startswith("fly first with a mixture of the sources' experiences: 4.2 mm")


def test_a_way_that_needs_more_flying_is_not_chosen_and_not_taken_for_the_present_one() -> None:
    found = foresight(BASELINE, OWN, *LATER)
    assert found.chosen == "own"
    assert found.now["own"].rms == pytest.approx(9.5e-3)
    assert [described(record, found.present_s) for record in found.later] == [
        "own model after 15 s of rich flight",
        "own model after 30 s of rich flight",
    ]


def test_more_flying_that_brings_little_is_not_mentioned() -> None:
    found = foresight(BASELINE, way("own", 3.0), way("own", 2.9, 30.0))
    assert "rich flight" not in advice(found)


def test_sources_without_experience_are_no_reason_to_advise_against_a_transfer() -> None:
    said = advice(foresight(BASELINE, NONE, OWN, way("source-1", None)))
    assert "do not transfer" not in said
    assert "no source has an experience yet" in said


def test_of_two_that_leave_the_same_the_one_that_takes_less_is_chosen() -> None:
    found = foresight(way("mixture", 3.0), way("source-1", 3.0), way("own", 3.0), BASELINE)
    assert found.chosen == "own"


def test_nothing_is_chosen_where_nothing_could_be_predicted() -> None:
    found = foresight(way("baseline", None))
    assert found.chosen is None
    assert "could be predicted" in advice(found)


def test_what_of_a_path_was_never_seen_comes_with_the_baseline_and_is_told_of_the_path() -> None:
    error = PredictedError(rms=0.06, low=0.05, high=0.07)
    found = Foreseen(predicted=error, reason="it has never moved y")
    seen = foresight(WayRecord.of("baseline", 20.0, found), OWN)
    assert (seen.unseen, foresight(BASELINE, OWN).unseen) == ("it has never moved y", None)
    assert (seen.chosen, seen.ways[0].reason) == ("own", None)
