"""Sums of tones and their peaks."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.multitone import (
    free_of_products,
    interleaved,
    low_crest_phases,
    multitone,
    schroeder_phases,
)

combs = st.builds(
    lambda first, count, step: tuple(range(first, first + step * count, step)),
    st.integers(1, 9),
    st.integers(2, 24),
    st.sampled_from([1, 2]),
)


def phases_of(harmonics: tuple[int, ...], weights: FloatArray) -> FloatArray:
    (phases,) = low_crest_phases([harmonics], [weights])
    return phases


def played(harmonics: tuple[int, ...], weights: FloatArray, phases: FloatArray) -> FloatArray:
    times = np.linspace(0.0, 2 * np.pi, 64 * harmonics[-1], endpoint=False)
    signal: FloatArray = weights @ np.sin(np.outer(harmonics, times) + phases[:, None])
    return signal


def crest_factor(signal: FloatArray) -> float:
    """Return the ratio of a signal's largest magnitude to its root mean square."""
    return float(np.max(np.abs(signal)) / np.sqrt(np.mean(signal**2)))


@given(harmonics=combs, exponent=st.floats(-1.0, 0.0))
def test_phases_never_crest_much_higher_than_schroeders(
    harmonics: tuple[int, ...], exponent: float
) -> None:
    weights = np.array(harmonics, dtype=np.float64) ** exponent
    found = crest_factor(played(harmonics, weights, phases_of(harmonics, weights)))
    schroeder = crest_factor(played(harmonics, weights, schroeder_phases(weights)))
    # The search looks at eight samples per period, between which a peak can rise a little.
    assert found <= 1.1 * schroeder


@pytest.mark.parametrize("count", [6, 12, 24])
def test_equal_odd_tones_stay_below_a_crest_factor_of_1_75(count: int) -> None:
    harmonics = tuple(range(3, 3 + 2 * count, 2))
    weights = np.ones(count)
    phases = phases_of(harmonics, weights)
    assert crest_factor(played(harmonics, weights, phases)) < 1.75


def test_a_single_tone_crests_at_the_square_root_of_two() -> None:
    phases = phases_of((5,), np.ones(1))
    crest = crest_factor(played((5,), np.ones(1), phases))
    assert crest == pytest.approx(np.sqrt(2), rel=1e-6)


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
def test_the_phases_of_several_axes_keep_the_length_of_their_vector_small(axes: int) -> None:
    hands = interleaved(free_of_products(range(1, 60)), axes)
    weights = [np.array(hand, dtype=np.float64) ** -0.5 for hand in hands]

    def longest(phases: Sequence[FloatArray]) -> float:
        samples = 64 * max(hand[-1] for hand in hands)
        times = np.linspace(0.0, 2 * np.pi, samples, endpoint=False)
        vector = [
            own @ np.sin(np.outer(hand, times) + phase[:, None])
            for hand, own, phase in zip(hands, weights, phases, strict=True)
        ]
        return float(np.max(np.linalg.norm(vector, axis=0)))

    apart = [phases_of(hand, own) for hand, own in zip(hands, weights, strict=True)]
    assert longest(low_crest_phases(hands, weights)) < 0.97 * longest(apart)
