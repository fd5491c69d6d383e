"""A simulator is compared with a robot in numbers, and the difference is told in words."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.orchestrator.study.simulator_match import (
    Difference,
    SimulatorMatch,
    match_simulator,
)
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Quality

OMEGA = np.geomspace(0.5, 9.0, 24)


def loop(
    omega: FloatArray, *, gain: float = 1.0, delay_s: float = 0.0, stiffness: float = 1.0
) -> ComplexArray:
    """A mass on a spring and a damper of fixed damping ratio, behind a delay."""
    s = 1j * omega / (6.0 * np.sqrt(stiffness))
    return np.asarray(gain * np.exp(-1j * omega * delay_s) / (s**2 + 1.4 * s + 1))


def response_of(
    z: ComplexArray, *, std: float = 1e-3, seed: int = 0, omega: FloatArray = OMEGA
) -> FrequencyResponse:
    rng = np.random.default_rng(seed)
    noise = std / np.sqrt(2) * (rng.standard_normal(len(z)) + 1j * rng.standard_normal(len(z)))
    return FrequencyResponse(
        omega_rad_s=omega,
        z=z + noise,
        variance=np.full(len(z), std**2),
        segments=4,
        quality=Quality(),
    )


def matched(std: float = 1e-3, seed: int = 0, **robot: float) -> SimulatorMatch:
    own = response_of(loop(OMEGA, **robot), std=std, seed=2 * seed)
    return match_simulator("sim", [own], [response_of(loop(OMEGA), std=std, seed=2 * seed + 1)])


def test_delay_gain_and_stiffness_are_recovered() -> None:
    found = matched(std=1e-4, gain=1.03, delay_s=0.012, stiffness=1.08)
    assert found.delay_s is not None
    assert found.gain is not None
    assert found.stiffness is not None
    assert found.delay_s.value == pytest.approx(0.012, abs=0.002)
    assert found.gain.value == pytest.approx(0.03, abs=0.005)
    assert found.stiffness.value == pytest.approx(0.08, abs=0.01)
    assert found.psi_explained is not None
    assert found.psi_explained < 0.2 * found.psi
    assert found.words == (
        "the robot answers 12 ms later, is 8 % stiffer and moves 3 % more than sim"
    )


def test_a_difference_of_another_kind_is_not_told_as_delay_and_stiffness() -> None:
    s = 1j * OMEGA / 6.0
    flexible = loop(OMEGA) * (1 + 0.3 * s**2 / (s**2 + 0.02 * s + 0.25))
    found = match_simulator("sim", [response_of(flexible)], [response_of(loop(OMEGA), seed=1)])
    assert found.psi_explained is not None
    assert found.psi_explained > 0.5 * found.psi
    assert found.words.startswith("the robot differs from sim in another way than by a delay")


def test_the_distance_is_that_of_the_responses_with_an_interval() -> None:
    truth = chordal_distance(loop(OMEGA, delay_s=0.02), loop(OMEGA))
    hits = 0
    for seed in range(40):
        found = matched(delay_s=0.02, seed=seed, std=0.004)
        hits += found.psi_low <= truth.max() <= found.psi_high
        assert len(found.tones) == len(OMEGA)
    assert hits >= 35
    assert found.omega_rad_s == pytest.approx(OMEGA[truth.argmax()], rel=0.5)


def test_differences_are_claimed_by_chance_as_rarely_as_their_deviations_say() -> None:
    found = [matched(seed=seed, std=0.003) for seed in range(40)]
    claims = [
        one
        for match in found
        for one in (match.delay_s, match.gain, match.stiffness)
        if one is not None and one.significant
    ]
    assert len(claims) <= 0.05 * 120 + 3 * np.sqrt(120 * 0.05)
    assert "no delay, gain or stiffness differs" in {one.words.partition(" by")[0] for one in found}


def test_a_robot_that_is_softer_and_earlier_is_told_so() -> None:
    assert "earlier" in matched(delay_s=-0.015).words
    assert "softer" in matched(stiffness=0.8).words
    assert "% less" in matched(gain=0.9).words


def test_a_difference_of_another_kind_is_not_explained_away() -> None:
    other = 1 / ((1j * OMEGA / 3) ** 2 + 0.3 * (1j * OMEGA / 3) + 1)
    found = match_simulator("sim", [response_of(other)], [response_of(loop(OMEGA))])
    assert found.psi_explained is not None
    assert found.psi_explained > 0.1


def test_few_tones_give_a_distance_alone_and_no_common_tone_nothing() -> None:
    few = OMEGA[:3]
    robot, sim = response_of(loop(few, gain=1.2), omega=few), response_of(loop(few), omega=few)
    found = match_simulator("sim", [robot], [sim])
    assert (found.delay_s, found.psi_explained) == (None, None)
    assert "at least 5" in found.words
    with pytest.raises(StudyError, match="no tone in common"):
        match_simulator("sim", [robot], [response_of(loop(OMEGA[5:]), omega=OMEGA[5:])])


def test_repeated_tests_are_averaged() -> None:
    again = [response_of(loop(OMEGA, delay_s=0.02), seed=seed, std=0.01) for seed in range(16)]
    sims = [response_of(loop(OMEGA), seed=100 + seed, std=0.01) for seed in range(16)]
    one, many = match_simulator("s", again[:1], sims[:1]), match_simulator("s", again, sims)
    assert many.tones[-1].psi_std == pytest.approx(one.tones[-1].psi_std / 4, rel=0.1)


def test_a_match_survives_json() -> None:
    found = matched(delay_s=0.01)
    assert SimulatorMatch.model_validate_json(found.model_dump_json()) == found
    assert Difference(value=0.1, std=0.06).significant is False
