"""Does a test contradict the earlier ones, and by how much?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nufleet.orchestrator.belief.contradiction import Miss, miss_at_same_tones, miss_of
from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.orchestrator.belief.response_belief import ResponseModel
from nufleet.shared.arrays import FloatArray
from tests.orchestrator.belief.test_response_belief import COMB, PRIOR, measured, random_loop

DEVIATION = 0.01
OTHERS = np.linspace(1.0, 5.0, 6)
NONE: FloatArray = np.zeros(len(OTHERS))


def together(one: Tones, other: Tones) -> Tones:
    return Tones(
        np.concatenate([one.omega_rad_s, other.omega_rad_s]),
        np.concatenate([one.z, other.z]),
        np.concatenate([one.variance, other.variance]),
    )


def missed(earlier: Tones, new: Tones, rng: np.random.Generator) -> Miss | None:
    models = (ResponseModel(tones, PRIOR) for tones in (earlier, together(earlier, new)))
    return miss_of(new, NONE, *models, rng)


def test_tests_of_the_same_robot_hardly_ever_contradict_each_other() -> None:
    rng = np.random.default_rng(1)
    found = []
    for _ in range(60):
        theta = random_loop(rng, mode=False)
        tests = (measured(theta, omega, DEVIATION, rng) for omega in (COMB, OTHERS))
        found.append(missed(*tests, rng))
    assert sum(one is not None for one in found) <= 1


def test_a_test_of_another_robot_is_a_contradiction_where_it_is_furthest_away() -> None:
    rng = np.random.default_rng(2)
    for tone, omega in enumerate(OTHERS):
        theta = random_loop(rng, mode=False)
        new = measured(theta, OTHERS, DEVIATION, rng)
        # No smooth response, nor one with a resonance, leads through both tests.
        by = np.where(np.arange(len(OTHERS)) == tone, 0.3, 0.1 * (-1) ** np.arange(len(OTHERS)))
        off = replace(new, z=new.z + by)
        found = missed(measured(theta, COMB, DEVIATION, rng), off, rng)
        assert found is not None
        assert found.worst_rad_s == omega
        assert 0.2 < found.worst < 0.4


def at_same_tones(by: float, rng: np.random.Generator) -> Miss | None:
    theta = random_loop(rng, mode=False)
    both = np.sort(np.concatenate([COMB[::2], OTHERS]))
    new = measured(theta, both, DEVIATION, rng)
    return miss_at_same_tones(
        replace(new, z=new.z + by), np.zeros(len(both)), measured(theta, COMB, DEVIATION, rng)
    )


def test_estimates_at_the_same_tones_are_compared_without_a_model() -> None:
    rng = np.random.default_rng(3)
    assert sum(at_same_tones(0.0, rng) is not None for _ in range(1000)) <= 5
    found = [at_same_tones(3 * DEVIATION, rng) for _ in range(100)]
    assert sum(one is not None for one in found) >= 95
    shared = {float(omega) for one in found if one is not None for omega in one.omega_rad_s}
    assert shared == {float(omega) for omega in COMB[::2]}


def test_a_delay_between_two_tests_is_told_from_other_changes() -> None:
    rng = np.random.default_rng(5)
    found: dict[str, list[float | None]] = {"late": [], "larger": []}
    for _ in range(50):
        theta = random_loop(rng, mode=False)
        one, other = (measured(theta, COMB, DEVIATION, rng) for _ in range(2))
        late = replace(other, z=other.z * np.exp(-0.1j * COMB))
        larger = replace(other, z=other.z * 1.3)
        for kind, new in (("late", late), ("larger", larger)):
            miss = miss_at_same_tones(new, np.zeros(len(COMB)), one)
            assert miss is not None
            found[kind].append(miss.delay_s)
    late_s = np.array([one for one in found["late"] if one is not None])
    assert len(late_s) >= 45
    assert np.max(np.abs(late_s - 0.1)) < 0.03
    assert sum(one is not None for one in found["larger"]) <= 2


def test_at_few_tones_no_change_is_taken_for_a_delay() -> None:
    omega = COMB[:2]
    one = Tones(omega, np.ones(2, dtype=complex), np.full(2, 1e-6))
    late = replace(one, z=one.z * np.exp(-0.01j * omega))
    miss = miss_at_same_tones(late, np.zeros(2), one)
    assert miss is not None
    assert miss.delay_s is None


def test_tests_without_a_tone_in_common_are_not_compared_like_that() -> None:
    rng = np.random.default_rng(4)
    theta = random_loop(rng, mode=False)
    one, other = (measured(theta, omega, DEVIATION, rng) for omega in (OTHERS, OTHERS + 0.1))
    assert miss_at_same_tones(replace(one, z=one.z + 1), NONE, other) is None


def test_what_is_uncertain_says_nothing_about_how_large_a_change_is() -> None:
    squared, usual = np.array([0.04, 9.0]), np.array([1e-4, 10.0])
    nothing = np.zeros(2, dtype=complex)
    miss = Miss(np.ones(2), nothing, nothing, squared, usual, 0.2, 1.0)
    assert abs(miss.excess - (0.04 - 1e-4)) < 1e-3
