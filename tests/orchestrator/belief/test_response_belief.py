"""The belief about a response: is it right, does it know how wrong it may be?"""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from nufleet.orchestrator.belief.loop_features import ResponsePrior, response
from nufleet.orchestrator.belief.loop_fit import Tones, fit_from
from nufleet.orchestrator.belief.response_belief import ResponseModel
from nufleet.shared.arrays import ComplexArray, FloatArray

BAND = (0.1, 5.4)
GRID = np.linspace(*BAND, 60)
PRIOR = ResponsePrior(omega_max_rad_s=5.4, decay_min_1_s=0.3)
COMB = np.linspace(1.2, 5.4, 7)


def random_loop(rng: np.random.Generator, *, mode: bool) -> FloatArray:
    loop = [
        rng.uniform(0.8, 1.2),
        rng.uniform(0.0, 1.0),
        np.log(rng.uniform(1.5, 5.0)),
        np.log(rng.uniform(0.3, 1.0)),
        rng.uniform(0.0, 0.2),
    ]
    if mode:
        omega, decay = rng.uniform(1.5, 5.0), rng.uniform(0.4, 0.6)
        loop += [rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), np.log(omega)]
        loop.append(np.log(decay / omega))
    return np.array(loop)


def measured(
    theta: FloatArray, omega: FloatArray, deviation: float, rng: np.random.Generator
) -> Tones:
    error = deviation * (rng.standard_normal((2, len(omega))) / np.sqrt(2))
    z = response(theta, omega) + error[0] + 1j * error[1]
    return Tones(omega, z, np.full(len(omega), deviation**2))


def disc(samples: ComplexArray) -> tuple[ComplexArray, FloatArray]:
    centre = samples.mean(axis=0)
    return centre, np.quantile(np.abs(samples - centre), 0.95, axis=0)


@pytest.mark.thorough
@pytest.mark.parametrize(("mode", "tones"), [(False, 7), (True, 12)])
@pytest.mark.parametrize("deviation", [0.003, 0.02])
def test_discs_of_95_percent_hold_the_truth_about_so_often(
    mode: bool, tones: int, deviation: float
) -> None:
    rng = np.random.default_rng([tones, int(1e3 * deviation)])
    held = []
    for _ in range(40):
        theta = random_loop(rng, mode=mode)
        data = measured(theta, np.linspace(1.0, 5.4, tones), deviation, rng)
        centre, radius = disc(ResponseModel(data, PRIOR).draw(GRID, 300, rng))
        held.append(np.mean(np.abs(response(theta, GRID) - centre) <= radius))
    # The mean of 40 robots, whose points are all but equally right, has a deviation of about 0.02.
    assert 0.89 <= float(np.mean(held)) <= 1.0


@pytest.mark.thorough
def test_discs_hold_the_truth_where_something_decays_slowly_between_few_tones() -> None:
    rng = np.random.default_rng(1)
    grid = np.linspace(*BAND, 107)
    few_rad_s = np.linspace(0.49, 5.4, 6)
    held: dict[bool, list[float]] = {True: [], False: []}
    for _ in range(40):
        omega, damping = rng.uniform(0.2, 1.4), rng.uniform(0.05, 0.2)
        height = rng.uniform(0.1, 0.5) * rng.choice([-1, 1])
        mode = [height, 0.0, np.log(omega), np.log(damping)]
        theta = np.concatenate([random_loop(rng, mode=False), mode])
        data = measured(theta, few_rad_s, 0.02, rng)
        for known, shares in held.items():
            prior = ResponsePrior(BAND[1], omega * damping, measured=known)
            centre, radius = disc(ResponseModel(data, prior).draw(grid, 300, rng))
            inside = np.abs(response(theta, grid) - centre) <= radius
            shares.append(float(np.mean(inside)))
    assert np.mean(held[True]) >= 0.89
    # A stated settling time as long does not say that there is anything but the loop.
    assert np.mean(held[True]) > np.mean(held[False])


def test_one_short_comb_of_tones_knows_the_whole_band_to_a_few_percent() -> None:
    rng = np.random.default_rng(3)
    errors = []
    for _ in range(20):
        theta = random_loop(rng, mode=False)
        model = ResponseModel(measured(theta, COMB, 0.01, rng), PRIOR)
        centre, _ = disc(model.draw(GRID, 300, rng))
        errors.append(float(np.max(np.abs(centre - response(theta, GRID)))))
    assert np.median(errors) < 0.03


def test_more_tones_leave_less_uncertainty() -> None:
    rng = np.random.default_rng(4)
    theta = random_loop(rng, mode=False)
    few, many = (
        ResponseModel(measured(theta, np.linspace(1.0, 5.4, n), 0.01, rng), PRIOR) for n in (4, 30)
    )
    assert np.median(disc(many.draw(GRID, 300, rng))[1]) < 0.6 * np.median(
        disc(few.draw(GRID, 300, rng))[1]
    )


def test_a_narrow_resonance_that_could_hide_between_tones_is_not_ruled_out() -> None:
    rng = np.random.default_rng(5)
    theta = random_loop(rng, mode=False)
    quick, slow = (ResponsePrior(5.4, decay_min_1_s=decay) for decay in (2.0, 0.03))
    data = measured(theta, COMB, 0.02, rng)
    chances = []
    for prior in (quick, slow):
        samples = ResponseModel(data, prior).draw(np.linspace(*BAND, 400), 3000, rng)
        farthest = np.max(np.abs(samples - samples.mean(axis=0)), axis=1)
        chances.append(float(np.mean(farthest > 0.1)))
    assert chances[0] < 0.001
    assert 0.003 < chances[1] < 0.3


def test_a_single_tone_says_little_of_the_rest_of_the_band() -> None:
    rng = np.random.default_rng(6)
    data = Tones(np.array([2.0]), np.array([0.9 - 0.4j]), np.array([1e-4]))
    _, radius = disc(ResponseModel(data, PRIOR).draw(np.array([2.0, 5.0]), 500, rng))
    assert radius[0] < 0.05
    assert radius[1] > 0.3


def test_exact_measurements_are_reproduced() -> None:
    rng = np.random.default_rng(7)
    theta = random_loop(rng, mode=False)
    data = Tones(COMB, response(theta, COMB), np.full(len(COMB), 1e-10))
    samples = ResponseModel(data, PRIOR).draw(COMB, 200, rng)
    np.testing.assert_allclose(samples, np.tile(data.z, (200, 1)), atol=1e-4)


def test_a_contradictory_prior_does_not_hide_what_was_measured() -> None:
    rng = np.random.default_rng(8)
    data = Tones(COMB, np.full(len(COMB), -3.0 + 2.0j), np.full(len(COMB), 1e-4))
    centre, _ = disc(ResponseModel(data, PRIOR).draw(COMB, 200, rng))
    np.testing.assert_allclose(centre, data.z, atol=0.05)


@pytest.mark.thorough
@pytest.mark.parametrize("mode", [False, True])
def test_the_search_ends_as_low_as_scipys(mode: bool) -> None:
    rng = np.random.default_rng(9)
    mean, std = PRIOR.loop()
    if mode:
        at, spread = PRIOR.mode(3.0, 0.1)
        mean, std = np.concatenate([mean, at]), np.concatenate([std, spread])
    for _ in range(5):
        data = measured(random_loop(rng, mode=mode), GRID, 0.005, rng)
        starts = np.tile(mean, (6, 1))
        starts[:, 2] = np.log(np.geomspace(1.0, 8.0, 6))

        def deviations(theta: FloatArray, data: Tones = data) -> FloatArray:
            misfit = data.whiten(response(theta, data.omega_rad_s) - data.z)
            return np.concatenate([misfit, (theta - mean) / std])

        _, cost = fit_from(starts, data, mean, std)
        oracle = min(least_squares(deviations, start).cost for start in starts)
        assert cost.min() <= oracle + 0.5
