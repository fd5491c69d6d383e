"""Several experiences in front of a robot: who is wrong has no say, and none is one of them."""

from __future__ import annotations

import numpy as np
import pytest
from learned_things import layout

from nufleet.robot_agent.flight.mixture_process import Expert, MixtureProcess
from nufleet.robot_agent.flight.online_gp import OnlineGp
from nufleet.robot_agent.flight.tracking import PAIR_SPACING_S
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.combined_layout import CombinedLayout

LAYOUT = layout("state")
LONGER = layout("state", horizon_samples=30)
INPUTS = len(LAYOUT.input_names)
GAMMA_STD = 0.02  # of the references' speed that the noise of the states leaves, in unit/s
PAIRS_IN_3_S = int((3.0 - 1.2 * LAYOUT.horizon_s) / PAIR_SPACING_S)
"""Pairs that a robot has seen 3 s after its start, of which each is known a horizon later."""


def truth(inputs: FloatArray) -> FloatArray:
    return np.asarray(inputs @ np.array([0.8, -0.5, 0.3, 0.6]))


def off(by: float, inputs: FloatArray) -> FloatArray:
    return np.asarray(truth(inputs) + by * (inputs[:, 0] - inputs[:, 2]))


def expert(name: str, by: float, weight: float, axes: tuple[bool, ...] = (True, True)) -> Expert:
    return Expert(name, LAYOUT, lambda inputs: off(by, inputs), weight, axes)


def of_gain(name: str, gain: float, weight: float) -> Expert:
    return Expert(name, LAYOUT, lambda inputs: gain * truth(inputs), weight, (True, True))


def along_a_path(steps: int, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Inputs of two axes a pair apart, shape (steps, 2, inputs), and their γ, shape (steps, 2)."""
    rng = np.random.default_rng(seed)
    time_s = PAIR_SPACING_S * np.arange(steps)[:, np.newaxis, np.newaxis]
    omega = rng.uniform(0.5, 2.5, (1, 2, INPUTS))
    inputs = 0.4 * np.sin(omega * time_s + rng.uniform(0, 6, (1, 2, INPUTS)))
    noise = GAMMA_STD * rng.standard_normal((steps, 2))
    return inputs, truth(inputs.reshape(-1, INPUTS)).reshape(steps, 2) + noise


def taught(process: MixtureProcess, steps: int, seed: int = 0) -> FloatArray:
    """Fly a path; return the weights after each pair, shape (steps, experts + 1)."""
    weights = []
    for inputs, gamma in zip(*along_a_path(steps, seed), strict=True):
        for axis in range(2):
            process.learn(axis, inputs[axis], float(gamma[axis]))
        weights.append(process.correct(inputs).weights)
    return np.array(weights)


def mixture(*experts: Expert, window: int = 50) -> MixtureProcess:
    return MixtureProcess(CombinedLayout([each.layout for each in experts]), experts, window=window)


def test_before_anything_was_flown_it_is_the_mean_by_the_weights_of_the_start() -> None:
    process = mixture(expert("a", 0.0, 0.5), expert("b", 1.0, 0.3))
    inputs = along_a_path(1)[0][0]
    found = process.correct(inputs)
    np.testing.assert_allclose(found.gamma, 0.5 * truth(inputs) + 0.3 * off(1.0, inputs))
    np.testing.assert_allclose(found.weights, [0.5, 0.3, 0.2])


@pytest.mark.parametrize("seed", range(5))
def test_a_source_that_does_harm_has_gone_within_3_s_and_the_right_one_flies(seed: int) -> None:
    process = mixture(of_gain("reversed", -1.0, 0.5), expert("right", 0.0, 0.3))
    weights = taught(process, PAIRS_IN_3_S, seed)
    assert weights[-1, 0] < 0.01
    assert weights[-1, 1] > 0.85
    np.testing.assert_allclose(weights.sum(axis=1), 1.0)


@pytest.mark.parametrize("seed", range(5))
def test_where_every_source_does_harm_none_flies_within_3_s(seed: int) -> None:
    process = mixture(of_gain("reversed", -1.0, 0.3), of_gain("more so", -2.0, 0.3))
    assert taught(process, PAIRS_IN_3_S, seed)[-1, -1] > 0.98


@pytest.mark.parametrize("seed", range(5))
def test_a_source_that_exaggerates_is_shrunk_to_what_helps(seed: int) -> None:
    process = mixture(of_gain("three times", 3.0, 0.5))
    assert taught(process, PAIRS_IN_3_S, seed)[-1, 0] == pytest.approx(1 / 3, abs=0.05)


def test_the_process_learns_what_the_present_mixture_leaves() -> None:
    """Where nearly all the weight is one expert's, it is the process with this prior."""
    process = mixture(expert("near", 0.1, 1 - 1e-6))
    alone = OnlineGp(LAYOUT, (lambda x: off(0.1, x),) * 2)
    taught(process, 60)
    steps = list(zip(*along_a_path(60), strict=True))
    for inputs, gamma in steps:
        for axis in range(2):
            alone.learn(axis, inputs[axis], float(gamma[axis]))
        expected = alone.correct(inputs)
    found = process.correct(steps[-1][0])
    assert found.weights[0] > 0.999
    np.testing.assert_allclose(found.gamma, expected.gamma, atol=1e-3)


def test_the_order_of_the_experts_does_not_matter() -> None:
    several = [expert("a", 0.3, 0.3), expert("b", -0.4, 0.3), expert("c", 1.0, 0.2)]
    one, other = taught(mixture(*several), 15), taught(mixture(*several[::-1]), 15)
    np.testing.assert_allclose(one[:, :3], other[:, 2::-1], atol=1e-6)


def test_an_expert_speaks_only_for_the_axes_it_was_learned_on() -> None:
    process = mixture(expert("x alone", 0.0, 0.5, axes=(True, False)))
    inputs = along_a_path(1)[0][0]
    np.testing.assert_allclose(process.correct(inputs).prior, [0.5 * truth(inputs)[0], 0.0])


def test_an_expert_of_another_horizon_is_asked_with_its_own_inputs() -> None:
    def heads_straight(inputs: FloatArray) -> FloatArray:
        return np.zeros(len(inputs))

    leading = Expert("a", LAYOUT, truth, 0.4, (True,))
    longer = Expert("b", LONGER, heads_straight, 0.4, (True,))
    process = mixture(leading, longer)
    inputs = np.random.default_rng(0).standard_normal((1, 2 * INPUTS))
    ahead, previous = LAYOUT.input_names.index("output-ahead"), INPUTS - 1
    short, long = inputs[0, :INPUTS], inputs[0, INPUTS:]
    # Both say a speed of the reference: the longer horizon's, as γ of the shorter one.
    speed = (long[ahead] - long[previous]) / LONGER.horizon_s
    gamma = speed - (short[ahead] - short[previous]) / LAYOUT.horizon_s
    expected = 0.4 * truth(short[np.newaxis]) + 0.4 * gamma
    np.testing.assert_allclose(process.correct(inputs).prior, expected)


@pytest.mark.parametrize("nothing", [np.nan, np.inf])
def test_an_expert_without_a_finite_answer_says_what_none_says(nothing: float) -> None:
    broken = Expert("broken", LAYOUT, lambda x: np.full(len(x), nothing), 0.3, (True, True))
    weights = taught(mixture(broken, expert("right", 0.0, 0.3)), 20)
    silent = taught(mixture(of_gain("silent", 0.0, 0.3), expert("right", 0.0, 0.3)), 20)
    np.testing.assert_allclose(weights, silent, atol=1e-9)


def test_a_pair_that_is_not_finite_is_dropped_and_counted() -> None:
    process = mixture(expert("a", 0.0, 0.5))
    inputs = along_a_path(1)[0][0]
    process.learn(0, np.full(INPUTS, np.nan), 0.0)
    process.learn(1, inputs[1], np.inf)
    assert process.dropped == 2
    np.testing.assert_allclose(process.correct(inputs).weights, [0.5, 0.5])


def test_inputs_that_are_not_finite_give_no_correction() -> None:
    process = mixture(expert("a", 0.0, 0.5))
    inputs = along_a_path(1)[0][0]
    inputs[0, 1] = np.nan
    found = process.correct(inputs)
    assert found.gamma[0] == 0.0
    assert found.gamma[1] != 0.0


def test_without_learning_the_weights_stay_as_they_were_given() -> None:
    weights = taught(mixture(expert("a", 2.0, 0.5), window=0), 10)
    np.testing.assert_array_equal(weights, np.full((10, 2), 0.5))
