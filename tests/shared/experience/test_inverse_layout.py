"""Training pairs, queries and references of an inverse model belong together."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest
from pydantic import ValidationError

from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.layout import InverseLayout

STEP_S = 0.02
Architecture = Literal["state", "preview"]


def layout(architecture: Architecture, horizon: int = 7, states: int = 3) -> InverseLayout:
    names = ("position", "velocity", "tilt")[: 1 if architecture == "preview" else states]
    return InverseLayout(
        architecture=architecture, states=names, sample_time_s=STEP_S, horizon_samples=horizon
    )


def record(samples: int, states: int, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    return rng.standard_normal(samples), rng.standard_normal((samples, states))


def test_a_state_pair_is_the_one_of_its_definition() -> None:
    chosen = layout("state")
    u, x = record(30, 3)
    inputs, gamma = chosen.pairs(u, x)
    assert len(gamma) == 30 - chosen.span_samples + 1
    k, j = 29, 29 - 7
    y, v, tilt = x[:, 0], x[:, 1], x[:, 2]
    expected = [v[j], tilt[j], y[k] - y[j], v[k] - v[j], u[j - 1] - y[j]]
    np.testing.assert_allclose(inputs[-1], expected, rtol=1e-12)
    heading = (y[k] - u[j - 1]) / (7 * STEP_S)
    assert gamma[-1] == pytest.approx((u[j] - u[j - 1]) / STEP_S - heading)


@pytest.mark.parametrize("states", [1, 2, 3])
def test_asked_for_what_the_robot_did_the_state_layout_sends_what_was_sent(states: int) -> None:
    chosen = layout("state", states=states)
    u, x = record(40, states)
    inputs, gamma = chosen.pairs(u, x)
    for j, row, value in zip(range(1, 33), inputs, gamma, strict=True):
        path, previous = x[j : j + 8, :1], u[j - 1 : j]
        velocity = x[j + 7, 1:2] if states > 1 else np.zeros(1)
        np.testing.assert_allclose(
            chosen.query(x[j : j + 1], previous, path, velocity)[0], row, rtol=1e-12
        )
        sent = chosen.reference(np.array([value]), previous, path)
        np.testing.assert_allclose(sent, u[j : j + 1], rtol=1e-10)


def test_a_linear_filter_between_reference_and_output_is_a_linear_relation_of_preview_pairs() -> (
    None
):
    chosen = layout("preview", horizon=10)
    rng = np.random.default_rng(1)
    weights = rng.standard_normal(len(chosen.input_names))
    y = np.cumsum(rng.standard_normal(600))
    centre = np.arange(100, 590)
    windows = y[centre[:, np.newaxis] + np.array(chosen.offsets)] - y[centre, np.newaxis]
    u = y.copy()
    u[centre] += chosen.horizon_s * windows @ weights
    inputs, gamma = chosen.pairs(u[100:590], y[100:590, np.newaxis])
    np.testing.assert_allclose(gamma, inputs @ weights, rtol=1e-9, atol=1e-9)
    path = y[200:311, np.newaxis]
    query = chosen.query(np.zeros((1, 1)), np.zeros(1), path, np.zeros(1))
    sent = chosen.reference(query @ weights, np.zeros(1), path)
    np.testing.assert_allclose(sent, u[300:301], rtol=1e-10)


@pytest.mark.parametrize("architecture", ["state", "preview"])
def test_the_shortest_record_gives_the_newest_pair_without_the_reference_to_come(
    architecture: Architecture,
) -> None:
    chosen = layout(architecture)
    u, x = record(150, len(chosen.states))
    inputs, gamma = chosen.pairs(u, x)
    span = chosen.span_samples
    for end in (span, span + 13, 150):
        known = u[end - span : end].copy()
        known[-1] = np.nan
        one, value = chosen.pairs(known, x[end - span : end])
        np.testing.assert_allclose(one, inputs[end - span : end - span + 1], rtol=1e-12)
        np.testing.assert_allclose(value, gamma[end - span : end - span + 1], rtol=1e-9)
    assert len(chosen.pairs(u[: span - 1], x[: span - 1])[1]) == 0


@pytest.mark.parametrize("architecture", ["state", "preview"])
def test_where_the_robot_is_does_not_matter(architecture: Architecture) -> None:
    chosen = layout(architecture)
    u, x = record(150, len(chosen.states))
    moved = x + np.eye(1, x.shape[1]) * 3.0
    for here, there in zip(chosen.pairs(u, x), chosen.pairs(u + 3.0, moved), strict=True):
        np.testing.assert_allclose(here, there, atol=1e-9)


def test_what_a_preview_shows_the_gp_is_speed_and_acceleration() -> None:
    chosen = layout("preview", horizon=10)
    time_s = np.arange(-100, 11) * STEP_S
    path = (0.4 * time_s + 0.5 * 1.5 * time_s**2)[:, np.newaxis]
    query = chosen.query(np.zeros((1, 1)), np.zeros(1), path, np.zeros(1))
    np.testing.assert_allclose(chosen.gp_inputs(query), [[0.4, 1.5]], rtol=1e-9)


def test_zero_gamma_sends_a_preview_along_the_path_and_a_state_towards_the_horizon() -> None:
    path = np.linspace(0.0, 1.1, 111)[:, np.newaxis]
    chosen = layout("preview", horizon=10)
    np.testing.assert_allclose(chosen.reference(np.zeros(1), np.zeros(1), path), path[100])
    toward = layout("state", horizon=10).reference(np.zeros(1), np.zeros(1), np.array([[1.0]]))
    np.testing.assert_allclose(toward, [0.1])


def test_a_preview_too_short_to_be_resolved_is_refused() -> None:
    with pytest.raises(ValidationError, match="at least 4 samples"):
        layout("preview", horizon=3)
