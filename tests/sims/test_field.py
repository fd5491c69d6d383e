"""A simulated robot that plays a real one: late, jittery, on a battery, on the ground at first."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest

from nufleet.orchestrator.conduct.attempts import estimated
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.robot_agent.motion.pace import HaltSwitch
from nufleet.robot_agent.motion.perform import AxisMotion, Played, perform
from nufleet.robot_agent.robot import Robot
from nufleet.shared.errors import RobotDownError, RobotError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.models.linear_model import LinearModel
from nufleet.shared.wire.messages import GoalResult, Outcome
from nufleet.sims.faulty_robot import FAULTY, FaultyRobotSettings

INNER = {"alpha": 1.0, "beta": 0.003, "noise_std_m": 0.001}
LINK = {"delay_s": 0.02, "jitter_s": 0.008, "loss": 0.01}


def robot_in(seed: int = 0, **field: Any) -> Robot:
    document = {"driver": "double_integrator", "settings": INNER, "field": field}
    settings = FaultyRobotSettings.model_validate_json(json.dumps(document))
    robot = FAULTY.build({"a": settings}, np.random.default_rng(seed))["a"]
    robot.connect()
    return robot


def played(robot: Robot, *omegas_rad_s: float) -> tuple[Played, FrequencyResponse]:
    tones = tuple(Tone(omega_rad_s=omega) for omega in omegas_rad_s)
    plan = plan_excitation(Excitation(axis="x", tones=tones), robot.spec, "a")
    switch = HaltSwitch()
    motion = AxisMotion(
        robot,
        ["x"],
        reference_of(plan),
        realtime=None,
        switch=switch,
        on_samples=lambda *_: None,
    )
    result = perform(robot, motion, switch, on_resting=lambda: None)
    response = estimated(
        GoalResult(
            goal_id="a",
            boot_id="b",
            outcome=result.outcome,
            reason=result.reason,
            plan=plan,
            reference=result.samples.reference,
            response=result.samples.response,
            timing=result.samples.timing,
        )
    )
    return result, response


def true_response(robot: Robot, omegas_rad_s: np.ndarray) -> np.ndarray:
    model = robot.spec.axes[0].model
    assert isinstance(model, LinearModel)
    a, b, c = np.asarray(model.a), np.asarray(model.b), np.asarray(model.c)
    z = np.exp(1j * omegas_rad_s * model.sample_time_s)
    return np.array([c @ np.linalg.solve(one * np.eye(len(b)) - a, b) for one in z])


def test_a_step_returns_what_has_arrived_and_the_record_what_was_measured() -> None:
    references = np.sin(0.1 * np.arange(300))[:, np.newaxis]
    truth = robot_in().run(references)
    late = robot_in(delay_s=0.029)  # two samples
    outputs = late.run(references)
    np.testing.assert_array_equal(outputs[2:], truth[:-2])
    record = late.record()
    assert record is not None
    np.testing.assert_array_equal(record.outputs, truth)
    np.testing.assert_array_equal(record.sample_s, record.measured_s)


def test_responses_through_a_poor_link_hold_the_truth_as_often_as_they_claim() -> None:
    """The delay of 20 ms alone would turn the phase at 6 rad/s by twenty of these intervals."""
    omegas = np.geomspace(1.5, 9.0, 10)
    hits = total = 0
    for seed in range(20):
        robot = robot_in(seed, **LINK)
        _, response = played(robot, *omegas.tolist())
        assert response.quality.usable, response.quality
        error = np.abs(response.z - true_response(robot, response.omega_rad_s))
        hits += int(np.sum(error <= response.radius(0.05)))
        total += len(error)
    assert total == 200
    assert hits >= 0.95 * total - 2 * math.sqrt(0.95 * 0.05 * total)


def test_a_link_that_loses_much_is_reported_and_one_that_breaks_fails_the_test() -> None:
    _, response = played(robot_in(delay_s=0.02, loss=0.6), 4.0)
    assert "gaps" in {finding.code for finding in response.quality.warnings}
    result, _ = played(robot_in(loss=0.97), 4.0)
    assert result.outcome is Outcome.FAILED
    assert "nothing was measured for" in result.reason


def test_a_battery_empties_with_motion_and_keeps_a_reserve() -> None:
    robot = robot_in(battery_s=9.0)
    robot.run(np.zeros((300, 1)))
    health = robot.health()
    assert health is not None
    assert health.battery == pytest.approx(0.5)
    assert health.endurance_s == pytest.approx(0.4 * 9.0)
    robot.run(np.zeros((290, 1)))
    health = robot.health()
    assert health is not None
    assert (health.ready, health.reason) == (False, "its battery is empty: charge it")
    with pytest.raises(RobotDownError, match="battery is empty"):
        robot.run(np.zeros((20, 1)))


def test_it_stands_on_the_ground_until_it_begins() -> None:
    robot = robot_in(takes_off=True)
    for call in (robot.measure_output, lambda: robot.step(np.zeros(1))):
        with pytest.raises(RobotError, match="on the ground"):
            call()
    robot.begin()
    robot.step(np.zeros(1))
    robot.rest()
    robot.end()
    with pytest.raises(RobotError, match="on the ground"):
        robot.step(np.zeros(1))


def test_a_switch_cuts_its_motors_until_it_is_connected_again() -> None:
    with pytest.raises(RobotError, match="no way of cutting"):
        robot_in().kill()
    robot = robot_in(switch=True)
    robot.kill()
    for call in (lambda: robot.step(np.zeros(1)), robot.rest, robot.end):
        with pytest.raises(RobotDownError):
            call()
    robot.connect()
    robot.step(np.zeros(1))
