"""What the driver makes a vehicle do, flown against the simulated one on a virtual clock."""

from __future__ import annotations

import numpy as np
import pytest
from mavlink_air import ROUGH, Air, Unpaced, air

from nufleet.robot_agent.motion.resampling import outputs_at_samples
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.sims.mavlink_vehicle.loop import LoopSettings, frequency_response
from nufleet.testing import check_robot

PROFILES = ("px4", "ardupilot")


def tone(flown: Air, omega_rad_s: float, amplitude_m: float, samples: int) -> complex:
    """Play a tone on x; return the response at its frequency, estimated from the record."""
    robot = flown.robot
    k, step_s = np.arange(samples), robot.spec.sample_time_s
    envelope = np.clip(np.minimum(k, samples - 1 - k) / 150, 0, 1)
    references = np.zeros((samples, 2))
    references[:, 0] = amplitude_m * np.sin(omega_rad_s * k * step_s) * envelope
    for reference in references:
        robot.step(reference)
    record = robot.record()
    assert record is not None
    assert record.clock_std_s in (1e-3 / np.sqrt(12), 1e-6 / np.sqrt(12))
    outputs, _ = outputs_at_samples(record, samples, robot.spec)
    robot.rest()
    kernel: FloatArray = np.hanning(samples) * np.exp(-1j * omega_rad_s * k * step_s)
    return complex((kernel @ outputs[:, 0]) / (kernel @ references[:, 0]))


@pytest.mark.parametrize("profile", PROFILES)
def test_it_takes_off_flies_a_tone_as_the_loop_answers_it_and_lands(profile: str) -> None:
    flown = air(ROUGH, profile=profile)
    flown.robot.connect()
    assert not flown.vehicle.armed
    assert flown.vehicle.position[2] == 0
    flown.robot.begin()
    assert flown.vehicle.mode == {"px4": "offboard", "ardupilot": "guided"}[profile]
    assert flown.vehicle.position == pytest.approx([0.0, 0.0, 1.5], abs=0.05)
    truth = frequency_response(
        LoopSettings(),
        np.array([3.0]),
        0.02,
        feed_forward=True,
        link_delay_s=ROUGH.delay_s,
        link_jitter_s=ROUGH.jitter_s,
        link_loss=ROUGH.loss,
    )[0]
    assert abs(tone(flown, 3.0, 0.2, 700) - truth) < 0.012
    flown.robot.end()
    assert (flown.vehicle.armed, flown.vehicle.in_air) == (False, False)
    flown.robot.disconnect()


def test_odometry_with_its_microseconds_gives_the_same_response() -> None:
    flown = air(measured_by="ODOMETRY", feed_forward=False, telemetry_hz=100.0).in_the_air()
    truth = frequency_response(
        LoopSettings(), np.array([4.0]), 0.02, feed_forward=False, link_delay_s=0.002
    )[0]
    assert abs(tone(flown, 4.0, 0.1, 500) - truth) < 0.01
    flown.robot.step(np.array([0.3, 0.0]))
    flown.hold(0.1)
    states = flown.robot.observe()
    vehicle = flown.vehicle.loop
    assert states[:, 1] == pytest.approx(vehicle.velocity[:2], abs=0.1)
    assert states[0, 1] > 0.05


@pytest.mark.parametrize("profile", PROFILES)
def test_the_driver_keeps_the_contract(profile: str) -> None:
    robot = Unpaced(air(profile=profile).robot)
    report = check_robot(robot, cuts=True)
    assert not report.failed, str(report)
    assert all(one.holds for one in report.examined), str(report)


def test_set_points_go_on_between_motions_and_the_vehicle_stays() -> None:
    flown = air().in_the_air()
    before = flown.vehicle.set_points
    flown.wait(10.0)
    assert flown.vehicle.set_points - before == pytest.approx(500, abs=5)
    assert flown.vehicle.mode == "offboard"
    assert flown.robot.measure_output() == pytest.approx([0.0, 0.0], abs=0.02)


def test_a_motion_whose_next_sample_does_not_come_is_held_where_it_is() -> None:
    flown = air().in_the_air()
    for k in range(50):
        flown.robot.step(np.array([0.005 * k, 0.0]))
    flown.wait(3.0)
    assert flown.vehicle.mode == "offboard"
    assert flown.vehicle.position[:2] == pytest.approx([0.245, 0.0], abs=0.02)
    flown.robot.rest()
    assert flown.vehicle.position[:2] == pytest.approx([0.0, 0.0], abs=0.04)


def test_references_and_outputs_are_counted_from_the_place_of_take_off_or_from_the_origin() -> None:
    stands = {"stands_at_m": (3.0, 4.0)}
    vehicle = air().vehicle._settings.model_copy(update=stands)
    here = air(vehicle=vehicle, yaw_deg=0.0).in_the_air()
    assert here.vehicle.position == pytest.approx([3.0, 4.0, 1.5], abs=0.05)
    there = air(vehicle=vehicle, origin_m=(2.0, 4.5), height_m=1.0).in_the_air()
    assert there.vehicle.position == pytest.approx([2.0, 4.5, 1.0], abs=0.05)
    assert there.robot.measure_output() == pytest.approx([0.0, 0.0], abs=0.05)
    far = air(vehicle=vehicle, origin_m=(-2.0, 4.0))
    far.robot.connect()
    with pytest.raises(RobotError, match=r"stands 5\.0 m from its origin_m"):
        far.robot.begin()
    assert not far.vehicle.armed


def test_a_vehicle_that_flies_is_landed_before_it_is_released() -> None:
    flown = air().in_the_air()
    flown.robot.disconnect()
    assert (flown.vehicle.armed, flown.vehicle.in_air) == (False, False)
