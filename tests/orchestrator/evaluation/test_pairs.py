"""How well ψ predicts over all pairs of robots: regret, harm, and how often the best was chosen."""

from __future__ import annotations

import math

import pytest
from evaluated_flights import A, B, C, target
from scipy.stats import kendalltau

from nufleet.orchestrator.evaluation.pairs import PairsResult, compare_pairs
from nufleet.orchestrator.evaluation.report import pairs_table
from nufleet.orchestrator.evaluation.results import IntervalCoverage


def test_every_ordered_pair_is_there_with_its_share_of_the_baseline() -> None:
    result = compare_pairs([A, B, C], "runs/1")
    assert [(p.target, p.source) for p in result.pairs] == [
        *(("a", "b"), ("a", "c"), ("b", "a"), ("b", "c"), ("c", "b"), ("c", "a"))
    ]
    assert [p.ratio for p in result.pairs] == pytest.approx([0.2, 0.5, 0.6, 0.2, 0.5, 1.5])


def test_regret_is_what_the_selection_cost_in_baselines() -> None:
    result = compare_pairs([A, B, C], "runs/1")
    assert result.regret is not None
    # Selected: a loses nothing, b (0.06 - 0.02) / 0.1, c nothing.
    assert result.regret.selected == pytest.approx((0 + 0.4 + 0) / 3)
    assert result.regret.random == pytest.approx((0.03 / 0.2 + 0.02 / 0.1 + 0.2 / 0.4) / 3)
    assert result.best_selected == 2


def test_harm_is_counted_where_the_baseline_was_better() -> None:
    assert compare_pairs([A, B, C], "runs/1").harmful == 1


def test_orders_are_compared_for_each_target_and_over_all_pairs() -> None:
    result = compare_pairs([A, B, C], "runs/1")
    assert result.kendall_tau == pytest.approx((1 - 1 + 1) / 3)
    psi, ratio = [p.psi for p in result.pairs], [p.ratio for p in result.pairs]
    assert result.kendall_tau_pooled == pytest.approx(kendalltau(psi, ratio).statistic)


def test_a_source_that_did_not_finish_is_harmful_and_costs_two_baselines() -> None:
    fallen = target("a", 0.2, {"b": (0.1, None), "c": (0.3, 0.1)})
    result = compare_pairs([fallen], "runs/1")
    assert result.harmful == 1
    assert result.pairs[0].ratio is None
    assert result.regret is not None
    assert result.regret.selected == pytest.approx((0.4 - 0.1) / 0.2)
    assert result.best_selected == 0


def test_not_to_finish_is_never_better_than_the_worst_that_did() -> None:
    worse = target("a", 0.2, {"b": (0.1, None), "c": (0.3, 0.9)})
    result = compare_pairs([worse], "runs/1")
    assert result.best_selected == 0
    assert result.regret is not None
    assert result.regret.selected >= 0.0


def test_where_no_source_finished_none_was_the_best() -> None:
    fallen = target("a", 0.2, {"b": (0.1, None), "c": (0.3, None)})
    assert compare_pairs([fallen], "runs/1").best_selected == 0


def test_a_target_without_a_baseline_is_left_out_of_the_regret() -> None:
    unknown = target("d", None, {"a": (0.1, 0.3), "b": (0.2, 0.1)})
    with_it, without = (compare_pairs(all_of, "r") for all_of in ([A, B, C, unknown], [A, B, C]))
    assert with_it.regret == without.regret
    assert all(pair.ratio is None and pair.harmful for pair in with_it.pairs[-2:])
    alone = compare_pairs([unknown], "r")
    assert alone.regret is None


def test_the_table_shows_all_pairs_also_where_nothing_can_be_compared() -> None:
    from rich.console import Console

    for targets in ([A, B, C], [target("d", None, {"a": (0.1, None)})]):
        console = Console(record=True, width=200)
        console.print(pairs_table(compare_pairs(targets, "r")))
        text = console.export_text()
        assert all(one.target in text for one in targets)
        assert ("regret" in text) == (len(targets) == 3)


def test_the_document_is_read_back_as_it_was_written() -> None:
    result = compare_pairs([A, B, C], "runs/1")
    assert PairsResult.model_validate_json(result.document()) == result
    assert not math.isnan(result.kendall_tau or 0.0)


def test_the_ways_that_the_predictions_choose_are_judged_by_their_regret() -> None:
    counted = {"own": IntervalCoverage(flights=4, inside=3)}
    a = A.model_copy(update={"chosen_way": "own", "regret_m": 0.01, "coverage": counted})
    b = B.model_copy(
        update={
            "chosen_way": "a",
            "regret_m": 0.04,
            "coverage": counted,
            "worse_than_baseline": 3,
            "chosen_worse_than_baseline": 1,
        }
    )
    result = compare_pairs([a, b, C], "runs/1")
    chosen = result.chosen
    assert chosen is not None
    assert chosen.ways == {"a": "own", "b": "a"}
    assert (chosen.regret, chosen.regret_max) == pytest.approx(((0.05 + 0.4) / 2, 0.4))
    assert (chosen.worse_than_baseline, result.worse_than_baseline) == (1, 3)
    assert (result.coverage.inside, result.coverage.flights) == (6, 8)
    assert "6 of 8 errors" in str(pairs_table(result).caption)
    assert compare_pairs([A, B, C], "runs/1").chosen is None
