"""The loop behind a simulated Crazyflie responds as it says."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.sims.crazyflies.plant import KnownLoop, LoopSettings, drift, fall

SAMPLE_S = 0.02


@pytest.mark.parametrize(
    ("delay_s", "more_s"), [(0.0, 0.0), (0.03, 0.0), (0.0, 0.013), (0.02, 0.02)]
)
def test_its_response_to_held_references_is_the_stated_one(delay_s: float, more_s: float) -> None:
    settings = LoopSettings(omega_rad_s=8.0, damping_ratio=0.5, gain=0.9, delay_s=delay_s)
    loop = KnownLoop(settings.model_copy(update={"delay_s": 0.0}), (0.0, 0.0, 0.0))
    omega = 2 * np.pi / 100 / SAMPLE_S
    whole, part_s = divmod(delay_s + more_s, SAMPLE_S)
    references = np.cos(omega * SAMPLE_S * np.arange(1000))
    outputs = np.empty(1000)
    for k in range(1000):
        outputs[k] = loop.position_m[0]
        before, now = (references[max(0, k - int(whole) - lag)] for lag in (1, 0))
        loop.follow(np.array([before, 0.0, 0.0]), np.zeros(3), part_s)
        loop.follow(np.array([now, 0.0, 0.0]), np.zeros(3), SAMPLE_S - part_s)
    turns = np.exp(-1j * omega * SAMPLE_S * np.arange(900, 1000))
    measured = 2 * np.mean(outputs[900:] * turns)
    assert measured == pytest.approx(settings.response(omega, SAMPLE_S, more_s), abs=1e-6)


def test_without_thrust_it_falls_to_the_ground_and_lies_there() -> None:
    loop = KnownLoop(LoopSettings(), (0.0, 0.0, 0.5))
    loop.velocity_m_s = np.array([1.0, 0.0, 0.0])
    fall(loop, 0.2)
    assert loop.position_m == pytest.approx([0.2, 0.0, 0.5 - 0.5 * 9.81 * 0.04])
    fall(loop, 1.0)
    assert loop.position_m[2] == 0.0
    assert not loop.velocity_m_s.any()


def test_levelled_out_it_drifts_at_its_height() -> None:
    loop = KnownLoop(LoopSettings(), (0.0, 0.0, 0.5))
    loop.velocity_m_s = np.array([1.0, 0.0, -1.0])
    drift(loop, 0.5)
    assert loop.position_m == pytest.approx([0.5, 0.0, 0.5])
