"""Inverse models of different horizons describe one sample, and mean the same by their answers."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from learned_things import layout

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.combined_layout import CombinedLayout
from nufleet.shared.experience.layout import Architecture

HORIZONS = (8, 20, 13)
ARCHITECTURES: tuple[Architecture, ...] = ("state", "preview")


def combined(architecture: Architecture, horizons: tuple[int, ...] = HORIZONS) -> CombinedLayout:
    return CombinedLayout([layout(architecture, horizon_samples=h) for h in horizons])


def record(samples: int, states: int) -> tuple[FloatArray, FloatArray]:
    """A smooth reference, shape (samples,), and states that follow it, (samples, states)."""
    time_s = 0.015 * np.arange(samples)
    reference = np.sin(time_s) + 0.3 * np.sin(2.3 * time_s)
    position = np.concatenate([np.full(3, reference[0]), reference[:-3]])
    return reference, np.stack([position, np.gradient(position, 0.015)], axis=1)[:, :states]


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_of_one_layout_it_is_that_layout(architecture: Architecture) -> None:
    alone = layout(architecture)
    same = CombinedLayout([alone, alone])
    references, states = record(300, len(alone.states))
    for found, expected in zip(
        same.pairs(references, states), alone.pairs(references, states), strict=True
    ):
        np.testing.assert_array_equal(found, expected)
    assert same.span_samples == alone.span_samples
    assert same.input_names == alone.input_names


@pytest.mark.parametrize(
    ("architecture", "order"), list(product(ARCHITECTURES, [(0, 1, 2), (1, 0, 2), (2, 1, 0)]))
)
def test_pairs_of_all_layouts_describe_the_same_sample(
    architecture: Architecture, order: tuple[int, ...]
) -> None:
    """Each layout's own γ of a pair gives, as the leading layout's, nearly the leading γ."""
    horizons = tuple(HORIZONS[i] for i in order)
    both = combined(architecture, horizons)
    references, states = record(400, len(both.states))
    inputs, gamma = both.pairs(references, states)
    assert len(gamma) == 400 - both.span_samples + 1
    for horizon in horizons:
        alone = layout(architecture, horizon_samples=horizon)
        own_inputs, own_gamma = alone.pairs(references, states)
        mine = both.inputs_of(alone, inputs)
        (begin,) = [
            k
            for k in range(len(own_inputs) - len(mine) + 1)
            if np.array_equal(own_inputs[k : k + len(mine)], mine)
        ]
        as_leading = both.as_leading(alone, inputs, own_gamma[begin : begin + len(mine)])
        # Previews smooth over half of their own horizon, so theirs differ by what that leaves.
        tolerance = 1e-9 if architecture == "state" else 0.01 * np.abs(gamma).max()
        np.testing.assert_allclose(as_leading, gamma, atol=tolerance)


@pytest.mark.parametrize("span", [0, 1])
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_a_record_that_is_too_short_holds_no_pair(architecture: Architecture, span: int) -> None:
    both = combined(architecture)
    samples = span * (both.span_samples - 1)
    references, states = record(600, len(both.states))
    inputs, gamma = both.pairs(references[:samples], states[:samples])
    assert inputs.shape == (0, len(both.input_names))
    assert gamma.shape == (0,)


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_a_query_holds_what_each_layout_would_ask_for(architecture: Architecture) -> None:
    both = combined(architecture)
    desired = record(600, 1)[0]
    path = np.stack([desired, -desired], axis=1)
    velocity = np.gradient(path, 0.015, axis=0)
    states = np.array([[0.1, 0.2], [0.3, -0.1]])[:, : len(both.states)]
    previous, now = np.array([0.15, 0.25]), 300

    def asked(of: CombinedLayout) -> FloatArray:
        rows = slice(now - of.back_samples, now + of.horizon_samples + 1)
        return of.query(states, previous, path[rows], velocity[now + of.horizon_samples])

    together = asked(both)
    for horizon in HORIZONS:
        alone = CombinedLayout([layout(architecture, horizon_samples=horizon)])
        np.testing.assert_allclose(
            both.inputs_of(alone.leading, together), asked(alone), rtol=1e-12, atol=1e-12
        )
    leading = CombinedLayout([both.leading])
    gamma = np.array([0.3, -0.2])
    rows = slice(now - both.back_samples, now + both.horizon_samples + 1)
    near = slice(now - leading.back_samples, now + leading.horizon_samples + 1)
    np.testing.assert_allclose(
        both.reference(gamma, previous, path[rows]),
        leading.reference(gamma, previous, path[near]),
    )


@pytest.mark.parametrize(
    "other",
    [layout("preview"), layout("state", sample_time_s=0.02), layout("state", states=("position",))],
)
def test_models_of_other_inputs_cannot_be_combined(other: object) -> None:
    with pytest.raises(InvalidInputError, match="choose sources of one architecture"):
        CombinedLayout([layout("state"), other])  # type: ignore[list-item]
