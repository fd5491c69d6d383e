"""A simulated robot rests, refuses and fails in the same way with any simulator inside."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.sims.measurement_noise import MeasurementNoise
from nufleet.sims.simulated_robot import RestRule, SimulatedRobot, path_to_rest

SAMPLE_TIME_S = 0.1
RULE = RestRule(speed=0.5, position_max=0.01, velocity_max=0.01, patience_s=20.0)


class FollowingCart(SimulatedRobot):
    """A cart that covers a share of the way to its reference each sample; it breaks beyond 3 m."""

    def __init__(self, share: float = 0.3) -> None:
        axis = AxisSpec(name="x", unit="m", amplitude_max=1, velocity_max=1, acceleration_max=1)
        spec = RobotSpec(
            kind="cart",
            axes=(axis,),
            sample_time_s=SAMPLE_TIME_S,
            omega_min_rad_s=0.1,
            omega_max_rad_s=5.0,
            duration_max_s=100.0,
            settling_time_s=1.0,
            simulated=True,
        )
        noise = MeasurementNoise(np.array([[0.001, 0.002]]), np.random.default_rng(1))
        super().__init__("cart", spec, ("position", "velocity"), noise, RULE)
        self.share = share
        self.position = 0.0

    def _start(self) -> FloatArray:
        self.position = 0.0
        return np.zeros((1, 2))

    def _play(self, references: FloatArray) -> FloatArray:
        positions = [self.position]
        for reference in references[:, 0]:
            positions.append(positions[-1] + self.share * (reference - positions[-1]))
        if max(np.abs(positions)) > 3:
            raise RobotError("the cart left its rail")
        velocities = np.diff(positions, append=positions[-1]) / SAMPLE_TIME_S
        self.position = positions[-1]
        return np.stack([positions, velocities], axis=1)[:, np.newaxis, :]


def connected(share: float = 0.3) -> FollowingCart:
    cart = FollowingCart(share)
    cart.connect()
    return cart


@given(
    start=st.lists(st.floats(-5, 5), min_size=1, max_size=3),
    speed=st.floats(0.05, 2.0),
)
def test_the_way_to_rest_begins_at_the_reference_ends_at_zero_and_keeps_the_speed(
    start: list[float], speed: float
) -> None:
    path = path_to_rest(np.array(start), speed, 0.02)
    steps = np.diff(np.concatenate([[start], path]), axis=0)
    assert np.abs(steps).max() <= 0.02 * speed * (1 + 1e-9)
    assert len(path) >= 50
    np.testing.assert_allclose(path[-1], 0.0, atol=1e-12)


def test_a_robot_that_is_not_connected_moves_nothing_and_can_still_be_described() -> None:
    cart = FollowingCart()
    assert cart.spec.kind == "cart"
    assert cart.state_names == ("position", "velocity")
    for act in (lambda: cart.step(np.zeros(1)), cart.rest, cart.observe):
        with pytest.raises(RobotError, match="cart is not connected"):
            act()


def test_resting_brings_the_robot_back_to_its_origin() -> None:
    cart = connected()
    cart.run(np.full((50, 1), 0.8))
    assert cart.position == pytest.approx(0.8, abs=1e-6)
    cart.rest()
    assert abs(cart.position) < RULE.position_max


def test_a_robot_that_never_comes_to_rest_says_so() -> None:
    cart = connected()
    cart.run(np.full((50, 1), 0.8))
    cart.share = 0.0
    with pytest.raises(RobotError, match="cart did not come to rest within 20 s"):
        cart.rest()


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_reference_that_is_not_finite_is_refused_and_the_robot_stays_well(bad: float) -> None:
    cart = connected()
    with pytest.raises(RobotError, match="not finite"):
        cart.step(np.array([bad]))
    cart.step(np.array([0.1]))


def test_after_a_failure_nothing_moves_until_the_robot_is_connected_anew() -> None:
    cart = connected()
    with pytest.raises(RobotError, match="left its rail"):
        cart.run(np.full((50, 1), 4.0))
    for act in (lambda: cart.step(np.zeros(1)), cart.rest, cart.observe):
        with pytest.raises(RobotError, match="reconnected: the cart left its rail"):
            act()
    cart.connect()
    assert abs(cart.observe()[0, 0]) < 0.01


def test_disconnecting_rests_first_and_may_be_repeated_even_after_a_failure() -> None:
    cart = connected()
    cart.run(np.full((50, 1), 0.8))
    cart.disconnect()
    assert abs(cart.position) < RULE.position_max
    cart.disconnect()
    cart.connect()
    with pytest.raises(RobotError):
        cart.run(np.full((50, 1), 4.0))
    cart.disconnect()


def test_connecting_a_robot_that_is_connected_changes_nothing() -> None:
    cart = connected()
    cart.run(np.full((50, 1), 0.8))
    cart.connect()
    assert cart.position == pytest.approx(0.8, abs=1e-6)


def test_what_is_observed_is_what_the_next_step_returns() -> None:
    cart = connected()
    for k in range(5):
        seen = cart.observe()
        np.testing.assert_array_equal(cart.observe(), seen)
        assert cart.step(np.array([0.1 * k])) == seen[:, 0]


def test_states_observed_on_the_way_are_those_observed_between_two_runs() -> None:
    references, observed = np.linspace(0.0, 1.0, 40)[:, np.newaxis], (0, 7, 39)
    at_once, in_parts = connected(), connected()
    outputs, states = at_once.run_observed(references, observed)
    expected = Robot.run_observed(in_parts, references, observed)
    np.testing.assert_array_equal(outputs, expected[0])
    np.testing.assert_array_equal(states[:, :, 0], expected[1][:, :, 0])
    assert states.shape == (3, 1, 2)


def test_no_samples_give_no_outputs() -> None:
    assert connected().run(np.empty((0, 1))).shape == (0, 1)
