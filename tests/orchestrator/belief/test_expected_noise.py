"""How noisy a test will be, by the energy of its tones."""

from __future__ import annotations

import numpy as np
import pytest
from random_loops import SPEC

from nufleet.orchestrator.belief.expected_noise import ExpectedNoise
from nufleet.robot_agent.motion.excitation import plan_excitation
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.multitone import multitone, weights_of

QUICK, SLOW = 0.5 * np.array([3.0, 7.0, 11.0, 15.0]), 0.5 * np.array([1.0, 3.0])


def chosen_amplitude(omega_rad_s: FloatArray) -> float:
    harmonics = tuple(int(one) for one in np.round(omega_rad_s / 0.5))
    (tones,) = multitone(0.5, [harmonics], [weights_of(omega_rad_s)])
    return plan_excitation(Excitation(axis="x", tones=tones), SPEC, "robot").amplitude


def test_the_amplitude_that_a_robot_chooses_is_foreseen() -> None:
    noise = ExpectedNoise(SPEC.axes[0])
    noise.learn(QUICK, np.full(4, 1e-4), chosen_amplitude(QUICK))
    assert noise.amplitude(QUICK) == pytest.approx(chosen_amplitude(QUICK))
    assert noise.amplitude(SLOW) == pytest.approx(chosen_amplitude(SLOW), rel=0.35)
    assert chosen_amplitude(SLOW) > 1.5 * chosen_amplitude(QUICK)


def test_larger_tones_are_expected_to_be_less_noisy() -> None:
    noise = ExpectedNoise(SPEC.axes[0])
    assert not noise.known
    noise.learn(QUICK, np.full(4, 1e-4), 0.1)
    assert noise.known
    np.testing.assert_allclose(noise.variance(QUICK, 1.0, 0.1), 1e-4)
    np.testing.assert_allclose(noise.variance(QUICK, 2.0, 0.05), 2e-4)
    assert noise.variance(SLOW, 1.0)[1] < 0.4 * noise.variance(QUICK, 1.0)[0]
    noise.forget()
    assert not noise.known
