"""The distance between models at a frequency is the chordal distance."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import random_state_space
from scipy.linalg import sqrtm, subspace_angles

from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.distance.graph_angles import model_distance, sines
from nufleet.shared.models.realization import transfer_function


def test_for_one_input_and_output_it_is_the_papers_chordal_distance() -> None:
    first, second = transfer_function([2, 1], [1, 3, 5]), transfer_function([1, -4], [1, 1, 9])
    omega = np.geomspace(0.1, 100, 20)
    z = [
        np.polyval(n, 1j * omega) / np.polyval(d, 1j * omega)
        for n, d in (([2, 1], [1, 3, 5]), ([1, -4], [1, 1, 9]))
    ]
    np.testing.assert_allclose(
        model_distance(first, second, omega), chordal_distance(z[0], z[1]), rtol=1e-10
    )


@pytest.mark.parametrize(("inputs", "outputs"), [(1, 3), (3, 1), (2, 2), (3, 2)])
def test_for_many_it_is_vinnicombes_formula(inputs: int, outputs: int) -> None:
    rng = np.random.default_rng(4)
    first, second = (random_state_space(rng, 3, inputs, outputs) for _ in range(2))
    p1, p2 = (m.c @ np.linalg.solve(0.7j * np.eye(3) - m.a, m.b) + m.d for m in (first, second))
    left = np.linalg.inv(sqrtm(np.eye(outputs) + p2 @ p2.conj().T))
    right = np.linalg.inv(sqrtm(np.eye(inputs) + p1.conj().T @ p1))
    expected = np.linalg.norm(left @ (p2 - p1) @ right, 2)
    assert model_distance(first, second, np.array([0.7]))[0] == pytest.approx(expected, rel=1e-10)


def test_sines_are_those_of_the_principal_angles() -> None:
    rng = np.random.default_rng(5)
    first, second = (
        rng.standard_normal((1, 5, 2)) + 1j * rng.standard_normal((1, 5, 2)) for _ in range(2)
    )
    expected = np.sin(subspace_angles(first[0], second[0]))
    np.testing.assert_allclose(sines(first, second)[0], np.sort(expected)[::-1], rtol=1e-9)


def test_the_length_of_a_basis_does_not_matter() -> None:
    rng = np.random.default_rng(6)
    first, second = (rng.standard_normal((3, 2, 1)).astype(np.complex128) for _ in range(2))
    np.testing.assert_allclose(sines(1e9 * first, 1e-9j * second), sines(first, second))
