"""What is not linear in a robot shows at the lines between and beyond the tones of its test."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.shared.frequency_test.multitone import multitone
from nufleet.shared.frequency_test.nonlinearity import nonlinearity_of
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

SPEC = RobotSpec(
    kind="bent",
    axes=(AxisSpec(name="x", unit="m", amplitude_max=0.5, velocity_max=1, acceleration_max=4),),
    sample_time_s=0.02,
    omega_min_rad_s=0.05,
    omega_max_rad_s=20.0,
    duration_max_s=1800.0,
    settling_time_s=2.0,
    simulated=False,
)
HARMONICS = (1, 3, 5, 7, 9, 11)
NOISE_M = 0.001


def slack(reference: FloatArray, width: float) -> FloatArray:
    output, at = np.empty(len(reference)), 0.0
    for k, wanted in enumerate(reference.tolist()):
        at = min(max(at, wanted - width / 2), wanted + width / 2)
        output[k] = at
    return output


def response_of(
    move: Callable[[FloatArray], FloatArray],
    seed: int = 0,
    harmonics: tuple[int, ...] = HARMONICS,
    memory: float = 0.0,
) -> FrequencyResponse:
    weights = np.array(harmonics, dtype=np.float64) ** -0.5
    (tones,) = multitone(5.4 / 11, (harmonics,), (weights,))
    plan = plan_excitation(Excitation(axis="x", tones=tones, segments=3), SPEC, "robot")
    reference = reference_of(plan)
    drawn = np.random.default_rng(seed).standard_normal(len(reference))
    noise = lfilter([1.0], [1.0, -memory], drawn)
    output = move(reference) + NOISE_M * noise / float(np.std(noise))
    return estimate_frequency_response(reference, output, plan)


def distortion(measured: FrequencyResponse) -> float:
    found = [one.value for one in measured.quality.warnings if one.code == "nonlinear"]
    return found[0] or 0.0 if found else 0.0


@pytest.mark.parametrize("harmonics", [HARMONICS, (2, 4, 6, 8, 10, 12)])
def test_slack_which_falls_on_the_tones_shows_on_the_lines_beyond_them(
    harmonics: tuple[int, ...],
) -> None:
    loose = response_of(lambda r: slack(r, 0.02), harmonics=harmonics)
    share = distortion(loose)
    other = response_of(lambda r: slack(r, 0.02 * 1e-6), harmonics=harmonics)
    changed = float(np.sqrt(np.mean(np.abs(loose.z - other.z) ** 2)))
    assert share > 0.01
    assert changed / 10 < share < changed
    assert distortion(other) == 0.0


@pytest.mark.parametrize("memory", [0.0, 0.98])
def test_noise_hardly_ever_passes_for_it(memory: float) -> None:
    found = [distortion(response_of(lambda r: r, seed, memory=memory)) for seed in range(30)]
    assert found.count(0.0) >= 29


def test_one_tone_does_not_tell_which_nonlinearity_it_is() -> None:
    assert nonlinearity_of(np.array([0.8 - 0.1j]), np.array([0.9 + 0.1j])) is None
