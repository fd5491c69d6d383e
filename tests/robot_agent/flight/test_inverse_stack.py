"""Inverse models evaluated together say what each of them says alone."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learned_things import layout

from nufleet.robot_agent.flight.inverse_model import NetworkInverse
from nufleet.robot_agent.flight.inverse_stack import InverseStack
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.file import Experience
from nufleet.shared.experience.manifest import ExperienceManifest

LAYOUT = layout("state")
INPUTS = len(LAYOUT.input_names)


def network(seed: int, hidden: tuple[int, ...] = (16, 16)) -> NetworkInverse:
    """A network of random weights, whose inputs have the sizes of a robot's states."""
    rng = np.random.default_rng(seed)
    manifest = ExperienceManifest(
        robot="source",
        robot_kind="double-integrator",
        axes=("x",),
        unit="m",
        layout=LAYOUT,
        inputs=LAYOUT.input_names,
        relative_degree=1,
        hidden=hidden,
        input_mean=tuple(rng.normal(0.0, 0.1, INPUTS).tolist()),
        input_scale=tuple(rng.uniform(0.05, 0.5, INPUTS).tolist()),
        output_mean=0.01,
        output_scale=0.3,
        points=100,
        validation_rms=0.01,
        data_sha256="0" * 64,
        seed=seed,
        training_version="1",
    )
    arrays = {
        name: (rng.standard_normal(shape) / np.sqrt(shape[0])).astype(np.float32)
        for name, shape in manifest.shapes.items()
    }
    return NetworkInverse(Experience(manifest, arrays))


def inputs(rows: int) -> FloatArray:
    return 0.5 * np.random.default_rng(9).standard_normal((rows, INPUTS))


def constant(rows: FloatArray) -> FloatArray:
    return np.full(len(rows), 0.25)


@given(
    st.lists(st.sampled_from([(16, 16), (8,), ()]), min_size=1, max_size=6),
    st.integers(1, 4),
)
@settings(deadline=None, max_examples=25)
def test_networks_of_any_shapes_say_what_they_say_alone(
    shapes: list[tuple[int, ...]], rows: int
) -> None:
    alone = [network(seed, shape) for seed, shape in enumerate(shapes)]
    together = InverseStack([*alone, constant])(inputs(rows))
    expected = np.stack([*(each(inputs(rows)) for each in alone), constant(inputs(rows))])
    np.testing.assert_allclose(together, expected, rtol=1e-5, atol=1e-6)


def test_the_papers_networks_agree_to_single_precision() -> None:
    alone = [network(seed, (128,) * 4) for seed in range(5)]
    together = InverseStack(alone)(inputs(50))
    expected = np.stack([each(inputs(50)) for each in alone])
    np.testing.assert_allclose(together, expected, atol=2e-6 * np.abs(expected).max())


def test_an_answer_that_is_not_finite_concerns_its_own_model_alone() -> None:
    def broken(rows: FloatArray) -> FloatArray:
        return np.full(len(rows), np.nan)

    together = InverseStack([network(0), broken, network(1)])(inputs(2))
    assert np.isnan(together[1]).all()
    assert np.isfinite(together[[0, 2]]).all()


@pytest.mark.parametrize("huge", [1e30, 1e200])
def test_inputs_beyond_single_precision_make_no_warning(huge: float) -> None:
    with np.errstate(all="raise"):
        answers = InverseStack([network(0), network(1)])(np.full((1, INPUTS), huge))
    assert answers.shape == (2, 1)
