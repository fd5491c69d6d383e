"""An error that all estimates share stays what it is, however many they are."""

from __future__ import annotations

import numpy as np
from random_loops import BAND, SPEC, Loop

from nufleet.orchestrator.belief.common_error import CommonError
from nufleet.orchestrator.belief.loop_features import ResponsePrior
from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.orchestrator.belief.response_belief import ResponseModel

GRID = np.linspace(*BAND, 20)
SIZE = 0.1
FOUND = CommonError(np.array([0.5, 5.0]), np.full(2, SIZE**2))


def test_its_samples_have_its_size_and_are_smooth() -> None:
    drawn = FOUND.draw(GRID, 4000, np.random.default_rng(0))
    np.testing.assert_allclose(np.sqrt(np.mean(np.abs(drawn) ** 2, axis=0)), SIZE, rtol=0.05)
    steps = np.sqrt(np.mean(np.abs(np.diff(drawn, axis=1)) ** 2, axis=0))
    assert float(steps.max()) < 0.25 * SIZE


def test_several_tests_are_believed_as_far_as_the_best_of_them() -> None:
    one = np.array([1.0, 3.0]), np.array([0.04, 0.01])
    other = np.array([2.0, 1.0]), np.array([0.03, 0.02])
    both = CommonError.of_tests([one, other])
    assert both is not None
    np.testing.assert_allclose(both.omega_rad_s, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(both.variance, [0.02, 0.025, 0.01])
    assert CommonError.of_tests([one, (one[0], np.zeros(2))]) is None


def test_a_fit_to_many_tones_does_not_average_it_away() -> None:
    omega, rng = np.linspace(0.5, 5.4, 40), np.random.default_rng(0)
    tones = Tones(omega, Loop(3.0).z(omega), np.full(40, 1e-6))
    prior = ResponsePrior(BAND[1], 6.9 / SPEC.settling_time_s)
    model = ResponseModel(tones, prior, common=FOUND)
    spread = np.sqrt(np.var(model.draw(GRID, 1000, rng), axis=0))
    np.testing.assert_allclose(spread[2:], SIZE, rtol=0.15)
    assert float(np.median(np.std(model.draw_fitted(GRID, 1000, rng), axis=0))) < 0.05 * SIZE
