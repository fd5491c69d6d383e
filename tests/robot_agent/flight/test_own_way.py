"""A robot flies with its model of itself in the way that leaves less, and says why."""

from __future__ import annotations

import numpy as np
import pytest
from learned_things import experience, layout
from robots_that_learn import LaggedRobot
from test_flights import flown

from nufleet.robot_agent.flight.learning import learn
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.file import digest
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.text import in_thousandths
from nufleet.shared.wire.motions import RichFlight, Tracking, TrackingDetails

PATH = travel(np.tile([[0.0, 0.0], [0.5, 0.5], [-0.4, 0.2], [0.3, -0.5]], (4, 1)), 0.5, 1.0, 0.02)
"""Half a minute, in which the push changes often."""

NOISE_M = 5e-4

COUPLING = 0.008
"""An eighth of the error that the axis leaves itself, which is 60 ms late."""


class Pushed(LaggedRobot):
    """A slow disturbance moves it by 1 cm."""

    def __init__(self) -> None:
        super().__init__(noise_std_m=NOISE_M)
        self._push, self._pushes = np.zeros(2), np.random.default_rng(7)

    def observe(self) -> FloatArray:
        return super().observe() + self._push[:, np.newaxis]

    def step(self, reference: FloatArray) -> FloatArray:
        output = super().step(reference)
        # A first-order process with a time constant of 1 s.
        self._push = 0.98 * self._push + 0.01 * np.sqrt(1 - 0.98**2) * self._pushes.normal(size=2)
        return output

    def rest(self) -> None:
        super().rest()
        self._push = np.zeros(2)


class Coupled(LaggedRobot):
    """What its axis y does moves its axis x a little."""

    def __init__(self) -> None:
        super().__init__(noise_std_m=NOISE_M)

    def observe(self) -> FloatArray:
        observed = super().observe()
        observed[0] += COUPLING * observed[1]
        return observed

    def measure_output(self) -> FloatArray:
        measured = super().measure_output()
        return np.array([measured[0] + COUPLING * measured[1], measured[1]])


def own_flight(robot: Robot) -> tuple[float, TrackingDetails]:
    """Have a robot fly the path with its model of itself, after half a minute of flight."""
    memory = Memory(None)
    flown(robot, RichFlight(duration_s=30.0, seed=1), memory)
    played = flown(robot, Tracking(desired=PATH, inverse="own"), memory)
    details = played.samples.details
    assert isinstance(details, TrackingDetails)
    distance = played.samples.response - PATH
    return float(np.sqrt(np.mean(np.sum(distance**2, axis=1)))), details


def test_a_linear_robot_flies_references_that_are_known_ahead() -> None:
    error, details = own_flight(LaggedRobot(noise_std_m=NOISE_M))
    assert not details.mean.any()
    assert details.way is not None
    assert details.way.startswith("it flew with references known ahead: ")
    assert details.predicted is not None
    assert f": {in_thousandths(details.predicted.rms, 'm')} RMS were expected" in details.way
    assert error == pytest.approx(details.predicted.rms, rel=0.1)


def test_a_robot_that_is_pushed_about_flies_with_a_feedback_of_its_output() -> None:
    """The push lasts much longer than its answer takes, 60 ms, so most of it can be corrected."""
    error, details = own_flight(Pushed())
    assert details.mean.any()
    assert details.way is not None
    assert "with a feedback of its output" in details.way
    assert details.taken_back is None
    assert error < 0.7 * 0.01 * np.sqrt(2)  # of a push of 0.01 m on either axis
    assert details.predicted is not None
    assert details.predicted.low <= error <= details.predicted.high


def test_a_prior_that_is_taken_back_gives_way_to_the_model_with_its_feedback() -> None:
    """The feedback has followed the flight from its beginning."""
    robot, memory = Pushed(), Memory(None)
    flown(robot, RichFlight(duration_s=30.0, seed=1), memory)
    wrong = experience(layout=layout(sample_time_s=0.02), robot_kind="lagged", axes=("x", "y"))
    kept = memory.keep_prior(wrong, digest(wrong))
    kept.inverse._layers[0][0][:] = -40.0  # asks for far too much of every point ahead
    motion = Tracking(desired=PATH, inverse="prior", prior_sha256=digest(wrong), learn=False)
    played = flown(robot, motion, memory)
    details = played.samples.details
    assert isinstance(details, TrackingDetails)
    assert details.taken_back is not None
    assert details.taken_back.given_to == "own"
    left = (played.samples.response - PATH)[details.taken_back.sample + 60 :]
    assert np.sqrt(np.mean(np.sum(left**2, axis=1))) < 0.75 * 0.01 * np.sqrt(2)


def test_a_path_along_which_axes_act_on_each_other_teaches_no_response() -> None:
    """What y does to x is no answer of x to its own reference; the feedback corrects most of it."""
    robot, memory = Coupled(), Memory(None)
    for axis in range(2):
        time_s = np.arange(1000) * 0.02
        reference = np.zeros((1000, 2))
        reference[:, axis] = 0.1 * np.sin(time_s) * np.sin(2.7 * time_s)
        outputs = np.stack([robot.step(each) for each in reference])
        robot.rest()
        alone = np.arange(2) == axis
        learn(memory, robot.spec, reference, outputs * alone)
    before = memory.own_model(robot.spec).model
    baseline = flown(robot, Tracking(desired=PATH, inverse="baseline"), memory)
    played = flown(robot, Tracking(desired=PATH, inverse="own"), memory)
    after = memory.own_model(robot.spec).model
    assert before is not None
    assert after is not None
    np.testing.assert_array_equal(after.axes[0].mean, before.axes[0].mean)
    assert after.axes[1].flown_s > before.axes[1].flown_s
    details = played.samples.details
    assert isinstance(details, TrackingDetails)
    assert details.findings == ()
    assert details.mean.any()
    left, usual = (np.std((each.samples.response - PATH)[:, 0]) for each in (played, baseline))
    assert left < 0.4 * usual
