"""Distortion that a test found, and that which its noise may hide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from nufleet.orchestrator.belief.distortion import NONLINEAR_ELSEWHERE, Distortion, of_kind
from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Finding, Quality

OMEGA = np.arange(1.0, 6.0)
Z = np.full(5, 0.8 - 0.6j)


def one_test(std: float, *findings: Finding) -> Distortion:
    variance = np.full(5, std**2)
    quality = Quality(warnings=findings)
    response = FrequencyResponse(OMEGA, Z, variance, 4, quality, amplitude=0.2)
    return Distortion.of(response, Tones(OMEGA, Z, variance))


def bent(value: float | None = None) -> Finding:
    return Finding(code="nonlinear", text="it is distorted", value=value)


def test_a_test_without_distortion_leaves_nothing_open_by_itself() -> None:
    test = one_test(0.05)
    assert test.found == 0.0
    assert test.open_share([test], 0.0) == 0.0


def test_what_a_test_found_is_left_open_also_where_an_old_one_does_not_say_how_much() -> None:
    test = one_test(0.01, bent(0.03))
    assert test.open_share([test], 0.0) == pytest.approx(NONLINEAR_ELSEWHERE * 0.03)
    old = one_test(0.01, bent())
    assert 0.0 < old.open_share([old], 0.0) < test.open_share([test], 0.0)


def test_what_others_of_its_kind_show_is_left_open_as_far_as_noise_hides_it() -> None:
    noisy, quiet = one_test(0.05), one_test(0.001)
    assert noisy.open_share([noisy], 0.04) == pytest.approx(NONLINEAR_ELSEWHERE * 0.04)
    assert quiet.open_share([quiet], 0.04) < 0.2 * noisy.open_share([noisy], 0.04)


def test_a_smaller_motion_excuses_no_larger_one() -> None:
    large, small = one_test(0.01, bent(0.03)), replace(one_test(0.01), amplitude=0.1)
    assert small.open_share([large, small], 0.0) == large.open_share([large, small], 0.0)
    larger = replace(small, amplitude=0.4)
    assert larger.open_share([large, larger], 0.0) == 0.0


def test_a_kind_is_as_distorted_as_its_robots_are_on_average() -> None:
    assert of_kind([]) == 0.0
    assert of_kind([0.0, 0.0]) == 0.0
    assert of_kind([0.06, 0.0, 0.0, 0.0]) == pytest.approx(0.03)
