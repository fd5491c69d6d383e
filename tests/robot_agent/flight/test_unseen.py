"""What of a path a robot has seen nothing like is told with its prediction."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from learned_things import flown_before
from robots_that_learn import double_integrator

from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.own_model import OwnModel
from nufleet.robot_agent.flight.unseen import unseen
from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.error_belief import believe
from nufleet.shared.models.evidence import Evidence
from nufleet.shared.paths.trajectories import travel

AXES = double_integrator().spec.axes
POINTS = np.array([[0.0], [0.3], [0.0]])


@pytest.fixture(scope="module")
def model() -> OwnModel:
    """The model of a robot that has flown for a while."""
    spec, memory = double_integrator().spec, Memory(None)
    memory.learn(flown_before(spec))
    known = memory.own_model(spec).model
    assert known is not None
    return known


def path(scale: float = 1.0, speed: float = 0.5) -> FloatArray:
    return travel(scale * POINTS, speed, 1.0, double_integrator().spec.sample_time_s)


def known_until(model: OwnModel, largest: float) -> OwnModel:
    return replace(model, axes=tuple(replace(axis, largest=largest) for axis in model.axes))


def test_nothing_is_said_of_a_path_like_those_that_were_flown(model: OwnModel) -> None:
    assert unseen(model, AXES, path()) == ""


def test_a_motion_larger_than_all_before_is_stated_with_both_sizes(model: OwnModel) -> None:
    found = unseen(known_until(model, 0.01), AXES, path())
    assert "smaller than this path (x 10 mm RMS instead of 111 mm)" in found
    assert "--rich-flight" in found


def test_an_axis_that_never_moved_is_named(model: OwnModel) -> None:
    resting = replace(model, axes=tuple(replace(axis, flown_s=0.0) for axis in model.axes))
    assert unseen(resting, AXES, path()).startswith("it has never moved x:")


def test_an_axis_that_the_path_does_not_move_is_of_no_concern(model: OwnModel) -> None:
    resting = replace(model, axes=tuple(replace(axis, flown_s=0.0) for axis in model.axes))
    assert unseen(resting, AXES, np.zeros((100, 1))) == ""


def test_motion_at_frequencies_of_unknown_response_is_stated_with_its_share(
    model: OwnModel,
) -> None:
    (axis,) = model.axes
    time_s = axis.basis.sample_time_s * np.arange(4000)
    slow, fast = 0.3 * np.sin(0.5 * time_s), 0.02 * np.sin(25 * time_s)
    noise = 2e-3 * np.random.default_rng(0).standard_normal(len(time_s))
    evidence = Evidence.of(axis.basis, slow, slow - axis.error(slow, 0.0) + noise, 0.0)
    lately = replace(model, axes=(believe(axis.basis, evidence),))
    assert unseen(lately, AXES, slow[:, np.newaxis]) == ""
    found = unseen(lately, AXES, (slow + fast)[:, np.newaxis])
    assert found.startswith(
        "92 % of this path's motion along x, around 25 rad/s, is at frequencies"
    )
