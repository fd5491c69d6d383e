"""Discrete time is mapped to a half-plane, and frequencies come back unharmed."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.shared.models.half_plane import CLEAR_OF_POLES, common_half_plane
from nufleet.shared.models.realization import transfer_function
from nufleet.shared.models.transfer_models import StateSpace

DT_S = 0.1


def pair(*poles: complex) -> tuple[StateSpace, StateSpace]:
    second = transfer_function([1], [1, -0.5], DT_S)
    return transfer_function([1], np.poly(poles).real, DT_S), second


@pytest.mark.parametrize(
    "poles", [(0.9, 0.2), (-1.0,), (1.0, -1.0), (-0.999 + 0.01j, -0.999 - 0.01j)]
)
def test_the_image_has_the_response_of_the_model(poles: tuple[complex, ...]) -> None:
    model, other = pair(*poles)
    plane = common_half_plane(model, other)
    image = plane.image(model)
    for height in (-3.0, -0.2, 0.4, 5.0):
        omega = plane.omega_rad_s(np.array([1j * height]))[0]
        turned = np.exp(1j * (2 * np.arctan(height) + plane.angle_at_infinity - np.pi))
        value = (
            image.c @ np.linalg.solve(1j * height * np.eye(len(poles)) - image.a, image.b) + image.d
        )
        expected = 1 / np.polyval(np.poly(poles), turned)
        assert value[0, 0] == pytest.approx(expected, rel=1e-8)
        assert np.exp(1j * omega * DT_S) == pytest.approx(
            turned if turned.imag >= 0 else turned.conjugate()
        )


@pytest.mark.parametrize("poles", [(0.9,), (-1.0, 1.0), (-1.0, 1j, -1j), (2.0, -0.3)])
def test_no_pole_is_sent_near_infinity_and_stability_is_kept(poles: tuple[complex, ...]) -> None:
    model, other = pair(*poles)
    plane = common_half_plane(model, other)
    modes = np.linalg.eigvals(plane.image(model).a)
    assert np.abs(modes).max() < 3 / CLEAR_OF_POLES
    assert np.count_nonzero(modes.real > 1e-9) == sum(abs(pole) > 1 for pole in poles)
    assert np.count_nonzero(np.abs(modes.real) < 1e-9) == sum(abs(pole) == 1 for pole in poles)


def test_continuous_time_is_left_as_it_is() -> None:
    model = transfer_function([1, 2], [1, 3, 7])
    plane = common_half_plane(model, model)
    np.testing.assert_allclose(
        np.sort_complex(np.linalg.eigvals(plane.image(model).a)), np.sort_complex(model.modes)
    )
    np.testing.assert_allclose(plane.omega_rad_s(np.array([-4j, 1 + 2j])), [4, 2])
    assert plane.omega_max_rad_s == np.inf
