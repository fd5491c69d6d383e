"""A rehearsal decides the verdict on the source whose experience was rehearsed."""

from __future__ import annotations

import pytest

from nufleet.orchestrator.study.verdict import Verdict
from nufleet.orchestrator.study.verdict_document import (
    Bounds,
    GainCurve,
    TransferVerdict,
    rehearsed,
)
from nufleet.shared.wire.motions import PredictedError

GAINS = GainCurve(low=(0.1,), median=(0.2,), high=(0.3,))
FROM_TESTS = TransferVerdict(
    verdict=Verdict.DO_NOT_TRANSFER,
    reason="the error is expected to grow by 8 % (2 to 14 %)",
    probability_helps=0.01,
    error_with=Bounds(low=0.1, median=0.1, high=0.1),
    error_without=Bounds(low=0.1, median=0.1, high=0.1),
    reduction=Bounds(low=-0.14, median=-0.08, high=-0.02),
    omega_rad_s=(1.0,),
    gain_with=GAINS,
    gain_without=GAINS,
)
BASELINE = PredictedError(rms=0.06, low=0.058, high=0.063)


def judged(rms: float, low: float, high: float) -> TransferVerdict:
    expected = PredictedError(rms=rms, low=low, high=high)
    return rehearsed(FROM_TESTS, expected, BASELINE, 0.5, "clover at 0.6 m/s")


def test_what_is_rehearsed_to_help_is_recommended_whatever_the_tests_alone_said() -> None:
    found = judged(0.015, 0.012, 0.02)
    assert found.verdict is Verdict.TRANSFER
    assert found.probability_helps > 0.99
    assert found.reduction.median == pytest.approx(0.75)
    assert 0.6 < found.reduction.low < 0.75 < found.reduction.high < 0.85
    assert found.error_with.median == pytest.approx(0.03)
    assert found.reason.startswith("the error on clover at 0.6 m/s is expected to fall by 75 % (")
    assert found.gain_with == FROM_TESTS.gain_with


def test_what_is_rehearsed_to_harm_is_advised_against() -> None:
    found = judged(0.09, 0.08, 0.1)
    assert found.verdict is Verdict.DO_NOT_TRANSFER
    assert found.probability_helps < 0.01
    assert "expected to grow by 50 %" in found.reason


def test_what_may_help_or_harm_is_left_open() -> None:
    found = judged(0.06, 0.03, 0.12)
    assert found.verdict is Verdict.NEED_MORE_TESTS
    assert found.probability_helps == pytest.approx(0.5, abs=0.02)


def test_rehearsals_that_all_end_alike_are_judged_as_well() -> None:
    exact = PredictedError(rms=0.01, low=0.01, high=0.01)
    found = rehearsed(FROM_TESTS, exact, exact, 0.5, "clover")
    assert 0.0 <= found.probability_helps <= 1.0
