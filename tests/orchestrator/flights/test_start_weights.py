"""A mixture starts from what the ranking knows, and no experience always has a share of it."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.orchestrator.flights.start_weights import start_weights

SOURCES = ["a", "b", "c"]


def test_without_a_ranking_sources_and_none_share_equally() -> None:
    assert start_weights(SOURCES) == pytest.approx(dict.fromkeys(SOURCES, 0.25))


def test_a_source_alone_begins_with_one_half() -> None:
    for psi in (None, {"a": 0.9}, {"a": 0.01}, {"b": 0.1}):
        assert start_weights(["a"], psi) == pytest.approx({"a": 0.5})


def test_closeness_counts_as_the_inverse_square_of_the_distance() -> None:
    weights = start_weights(SOURCES, {"a": 0.1, "b": 0.2, "c": 0.4})
    assert weights["a"] == pytest.approx(4 * weights["b"]) == pytest.approx(16 * weights["c"])
    assert sum(weights.values()) == pytest.approx(0.75)


def test_a_source_that_was_not_ranked_counts_as_far_as_the_furthest() -> None:
    weights = start_weights(SOURCES, {"a": 0.1, "b": 0.3})
    assert weights["c"] == pytest.approx(weights["b"])


@given(st.dictionaries(st.sampled_from("abcdefgh"), st.floats(0.0, 1.0), min_size=1))
def test_every_source_has_some_weight_and_none_has_one_as_well(psi: dict[str, float]) -> None:
    weights = start_weights(list(psi), psi)
    assert all(weight > 0 for weight in weights.values())
    assert sum(weights.values()) == pytest.approx(len(psi) / (len(psi) + 1))
