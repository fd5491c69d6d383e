"""What a robot will know of itself after a flight that it has not flown."""

from __future__ import annotations

import math

import numpy as np
import pytest
from robots_that_learn import LaggedRobot
from scipy.signal import lfilter

from nufleet.robot_agent.flight.after_flight import own_error_after
from nufleet.robot_agent.flight.forecast import forecast_of
from nufleet.robot_agent.flight.learning import learn
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.own_model import OwnModel
from nufleet.shared.paths.references import rich_references
from nufleet.shared.paths.trajectories import travel

PATH = travel(np.array([[0.0, 0.0], [0.5, 0.5], [-0.4, 0.2]]), 0.9, 1.8, 0.02)


def flown(memory: Memory, references: np.ndarray) -> OwnModel:
    robot = LaggedRobot(noise_std_m=1e-3)
    learn(memory, robot.spec, references, robot.run(references))
    model = memory.own_model(robot.spec).model
    assert model is not None
    return model


@pytest.fixture
def little() -> tuple[Memory, OwnModel]:
    """A robot that knows itself from one slow and noisy motion."""
    memory = Memory(None)
    slow = travel(np.array([[0.0, 0.0], [0.02, 0.02], [0.0, 0.0]]), 0.05, 0.05, 0.02)
    return memory, flown(memory, slow)


def test_more_flight_is_expected_to_leave_less(little: tuple[Memory, OwnModel]) -> None:
    """Apart from three hundredths, for which a robot flies references known ahead."""
    model, spec = little[1], LaggedRobot().spec
    now = forecast_of(model, PATH)
    assert now is not None
    after = [own_error_after(model, spec, PATH, flight_s) for flight_s in (15.0, 60.0)]
    assert now.own.rms > after[0].rms
    assert after[1].rms < 1.03 * after[0].rms


def test_it_is_what_the_robot_finds_once_it_has_flown(little: tuple[Memory, OwnModel]) -> None:
    memory, model = little
    spec = LaggedRobot().spec
    expected = own_error_after(model, spec, PATH, 30.0)
    found = flown(memory, rich_references(spec, 30.0, np.random.default_rng(1)))
    now = forecast_of(found, PATH)
    assert now is not None
    assert 0.8 * expected.low <= now.own.rms <= 1.25 * expected.high


def test_a_robot_that_is_pushed_about_does_not_expect_to_learn_as_if_it_were_not() -> None:
    """Gusts of a second leave few independent samples, in the flight to come as well."""

    def pushed(references: np.ndarray, seed: int) -> np.ndarray:
        white = np.random.default_rng(seed).standard_normal((len(references) + 300, 2))
        gusts = 0.01 * math.sqrt(1 - 0.98**2) * lfilter([1.0], [1.0, -0.98], white, axis=0)[300:]
        return np.asarray(LaggedRobot(noise_std_m=1e-3).run(references) + gusts)

    spec = LaggedRobot().spec
    slow = travel(np.array([[0.0, 0.0], [0.2, 0.2], [-0.2, 0.0], [0.0, 0.0]]), 0.2, 0.3, 0.02)
    for seed in range(4):
        memory = Memory(None)
        learn(memory, spec, slow, pushed(slow, seed))
        before = memory.own_model(spec).model
        assert before is not None
        expected = own_error_after(before, spec, PATH, 30.0)
        flight = rich_references(spec, 30.0, np.random.default_rng(seed))
        learn(memory, spec, flight, pushed(flight, 100 + seed))
        found = forecast_of(memory.own_model(spec).model, PATH)
        assert found is not None
        assert expected.low < found.own.rms < expected.high
