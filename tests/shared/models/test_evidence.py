"""What may hold an axis back moves only as far as it must."""

from __future__ import annotations

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from nufleet.shared.models.evidence import held_within


@settings(max_examples=100, deadline=None)
@given(samples=st.integers(1, 300), reach=st.floats(1e-6, 10.0), seed=st.integers(0, 2**32 - 1))
def test_bounds_push_something_before_them_as_they_would_sample_by_sample(
    samples: int, reach: float, seed: int
) -> None:
    middle = np.cumsum(np.random.default_rng(seed).standard_normal((2, samples)), axis=1)
    lowest, highest = middle - reach, middle + np.array([[reach], [2 * reach]])
    places = held_within(lowest, highest)
    for row in range(2):
        place = (lowest[row, 0] + highest[row, 0]) / 2
        for sample in range(samples):
            place = min(max(place, lowest[row, sample]), highest[row, sample])
            assert places[row, sample] == place
