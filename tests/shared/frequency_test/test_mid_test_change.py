"""A robot that becomes another one in the middle of a test is told from one that is not linear."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from benchmarks.nonlinear_loop import NonlinearLoop, play
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.shared.frequency_test.multitone import multitone
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

SPEC = RobotSpec(
    kind="loaded",
    axes=(AxisSpec(name="x", unit="m", amplitude_max=0.5, velocity_max=1, acceleration_max=4),),
    sample_time_s=0.02,
    omega_min_rad_s=0.05,
    omega_max_rad_s=20.0,
    duration_max_s=1800.0,
    settling_time_s=2.0,
    simulated=False,
)
HARMONICS = (1, 3, 5, 7, 9, 11)
LOW_HARMONICS = (1, 3, 5, 7, 9, 11, 13, 15, 18, 21, 25)
(TONES,) = multitone(5.4 / 11, (HARMONICS,), (np.ones(6),))
PLAN = plan_excitation(Excitation(axis="x", tones=TONES, segments=3), SPEC, "robot")


def played(
    after: float, share: float, noise_m: float, memory: float, seed: int
) -> FrequencyResponse:
    """Return what is estimated of a robot whose gain of 1 changes in a share of the test."""
    reference = reference_of(PLAN)
    moment = PLAN.first_measured_sample + int(share * PLAN.segments * PLAN.segment_samples)
    gain = np.where(np.arange(len(reference)) < moment, 1.0, after)
    drawn = np.random.default_rng(seed).standard_normal(len(reference) + 500)
    noise = lfilter([1.0], [1.0, -memory], drawn)[500:]
    output = gain * reference + noise_m * noise / float(np.std(noise))
    return estimate_frequency_response(reference, output, PLAN)


@pytest.mark.parametrize(
    ("share", "noise_m"), [(0.25, 0.003), (0.5, 0.003), (0.75, 0.003), (0.5, 0.012)]
)
def test_a_payload_that_drops_is_named_with_the_moment(share: float, noise_m: float) -> None:
    found = played(0.7, share, noise_m, 0.0, 0)
    assert not found.quality.usable
    (finding,) = [one for one in found.quality.reasons if one.code == "changed"]
    assert "as with a payload that drops" in finding.text
    assert finding.value is not None
    assert 0.1 < finding.value < 0.35
    at_s = share * PLAN.segments * PLAN.segment_samples * PLAN.sample_time_s
    said_s = float(finding.text.split("about ")[1].split(" s into")[0])
    assert said_s == pytest.approx(at_s, abs=0.6)


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.99, 0.999])
def test_noise_of_any_colour_is_no_change(memory: float) -> None:
    for seed in range(12):
        found = played(1.0, 0.5, 0.03, memory, seed)
        assert "changed" not in {one.code for one in found.quality.reasons}


@pytest.mark.parametrize(
    "loop",
    [
        NonlinearLoop(2.9, 0.6, 0.2, 0.05, friction_m_s2=0.15),
        NonlinearLoop(4.0, 0.5, 0.1, 0.0, dead_zone_m_s2=0.2),
    ],
)
def test_what_is_not_linear_at_a_small_amplitude_is_no_change(loop: NonlinearLoop) -> None:
    (tones,) = multitone(0.2, (LOW_HARMONICS,), (np.array(LOW_HARMONICS) ** -0.5,))
    small = Excitation(axis="x", tones=tones, segments=3, amplitude=0.09)
    plan = plan_excitation(small, SPEC, "robot")
    reference = reference_of(plan)
    for seed in range(3):
        noise = 0.003 * np.random.default_rng(seed).standard_normal(len(reference))
        output = play(loop, reference, SPEC.sample_time_s) + noise
        found = estimate_frequency_response(reference, output, plan)
        assert "changed" not in {one.code for one in found.quality.reasons}
