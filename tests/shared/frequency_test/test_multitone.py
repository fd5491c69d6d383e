"""Sums of tones and their peaks."""

from __future__ import annotations

import tracemalloc
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import kstest

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.multitone import (
    free_of_products,
    interleaved,
    multitone,
    random_phases,
)

combs = st.builds(
    lambda first, count, step: tuple(range(first, first + step * count, step)),
    st.integers(1, 9),
    st.integers(2, 24),
    st.sampled_from([1, 2]),
)


def phases_of(harmonics: tuple[int, ...], weights: FloatArray) -> FloatArray:
    (phases,) = random_phases([harmonics], [weights])
    return phases


def highest_crest(
    hands: Sequence[tuple[int, ...]], weights: Sequence[FloatArray], phases: Sequence[FloatArray]
) -> float:
    """Return the largest crest factor of position, speed and acceleration, of vectors' lengths."""
    times = np.linspace(0.0, 2 * np.pi, 64 * max(hand[-1] for hand in hands), endpoint=False)
    crests = []
    for order in range(3):
        vector = [
            (own * np.array(hand) ** order)
            @ np.sin(np.outer(hand, times) + phase[:, None] + order * np.pi / 2)
            for hand, own, phase in zip(hands, weights, phases, strict=True)
        ]
        length = np.linalg.norm(vector, axis=0)
        crests.append(float(np.max(length) / np.sqrt(np.mean(length**2))))
    return max(crests)


@given(harmonics=combs, exponent=st.floats(-1.0, 0.0))
def test_neither_position_nor_speed_nor_acceleration_peaks_as_with_most_random_phases(
    harmonics: tuple[int, ...], exponent: float
) -> None:
    weights = np.array(harmonics, dtype=np.float64) ** exponent
    rng = np.random.default_rng(0)
    others = [
        highest_crest([harmonics], [weights], [rng.uniform(0, 2 * np.pi, len(harmonics))])
        for _ in range(40)
    ]
    found = highest_crest([harmonics], [weights], [phases_of(harmonics, weights)])
    # Peaks are looked for at eight samples per period, between which one can rise a little.
    assert found <= 1.05 * np.quantile(others, 0.1)


@pytest.mark.parametrize("count", [6, 12, 24])
def test_odd_tones_crest_below_2_5(count: int) -> None:
    harmonics = tuple(range(1, 1 + 2 * count, 2))
    weights = np.array(harmonics, dtype=np.float64) ** -0.5
    assert highest_crest([harmonics], [weights], [phases_of(harmonics, weights)]) < 2.5


def test_the_same_tones_have_the_same_phases() -> None:
    harmonics, weights = (1, 3, 5, 7), np.ones(4)
    assert np.array_equal(phases_of(harmonics, weights), phases_of(harmonics, weights))


def test_bands_of_many_decades_take_no_more_memory_than_others() -> None:
    harmonics = tuple(10**power for power in range(8))
    tracemalloc.start()
    try:
        phases_of(harmonics, np.ones(len(harmonics)))
        assert tracemalloc.get_traced_memory()[1] < 200e6
    finally:
        tracemalloc.stop()


def test_phases_are_evenly_spread_over_all_tests() -> None:
    phases = np.concatenate(
        [phases_of(tuple(range(1, 2 * count, 2)), np.ones(count)) for count in range(6, 60)]
    )
    assert kstest(phases / (2 * np.pi), "uniform").pvalue > 0.01


def test_tones_carry_the_multiples_and_weights_asked_for() -> None:
    (tones,) = multitone(0.25, [(3, 5, 9)], [np.array([1.0, 0.5, 0.25])])
    assert [tone.omega_rad_s for tone in tones] == [0.75, 1.25, 2.25]
    assert [tone.weight for tone in tones] == [1.0, 0.5, 0.25]


@given(top=st.integers(7, 200), axes=st.integers(2, 4))
def test_no_tone_of_several_axes_is_a_harmonic_sum_or_difference_of_others(
    top: int, axes: int
) -> None:
    played_together = free_of_products(range(1, top + 1))
    hands = interleaved(played_together, axes)
    assert sorted(h for hand in hands for h in hand) == sorted(played_together)
    products = {order * h for h in played_together for order in (2, 3)}
    products |= {
        abs(a + sign * b) for a in played_together for b in played_together for sign in (1, -1)
    }
    assert not products & set(played_together)


def test_every_axis_reaches_from_the_lowest_tones_to_the_highest() -> None:
    hands = interleaved(free_of_products(range(1, 60)), 3)
    for hand in hands:
        assert hand[0] <= 7
        assert hand[-1] >= 50
        assert max(np.diff(hand)) <= 12


@pytest.mark.parametrize("axes", [2, 3])
def test_the_vector_of_several_axes_peaks_less_than_with_phases_of_each_alone(axes: int) -> None:
    hands = interleaved(free_of_products(range(1, 60)), axes)
    weights = [np.array(hand, dtype=np.float64) ** -0.5 for hand in hands]
    apart = [phases_of(hand, own) for hand, own in zip(hands, weights, strict=True)]
    together = random_phases(hands, weights)
    assert highest_crest(hands, weights, together) < highest_crest(hands, weights, apart)
