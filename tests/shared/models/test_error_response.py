"""The error of a loop as the answer to the changes of its reference."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.models.error_response import LAGS_MAX, ErrorBasis

BASES = st.builds(
    ErrorBasis, st.sampled_from([0.005, 0.02, 0.1, 1.0]), st.sampled_from([0.0, 0.02, 0.3, 2.0])
)


def answer(basis: ErrorBasis, parameters: FloatArray, lags: int) -> FloatArray:
    """g(j) for j = 0 … lags − 1, as the parameters are defined."""
    inner = np.interp(np.arange(lags), basis.nodes, parameters[:-1])
    inner[basis.nodes[-1] + 1 :] = parameters[-1]
    return inner


@settings(max_examples=40, deadline=None)
@given(BASES, st.integers(1, 300), st.floats(-2.0, 2.0), st.integers(0, 1000))
def test_the_columns_are_the_convolution_of_their_definition(
    basis: ErrorBasis, samples: int, before: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    parameters, reference = rng.standard_normal(basis.size), rng.standard_normal(samples).cumsum()
    g = answer(basis, parameters, samples)
    change = np.diff(reference, prepend=before)
    expected = np.convolve(change, g)[:samples] + before * parameters[-1]
    np.testing.assert_allclose(basis.columns(reference, before) @ parameters, expected, atol=1e-8)


@settings(max_examples=20, deadline=None)
@given(BASES, st.integers(0, 1000))
def test_the_frequency_response_is_that_of_a_sinusoid(basis: ErrorBasis, seed: int) -> None:
    parameters = np.random.default_rng(seed).standard_normal(basis.size)
    omega = np.array([0.0, 0.3, 1.0, 2.9]) / basis.sample_time_s
    samples = 3 * int(basis.nodes[-1]) + 10
    response = basis.response(omega) @ parameters
    for w, z in zip(omega.tolist(), response, strict=True):
        turn = np.exp(1j * w * basis.sample_time_s * np.arange(samples))
        real, imaginary = (basis.columns(part, 0.0)[-1] for part in (turn.real, turn.imag))
        assert z * turn[-1] == pytest.approx((real + 1j * imaginary) @ parameters, abs=1e-8)


def test_a_long_record_takes_little_memory() -> None:
    """Five minutes at 1 kHz; the whole matrix would take 80 MB."""
    basis = ErrorBasis(0.001, 4.0)
    reference = np.cumsum(np.random.default_rng(0).standard_normal(300_000))
    tracemalloc.start()
    try:
        rows = sum(len(block) for block in basis.blocks(reference, 0.0))
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert rows == len(reference)
    assert peak_bytes < 20 * 2**20


def test_an_answer_longer_than_a_model_holds_is_refused_in_words() -> None:
    with pytest.raises(InvalidInputError, match=f"at most {LAGS_MAX}: give a shorter settling"):
        _ = ErrorBasis(0.001, 120.0).nodes
