"""Air resists with the square of the airspeed, and its gusts last as long as they are said to."""

from __future__ import annotations

from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import ValidationError

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.robots.fleet_file import FleetFile
from nufleet.sims.quadrotors.driver import DRIVER
from nufleet.sims.quadrotors.moving_air import drag_force, moving_air, next_gust
from nufleet.sims.quadrotors.settings import Air, AttitudeVehicle, QuadrotorSettings, SensorNoise

SILENCE = SensorNoise(position_m=0.0, velocity_m_s=0.0, tilt_rad=0.0)
SPEED_M_S = 0.5


def in_air(settings: QuadrotorSettings, air: Air) -> Robot:
    quiet = settings.model_copy(update={"noise": SILENCE, "air": air})
    robot = DRIVER.build({"robot": quiet}, np.random.default_rng(3))["robot"]
    robot.connect()
    return robot


def test_at_constant_speed_a_vehicle_lags_by_its_drag_over_its_stiffness(
    paper_settings: dict[str, QuadrotorSettings],
) -> None:
    """At rest in the moving frame, e / τ² = d v + ½ ρ C_D A v² / m."""
    settings = paper_settings["source-5"]
    vehicle = settings.vehicle
    assert isinstance(vehicle, AttitudeVehicle)
    drag_area_m2 = 0.3
    robot = in_air(settings, Air(drag_area_m2=drag_area_m2))
    reference = np.zeros((600, 2))
    reference[:, 0] = SPEED_M_S * 0.02 * np.arange(600)
    # The reference moves in steps; on average it is where it was half a sample ago.
    lag_m = float((reference - robot.run(reference))[-1, 0]) - 0.01 * SPEED_M_S
    deceleration = vehicle.drag_1_s * SPEED_M_S + 0.6 * drag_area_m2 * SPEED_M_S**2 / 0.5
    assert lag_m == pytest.approx(deceleration * vehicle.time_constant_s**2, rel=0.03)


def test_the_force_is_against_the_airspeed_and_grows_with_its_square() -> None:
    air = moving_air(Air(drag_area_m2=0.1), 0)._replace(wind_m_s=jnp.array([1.0, 0.0]))
    force = np.asarray(drag_force(air, jnp.array([4.0, 4.0, 0.0])))
    np.testing.assert_allclose(force, -0.06 * 5.0 * np.array([3.0, 4.0, 0.0]), rtol=1e-5)
    np.testing.assert_allclose(drag_force(air, jnp.array([1.0, 0.0, 0.0])), np.zeros(3))


def test_gusts_have_their_standard_deviation_and_their_duration() -> None:
    air = moving_air(Air(drag_area_m2=0.0, gust_std_m_s=0.2, gust_time_s=0.5), seed=1)
    _, winds = jax.lax.scan(lambda a, _: (next_gust(a), a.wind_m_s), air, length=200_000)
    wind: FloatArray = np.asarray(winds, dtype=np.float64)[1000:]
    np.testing.assert_allclose(wind.std(axis=0), 0.2, rtol=0.05)
    later = (wind[50:] * wind[:-50]).mean(axis=0) / wind.var(axis=0)  # 0.5 s later
    np.testing.assert_allclose(later, np.exp(-1.0), atol=0.05)
    assert abs(np.corrcoef(wind.T)[0, 1]) < 0.1


def test_the_gusts_of_two_robots_differ_and_those_of_a_seed_return(
    paper_settings: dict[str, QuadrotorSettings],
) -> None:
    gusty = Air(drag_area_m2=0.1, gust_std_m_s=1.0)
    settings = paper_settings["source-5"].model_copy(update={"noise": SILENCE, "air": gusty})
    hover = np.zeros((50, 2))

    def flown() -> list[FloatArray]:
        robots = DRIVER.build({"a": settings, "b": settings}, np.random.default_rng(5))
        for robot in robots.values():
            robot.connect()
        return [robot.run(hover) for robot in robots.values()]

    (one, two), (again, _) = flown(), flown()
    assert np.abs(one - two).max() > 1e-4
    np.testing.assert_array_equal(one, again)


def test_air_that_does_not_exist_is_refused() -> None:
    for wrong in ({"drag_area_m2": -0.1}, {"drag_area_m2": 0.1, "gust_time_s": 0.0}):
        with pytest.raises(ValidationError):
            Air.model_validate(wrong)


def test_the_fleet_with_parcels_differs_in_payload_and_drag(
    fleet_file: Callable[[str], FleetFile],
    settings_of: Callable[..., dict[str, QuadrotorSettings]],
) -> None:
    settings = settings_of(fleet_file("parcels"), DRIVER)
    assert len(set(settings.values())) == len(settings) == 5
    limits = {own.tracking for own in settings.values()}
    assert [each.speed_max for each in limits] == [1.8]
    without = {name for name, own in settings.items() if own.air is None}
    assert without == {"source-2", "source-3"}
