"""The margin of a loop, and the promise that a small ν-gap makes about it."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_models import random_state_space

from nufleet.shared.distance.nu_gap import nu_gap
from nufleet.shared.distance.stability_margin import stability_guarantee, stability_margin
from nufleet.shared.models.realization import transfer_function
from nufleet.shared.models.transfer_models import ModelError, StateSpace

PI = transfer_function([2, 1], [1, 0])


@pytest.mark.parametrize("dt_s", [0.0, 0.02])
def test_it_is_the_smallest_distance_to_the_controllers_inverse(dt_s: float) -> None:
    """For one input and output b = min |1 + PC| / (√(1 + |P|²) √(1 + |C|²))."""
    plant = transfer_function([0.05], [1, -1.01], dt_s) if dt_s else transfer_function([1], [1, -1])
    controller = transfer_function([5, -4.9], [1, -1], dt_s) if dt_s else PI
    omega = np.linspace(1e-4, math.pi / 0.02 if dt_s else 50.0, 200_001)
    p, c = (
        model.graph(omega)[:, 1, 0] / model.graph(omega)[:, 0, 0] for model in (plant, controller)
    )
    grid = np.abs(1 + p * c) / np.sqrt((1 + np.abs(p) ** 2) * (1 + np.abs(c) ** 2))
    margin = stability_margin(plant, controller)
    assert margin.value == pytest.approx(grid.min(), abs=1e-7)
    assert margin.omega_worst_rad_s == pytest.approx(omega[grid.argmin()], abs=2e-3)


def test_for_many_signals_it_is_one_over_the_gain_of_the_closed_loop() -> None:
    rng = np.random.default_rng(31)
    plant, controller = (
        random_state_space(rng, 3, inputs, outputs, shift=4.0)
        for inputs, outputs in ((2, 3), (3, 2))
    )
    gains = []
    for omega in np.concatenate([[0.0], np.geomspace(0.01, 1000, 4000)]):
        p, c = (
            m.c @ np.linalg.solve(1j * omega * np.eye(3) - m.a, m.b) + m.d
            for m in (plant, controller)
        )
        loop = np.vstack([p, np.eye(2)]) @ np.linalg.solve(
            np.eye(2) + c @ p, np.hstack([c, np.eye(2)])
        )
        gains.append(np.linalg.norm(loop, 2))
    assert stability_margin(plant, controller).value == pytest.approx(1 / max(gains), abs=1e-6)


@pytest.mark.parametrize(
    ("plant", "controller"),
    [
        (([1], [1, -1]), ([0.5], [1])),  # too little gain
        (([1], [1, 1]), ([-1], [1])),  # a closed-loop pole at 0
        (([1], [1]), ([-1], [1])),  # not well posed
        (([1, -1], np.poly([1, -2])), ([1], [1])),  # a hidden unstable mode
        (([1, 0], [1, 1]), ([1], [1, 0])),  # an integrator cancelled between plant and controller
    ],
)
def test_a_loop_that_is_not_stable_inside_has_no_margin(
    plant: tuple[list[float], list[float]], controller: tuple[list[float], list[float]]
) -> None:
    found = stability_margin(transfer_function(*plant), transfer_function(*controller))
    assert found.value == 0.0
    assert math.isnan(found.omega_worst_rad_s)


def test_the_largest_margin_of_an_integrator_is_that_of_unit_feedback() -> None:
    found = stability_margin(transfer_function([1], [1, 0]), transfer_function([1], [1]))
    assert found.value == pytest.approx(math.sqrt(0.5), abs=1e-9)


def test_a_controller_that_does_not_fit_is_refused() -> None:
    plant = random_state_space(np.random.default_rng(0), 2, 2, 1)
    with pytest.raises(ModelError, match="the controller has 1 outputs and 1 inputs"):
        stability_margin(plant, PI)
    with pytest.raises(ModelError, match="sample time"):
        stability_margin(transfer_function([1], [1, 0.5], 0.1), PI)


def test_a_gap_below_the_margin_promises_the_difference_on_the_sphere() -> None:
    promise = stability_guarantee(0.5, 0.1)
    assert promise.holds
    assert promise.margin_at_least == pytest.approx(math.sin(math.pi / 6 - math.asin(0.1)))
    assert promise.margin_at_least >= 0.4


@pytest.mark.parametrize(("margin", "gap"), [(0.3, 0.3), (0.3, 1.0), (0.0, 0.0)])
def test_a_gap_that_is_not_below_the_margin_promises_nothing(margin: float, gap: float) -> None:
    promise = stability_guarantee(margin, gap)
    assert (promise.holds, promise.margin_at_least) == (False, 0.0)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_the_promise_is_kept(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant = random_state_space(rng, 2, 1, 1)
    controller = random_state_space(rng, 2, 1, 1)
    margin = stability_margin(plant, controller).value
    for size in (0.01, 0.05, 0.2):
        other = StateSpace(plant.a + size * rng.standard_normal((2, 2)), plant.b, plant.c, plant.d)
        promise = stability_guarantee(margin, nu_gap(plant, other).value)
        found = stability_margin(other, controller).value
        assert found >= promise.margin_at_least - 1e-6
        assert found > 0 or not promise.holds


def test_the_promise_is_made_and_kept_for_a_stabilised_unstable_model() -> None:
    plant, other = transfer_function([1], [1, -1]), transfer_function([1.1], [1, -0.9])
    controller = transfer_function([2.4], [1])
    promise = stability_guarantee(
        stability_margin(plant, controller).value, nu_gap(plant, other).value
    )
    assert promise.margin_at_least > 0.2
    assert stability_margin(other, controller).value >= promise.margin_at_least
