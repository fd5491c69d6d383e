"""An evaluation over several axes: one source for all of them beside the closest on each."""

from __future__ import annotations

import io

import pytest
from evaluated_flights import records
from rankings_by_axis import RANKING, estimate
from rich.console import Console

from nufleet.orchestrator.evaluation.comparison import Psi, order_of, summarise
from nufleet.orchestrator.evaluation.fly_target import flights_planned, held_by_axis
from nufleet.orchestrator.evaluation.pairs import compare_pairs
from nufleet.orchestrator.evaluation.report import evaluation_table
from nufleet.orchestrator.evaluation.results import EvaluationResult
from nufleet.orchestrator.flights.labels import BASELINE, BY_AXIS
from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.orchestrator.study.predicted_errors import PredictedRms

ALGORITHM_1 = {"even": Psi(0.13, 0.0), "like-x": Psi(0.02, 0.0), "like-y": Psi(0.31, 0.0)}
"""Estimates on the first axis alone, on which another source is the closest."""

ERRORS = {
    BASELINE: (0.2, 0.2),
    "even": (0.04, 0.06),
    "like-x": (0.08, 0.08),
    "like-y": (0.09, 0.09),
    BY_AXIS: (0.01, 0.03),
}


def evaluated(
    errors: dict[str, tuple[float | None, float | None]],
    ranking: tuple[SourceEstimate, ...] = RANKING,
    predicted: PredictedRms | None = None,
) -> EvaluationResult:
    psi, flights = ALGORITHM_1, records(errors)
    return summarise(
        *("target", flights, psi, "state"),
        unit="m",
        guarded=True,
        run="",
        ranking=ranking,
        predicted=predicted,
    )


def said(result: EvaluationResult) -> str:
    console = Console(width=200, record=True, file=io.StringIO())
    console.print(evaluation_table(result))
    return console.export_text()


def test_the_ranking_over_all_axes_selects_and_orders_the_sources() -> None:
    result = evaluated(dict(ERRORS))
    assert result.selected == "even"
    assert [source.robot for source in result.sources] == ["even", "like-x", "like-y"]
    even = result.sources[0]
    assert (even.psi, even.distance) == (0.13, 0.13)
    assert result.sources[1].psi == 0.02  # that of the paper's algorithm, on the first axis
    assert result.sources[1].distance == 0.28
    assert even.ranked is not None
    assert even.ranked.axes is not None
    assert even.ranked.axes["y"].psi == 0.13
    (first, *_) = compare_pairs([result], "").pairs
    assert first.psi == 0.13


def test_one_source_for_all_axes_is_compared_with_the_closest_on_each() -> None:
    result = evaluated(dict(ERRORS))
    assert result.by_axis is not None
    assert result.by_axis.sources == {"x": "like-x", "y": "like-y"}
    assert result.by_axis.rms_m == pytest.approx(0.02)
    assert result.by_axis.reduction_percent == pytest.approx(90.0)
    assert [way.way for way in result.ways] == list(ERRORS)
    assert EvaluationResult.model_validate_json(result.document()) == result
    table = said(result)
    assert (
        "one source for all axes, even: 50 mm; the closest on each axis, like-x on x, like-y on y: "
        "20 mm" in table
    )
    assert "0.280 on y" in table


def test_what_the_first_axis_alone_predicts_is_called_so() -> None:
    table = said(evaluated(dict(ERRORS)))
    assert table.count("1st axis") == 2
    assert "predicted for these paths from the first axis alone" in table


def test_errors_that_are_expected_over_all_axes_stand_beside_those_of_each_axis() -> None:
    of = {"even": 0.045, "like-x": 0.07, "like-y": 0.1}
    predicted = PredictedRms(0.21, of, ("x", "y"), by_axis=0.018)
    result = evaluated(dict(ERRORS), predicted=predicted)
    assert result.by_axis is not None
    assert result.by_axis.predicted_rms_m == 0.018
    assert (result.least_expected, result.least_expected_regret_m) == (BY_AXIS, 0.0)
    assert EvaluationResult.model_validate_json(result.document()) == result
    table = said(result)
    assert table.count("1st axis") == 1
    assert "from the first axis alone" not in table
    assert "even: 50 mm (expected 45); the closest on each axis" in table
    assert "like-y on y: 20 mm (expected 18)" in table
    assert "the tests expect the least error of by-axis, which left 0 mm more than the least" in (
        table
    )


def test_the_tests_may_expect_the_least_of_another_source_than_left_the_least() -> None:
    predicted = PredictedRms(0.21, {"even": 0.045, "like-x": 0.02}, ("x", "y"))
    result = evaluated({k: v for k, v in ERRORS.items() if k != BY_AXIS}, predicted=predicted)
    assert result.least_expected == "like-x"
    assert result.least_expected_regret_m == pytest.approx(0.08 - 0.05)
    assert [source.predicted_rms_m for source in result.sources] == [0.045, 0.02, None]
    assert result.kendall_tau_trajectory == -1.0


def test_where_axes_agree_nothing_more_is_flown_and_that_is_said() -> None:
    agreeing = (estimate("even", x=0.02, y=0.03), *RANKING[1:])
    assert held_by_axis(agreeing, list(ALGORITHM_1)) == {}
    result = evaluated({k: v for k, v in ERRORS.items() if k != BY_AXIS}, agreeing)
    assert result.by_axis is None
    assert "no axis has a closer source than even, beyond doubt" in said(result)


def test_a_source_that_the_target_cannot_hold_as_well_is_not_flown_by_axis() -> None:
    names = ["even", *(f"source-{n}" for n in range(20)), "like-x", "like-y"]
    assert held_by_axis(RANKING, names) == {}
    assert held_by_axis(RANKING, names[:1] + names[-2:]) == {"x": "like-x", "y": "like-y"}
    result = evaluated({k: v for k, v in ERRORS.items() if k != BY_AXIS})
    assert "cannot hold all of these at a time" in said(result).replace("\n", " ")


def test_each_path_is_flown_once_more_where_axes_differ() -> None:
    assert flights_planned(3, 5, 2, by_axis=True) - flights_planned(3, 5, 2) == 5


def test_a_source_that_the_ranking_lost_comes_last() -> None:
    assert order_of(ALGORITHM_1, RANKING[:1]) == ["even", "like-x", "like-y"]
    only_x = (SourceEstimate("like-y", 0.3, 0.2, 0.4, 1.0, 1),)
    assert order_of(ALGORITHM_1, only_x) == ["like-x", "even", "like-y"]
