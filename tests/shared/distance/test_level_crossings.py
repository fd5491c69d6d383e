"""The crossings of a level are where the distance has it, and nowhere else."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import random_state_space

from nufleet.shared.distance.graph_angles import model_distance, sines
from nufleet.shared.distance.level_crossings import level_crossings, mixed_zeros
from nufleet.shared.models.half_plane import common_half_plane


@pytest.mark.parametrize(("inputs", "outputs"), [(1, 1), (2, 1), (1, 3), (2, 3)])
@pytest.mark.parametrize("level", [0.2, 0.5, 0.9])
def test_a_grid_crosses_the_level_only_at_the_crossings(
    inputs: int, outputs: int, level: float
) -> None:
    rng = np.random.default_rng(41)
    for _ in range(4):
        first, second = (random_state_space(rng, 3, inputs, outputs) for _ in range(2))
        plane = common_half_plane(first, second)
        points = level_crossings(plane.image(first), plane.image(second), level)
        on_axis = np.abs(points[np.abs(points.real) < 1e-8].imag)
        omega = np.linspace(0, 20, 20_001)
        above = model_distance(first, second, omega) > level
        steps = omega[1:][above[1:] != above[:-1]]
        for step in steps:
            assert np.abs(on_axis - step).min() < 1e-3
        if len(on_axis):
            angles = sines(first.graph(on_axis), second.graph(on_axis))
            np.testing.assert_allclose(np.abs(angles - level).min(axis=1), 0, atol=1e-7)


def test_the_mixed_zeros_of_a_model_with_itself_are_symmetric() -> None:
    """det(G*G) has as many zeros in either half-plane: the stable closed loop of LQG, mirrored."""
    model = random_state_space(np.random.default_rng(42), 4, 2, 2)
    plane = common_half_plane(model, model)
    zeros = mixed_zeros(plane.image(model), plane.image(model))
    assert np.count_nonzero(zeros.real > 0) == 4
    right, left = zeros[zeros.real > 0], zeros[zeros.real < 0]
    for zero in right:
        assert np.abs(left + zero.conjugate()).min() < 1e-9
