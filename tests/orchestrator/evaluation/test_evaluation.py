"""What an evaluation makes of its flights: means, reductions, the worst path, and the order."""

from __future__ import annotations

import math

import numpy as np
import pytest
from evaluated_flights import ERRORS, PSI, record, records, summed
from flown_paths import flight, line
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kendalltau

from nufleet.orchestrator.evaluation.comparison import Psi
from nufleet.orchestrator.evaluation.fly_target import flight_record
from nufleet.orchestrator.evaluation.results import EvaluationResult
from nufleet.orchestrator.flights.labels import BASELINE, NO_PRIOR
from nufleet.orchestrator.flights.legs import Leg
from nufleet.shared.wire.motions import TakenBack


def test_errors_are_averaged_over_the_paths_and_compared_with_the_baseline() -> None:
    result = summed(records(ERRORS))
    assert result.baseline.rms_m == pytest.approx(0.3)
    near = result.sources[0]
    assert near.robot == result.selected == "near"
    assert near.rms_m == pytest.approx(0.06)
    assert near.reduction_percent == pytest.approx(80.0)
    assert near.worst_ratio == pytest.approx(0.25)
    assert result.no_prior.reduction_percent == pytest.approx(100 * (1 - 0.25 / 0.3))
    assert (near.psi, near.psi_std) == (0.1, 0.01)


def test_sources_stand_in_the_order_of_their_distance_whatever_they_did() -> None:
    shuffled = {name: PSI[name] for name in ("far", "near", "middle")}
    result = summed(records(ERRORS), shuffled)
    assert [source.robot for source in result.sources] == ["near", "middle", "far"]


def test_the_worst_path_counts_and_not_the_mean() -> None:
    result = summed(records(ERRORS))
    far = result.sources[2]
    assert far.reduction_percent is not None
    assert far.reduction_percent > 0
    assert far.worst_ratio == pytest.approx(1.5)


def test_an_inverse_that_did_not_finish_has_no_mean_and_ranks_last() -> None:
    result = summed(records(ERRORS | {"near": (0.01, None)}))
    near = result.sources[0]
    assert (near.rms_m, near.reduction_percent, near.worst_ratio) == (None, None, None)
    assert result.kendall_tau == pytest.approx(
        float(kendalltau([1, 2, 3], [math.inf, 0.15, 0.2]).statistic)
    )


def test_a_baseline_that_did_not_finish_leaves_nothing_to_compare_with() -> None:
    """Its mean over one path says nothing about errors over two."""
    result = summed(records(ERRORS | {BASELINE: (0.2, None)}))
    assert result.baseline.rms_m is None
    for inverse in (result.no_prior, *result.sources):
        assert inverse.rms_m is not None
        assert (inverse.reduction_percent, inverse.worst_ratio) == (None, None)


def test_priors_that_were_taken_back_are_counted() -> None:
    flights = [
        *records({name: both for name, both in ERRORS.items() if name != "far"}),
        record("far", "clover", 0.3, taken_back="worse than the baseline"),
        record("far", "pear", 0.1),
    ]
    assert [source.taken_back for source in summed(flights).sources] == [0, 0, 1]


def test_one_source_has_no_order() -> None:
    only = {"near": PSI["near"]}
    assert summed(records(ERRORS), only).kendall_tau is None


def test_an_inverse_that_nobody_flew_has_no_result() -> None:
    flights = records({name: both for name, both in ERRORS.items() if name != NO_PRIOR})
    result = summed(flights)
    assert result.no_prior.rms_m is None
    assert result.no_prior.worst_ratio is None


def test_the_document_is_read_back_as_it_was_written() -> None:
    result = summed(records(ERRORS), unit="rad")
    assert result.unit == "rad"
    assert EvaluationResult.model_validate_json(result.document()) == result


@given(
    st.lists(st.floats(1e-3, 1e3), min_size=2, max_size=7, unique=True),
    st.randoms(use_true_random=False),
)
def test_errors_in_the_order_of_the_distances_have_a_tau_of_one(
    errors: list[float], random: object
) -> None:
    ordered = sorted(errors)
    names = [f"source-{k}" for k in range(len(ordered))]
    psi = {name: Psi(0.1 * k, 0.0) for k, name in enumerate(names)}
    flights = records(
        {BASELINE: (1.0, 1.0)}
        | {name: (error, error) for name, error in zip(names, ordered, strict=True)}
    )
    assert summed(flights, psi).kendall_tau == pytest.approx(1.0)
    backwards = {name: Psi(-value.mean, 0.0) for name, value in psi.items()}
    assert summed(flights, backwards).kendall_tau == pytest.approx(-1.0)


def test_a_record_says_how_a_flight_went() -> None:
    desired = line(50, 2)
    leg = Leg("clover", 0.6, "m", desired)
    flown = flight_record(flight(desired, desired + np.array([0.03, 0.04])), "near", leg)
    assert flown.rms_m == pytest.approx(0.05)
    assert (flown.drawing, flown.speed_m_s, flown.inverse) == ("clover", 0.6, "near")
    event = TakenBack(sample=3, reason="it oscillates")
    failed = flight_record(
        flight(desired, desired, failure="it fell over", taken_back=event), "near", leg
    )
    assert (failed.rms_m, failed.failure, failed.taken_back) == (
        *(None, "it fell over", "it oscillates"),
    )
