"""Simulated arms follow the equation of motion of their joints, and behave as robots."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError
from scipy.signal import cont2discrete

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.models.linear_model import LinearModel
from nufleet.shared.robots.drivers import RobotDriver
from nufleet.shared.robots.fleet_file import FleetFile
from nufleet.sims.arms.driver import DRIVER
from nufleet.sims.arms.mechanism import (
    STEPS_PER_SAMPLE,
    Mechanism,
    nominal_inertia_kg_m2,
    servo_gains,
)
from nufleet.sims.arms.robot import Arm
from nufleet.sims.arms.settings import ArmSettings, EncoderNoise
from nufleet.testing import assert_keeps_contract

Respond = Callable[[Robot, float, int], complex]
Chordal = Callable[[complex, complex], float]

FLEET = ["target", "source-1", "source-2", "source-3", "source-4"]

SHIPPED_DAMPING_NMS = {"pusher": (1.0, 0.1), "reacher": (1.0, 1.0)}

# Pusher's tip in its home pose, with the elbow bent by 1.16 rad: from the vertical shoulder axis,
# and from the elbow axis.
TIP_DISTANCE_M = (0.1 + 0.4 + 0.321 * np.cos(1.16), 0.321)


@pytest.fixture(scope="module")
def settings(
    fleet_file: Callable[[str], FleetFile],
    settings_of: Callable[[FleetFile, RobotDriver], dict[str, Any]],
) -> dict[str, ArmSettings]:
    return settings_of(fleet_file("arms"), DRIVER)


@pytest.fixture
def arms(settings: dict[str, ArmSettings]) -> Mapping[str, Robot]:
    """The fleet without measurement noise, connected."""
    silence = EncoderNoise(position_rad=0.0, velocity_rad_s=0.0)
    quiet = {name: own.model_copy(update={"noise": silence}) for name, own in settings.items()}
    robots = DRIVER.build(quiet, np.random.default_rng(0))
    for robot in robots.values():
        robot.connect()
    return robots


def joint_loop(settings: ArmSettings, axis: int) -> LinearModel:
    """Return the loop of one joint: a PD for the nominal inertia on the true inertia."""
    nominal = nominal_inertia_kg_m2(settings)[axis]
    inertia = nominal + settings.payload_kg * TIP_DISTANCE_M[axis] ** 2
    friction = SHIPPED_DAMPING_NMS[settings.model][axis] * settings.joint_damping_scale
    k_p = nominal * settings.natural_frequency_rad_s**2
    k_d = nominal * 2 * settings.damping_ratio * settings.natural_frequency_rad_s
    a_c = np.array([[0.0, 1.0], [-k_p / inertia, -(k_d + friction) / inertia]])
    b_c = np.array([[0.0, 0.0], [k_p / inertia, k_d / inertia]])
    a_d, b_d, *_ = cont2discrete((a_c, b_c, np.eye(1, 2), np.zeros((1, 2))), 0.02)
    # The wanted velocity is (u − last u) / T; the last state is the last reference.
    a = np.zeros((3, 3))
    a[:2, :2] = a_d
    a[:2, 2] = -b_d[:, 1] / 0.02
    b = [*(b_d[:, 0] + b_d[:, 1] / 0.02).tolist(), 1.0]
    return LinearModel(
        a=tuple(map(tuple, a.tolist())), b=tuple(b), c=(1.0, 0.0, 0.0), sample_time_s=0.02
    )


def wandering(samples: int) -> FloatArray:
    times_s = np.arange(samples)[:, np.newaxis] * 0.02
    return np.asarray(0.2 * np.sin(times_s * np.array([1.7, 2.3])))


def test_the_driver_is_one() -> None:
    driver: RobotDriver = DRIVER
    assert not driver.shares_process
    assert driver.settings is ArmSettings


def test_the_fleet_has_a_study_and_arms_that_differ(
    fleet_file: Callable[[str], FleetFile], settings: dict[str, ArmSettings]
) -> None:
    study = fleet_file("arms").study
    assert study is not None
    assert study.target == "target"
    assert list(settings) == FLEET
    assert len(set(settings.values())) == len(FLEET)
    for own in settings.values():
        assert (own.omega_min_rad_s, own.omega_max_rad_s) == study.band_rad_s


def test_an_unknown_model_is_refused(settings: dict[str, ArmSettings]) -> None:
    with pytest.raises(ValidationError, match="model"):
        ArmSettings.model_validate(settings["target"].model_dump() | {"model": "hexapod"})


@pytest.mark.parametrize("name", FLEET)
def test_an_arm_describes_itself(name: str, arms: Mapping[str, Robot]) -> None:
    spec = arms[name].spec
    assert [(axis.name, axis.unit) for axis in spec.axes] == [("shoulder", "rad"), ("elbow", "rad")]
    assert arms[name].state_names == ("position", "velocity")
    assert spec.simulated


@pytest.mark.parametrize("name", FLEET)
@pytest.mark.parametrize("axis", [0, 1])
def test_a_joint_responds_as_its_equation_of_motion(
    name: str,
    axis: int,
    settings: dict[str, ArmSettings],
    arms: Mapping[str, Robot],
    respond: Respond,
    chordal: Chordal,
) -> None:
    omegas = np.array([0.5, 3.0, 8.0, 12.0])
    expected = joint_loop(settings[name], axis).frequency_response(omegas)
    for omega, z in zip(omegas, expected, strict=True):
        measured = respond(arms[name], float(omega), axis)
        assert chordal(measured, complex(z)) < 0.01, (omega, measured, z)


@pytest.mark.parametrize(
    ("source", "axis", "expected"),
    [
        ("source-1", 0, 0.099),
        ("source-1", 1, 0.205),
        ("source-2", 0, 0.092),
        ("source-2", 1, 0.081),
        ("source-3", 0, 0.245),
        ("source-3", 1, 0.247),
        ("source-4", 0, 0.046),
        ("source-4", 1, 0.054),
    ],
)
def test_the_distances_to_the_target_are_what_they_were_when_the_fleet_was_fixed(
    source: str,
    axis: int,
    expected: float,
    arms: Mapping[str, Robot],
    respond: Respond,
    chordal: Chordal,
) -> None:
    worst = max(
        chordal(respond(arms["target"], omega, axis), respond(arms[source], omega, axis))
        for omega in (7.9, 9.7, 12.0)
    )
    assert worst == pytest.approx(expected, abs=0.01)


@pytest.mark.parametrize("name", ["target", "source-4"])
def test_however_a_signal_is_cut_the_outputs_are_the_same(
    name: str, arms: Mapping[str, Robot]
) -> None:
    robot, references = arms[name], wandering(300)
    whole = robot.run(references)
    after = robot.observe()
    robot.disconnect()
    robot.connect()
    single = [robot.step(reference) for reference in references[:30]]
    pieces = [robot.run(piece) for piece in np.split(references[30:], [1, 200])]
    np.testing.assert_allclose(np.concatenate([single, *pieces]), whole, atol=1e-12)
    np.testing.assert_allclose(robot.observe(), after, atol=1e-11)


def test_what_is_observed_is_a_noisy_state_and_the_next_output(
    settings: dict[str, ArmSettings], arms: Mapping[str, Robot]
) -> None:
    quiet = arms["target"]
    noisy = DRIVER.build({"noisy": settings["target"]}, np.random.default_rng(4))["noisy"]
    noisy.connect()
    errors, states = [], []
    for reference in wandering(600):
        seen, true = noisy.observe(), quiet.observe()
        errors.append(seen - true)
        states.append(true)
        np.testing.assert_array_equal(noisy.step(reference), seen[:, 0])
        quiet.step(reference)
    np.testing.assert_allclose(np.std(errors, axis=0), np.tile([0.0002, 0.005], (2, 1)), rtol=0.1)
    position, velocity = np.moveaxis(np.array(states)[10:], 2, 0)
    change = (position[2:] - position[:-2]) / 0.04
    np.testing.assert_allclose(change, velocity[1:-1], atol=0.01)


@pytest.mark.parametrize("name", FLEET)
def test_resting_brings_an_arm_back_to_its_home_pose(name: str, arms: Mapping[str, Robot]) -> None:
    robot = arms[name]
    robot.run(wandering(233))
    assert np.abs(robot.observe()[:, 0]).max() > 0.05
    robot.rest()
    assert np.abs(robot.observe()).max() < 0.01


def test_an_arm_held_back_by_its_torque_limit_fails_until_it_is_connected_anew(
    settings: dict[str, ArmSettings],
) -> None:
    weak = settings["target"].model_copy(update={"torque_max_nm": 0.5})
    robot = DRIVER.build({"weak": weak}, np.random.default_rng(0))["weak"]
    robot.connect()
    with pytest.raises(RobotError, match=r"weak stopped following its reference .* s into its"):
        robot.run(np.tile([1.5, 0.0], (100, 1)))
    with pytest.raises(RobotError, match="reconnected"):
        robot.step(np.zeros(2))
    robot.connect()
    robot.rest()


FRICTION_NM = (0.3, 0.04)


@pytest.fixture
def worn(settings: dict[str, ArmSettings]) -> Robot:
    """The target with friction in its joints, without measurement noise, connected."""
    silence = EncoderNoise(position_rad=0.0, velocity_rad_s=0.0)
    own = settings["target"].model_copy(update={"noise": silence, "joint_friction_nm": FRICTION_NM})
    robot = DRIVER.build({"worn": own}, np.random.default_rng(0))["worn"]
    robot.connect()
    return robot


@pytest.mark.parametrize("speed_rad_s", [0.02, 0.1, -0.1])
def test_friction_takes_the_same_torque_from_the_servo_at_any_speed(
    speed_rad_s: float, settings: dict[str, ArmSettings], worn: Robot
) -> None:
    """At constant speed the spring of the servo balances friction: k e = f + b v."""
    times_s = np.arange(200)[:, np.newaxis] * 0.02
    references = np.tile(speed_rad_s * times_s, (1, 2))
    # The reference moves in steps; on average it is where it was half a sample ago.
    lag_rad = (references - worn.run(references))[-1] - 0.01 * speed_rad_s
    stiffness, _ = servo_gains(settings["target"])
    expected = np.sign(speed_rad_s) * np.array(FRICTION_NM)
    expected += np.array(SHIPPED_DAMPING_NMS["pusher"]) * speed_rad_s
    np.testing.assert_allclose(lag_rad, expected / stiffness, rtol=0.1)


def test_friction_holds_a_joint_where_it_stopped_and_that_is_rest(
    settings: dict[str, ArmSettings], worn: Robot
) -> None:
    stiffness, _ = servo_gains(settings["target"])
    worn.run(wandering(233))
    worn.rest()
    away = np.abs(worn.measure_output())
    assert away.max() > 0.001
    assert (away <= 1.1 * np.array(FRICTION_NM) / stiffness).all()


def test_the_worn_fleet_differs_in_friction_load_and_tuning(
    fleet_file: Callable[[str], FleetFile],
    settings_of: Callable[[FleetFile, RobotDriver], dict[str, Any]],
) -> None:
    worn: dict[str, ArmSettings] = settings_of(fleet_file("worn_arms"), DRIVER)
    assert len(set(worn.values())) == len(worn) == 5
    assert worn["source-2"].friction_nm == (0.0, 0.0)
    assert worn["target"].joint_friction_nm == worn["source-1"].joint_friction_nm == FRICTION_NM


def test_a_minute_is_one_call_of_a_compiled_program(
    arms: Mapping[str, Robot], monkeypatch: pytest.MonkeyPatch
) -> None:
    """How long it takes is measured by `python -m benchmarks.simulators`."""
    robot = arms["target"]
    assert isinstance(robot, Arm)
    rollouts: list[int] = []
    rollout = robot._mechanism._rollout

    class Counted:
        def rollout(self, model: object, data: object, state: object, control: FloatArray) -> Any:
            rollouts.append(control.shape[1])
            return rollout.rollout(model, data, state, control)

    monkeypatch.setattr(robot._mechanism, "_rollout", Counted())
    robot.run(wandering(3000))
    assert rollouts == [3000 * STEPS_PER_SAMPLE]


def test_an_arm_keeps_the_contract_of_a_robot(settings: dict[str, ArmSettings]) -> None:
    robots = DRIVER.build({"target": settings["target"]}, np.random.default_rng(0))
    assert_keeps_contract(robots["target"])


@pytest.mark.parametrize(("fleet", "pushes"), [("arms", False), ("pitch_arms", True)])
def test_joints_push_each_other_if_they_turn_about_parallel_axes(
    fleet: str,
    pushes: bool,
    fleet_file: Callable[[str], FleetFile],
    settings_of: Callable[[FleetFile, RobotDriver], dict[str, Any]],
) -> None:
    mechanism = Mechanism(settings_of(fleet_file(fleet), DRIVER)["target"])
    times_s = 0.02 * np.arange(100)
    references = np.zeros((100, len(mechanism.state)))
    references[:, 0] = 0.1 * np.sin(9.0 * times_s)
    moved = np.abs(mechanism.play(references)[:, :, 0]).max(axis=0)
    assert (moved[1] > 0.1 * moved[0]) == pushes


def test_friction_is_that_of_every_joint_or_of_none(settings: dict[str, ArmSettings]) -> None:
    wrong = settings["target"].model_dump() | {"model": "pusher_pitch", "joint_friction_nm": (0.1,)}
    with pytest.raises(ValidationError, match="a value for each of shoulder, elbow, wrist"):
        ArmSettings.model_validate(wrong)
