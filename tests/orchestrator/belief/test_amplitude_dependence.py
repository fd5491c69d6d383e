"""What the amplitude does to some robots of a kind is expected of the others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_loops import BAND, SPEC, Loop

from nufleet.orchestrator.belief.amplitude_dependence import (
    FORM_HALVINGS,
    AmplitudeDependence,
    differ,
)
from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.orchestrator.study.tone_choice import first_look
from nufleet.shared.frequency_test.nonlinearity import Nonlinearity
from nufleet.shared.frequency_test.quality import Finding, Quality

OMEGA = np.array([1.0, 2.0])
FOUND = AmplitudeDependence(OMEGA, np.array([0.01, 0.04]))


def test_a_test_is_the_less_certain_the_smaller_it_is() -> None:
    largest, half, unknown = (FOUND.variance(OMEGA, one, 0.2) for one in (0.2, 0.1, None))
    np.testing.assert_allclose(largest, FORM_HALVINGS**2 * FOUND.squared)
    np.testing.assert_allclose(half, (1 + FORM_HALVINGS) ** 2 * FOUND.squared)
    np.testing.assert_allclose(unknown, largest)
    between = FOUND.variance(np.array([1.5]), 0.2, 0.2)
    np.testing.assert_allclose(between, FORM_HALVINGS**2 * 0.025)


def test_the_form_of_a_motion_does_less_where_small_motions_are_held_back() -> None:
    sticks = AmplitudeDependence.of(OMEGA, FOUND.squared, Nonlinearity.FRICTION)
    unknown = AmplitudeDependence.of(OMEGA, FOUND.squared, None)
    assert unknown.equals(FOUND)
    assert not sticks.equals(FOUND)
    assert np.all(sticks.variance(OMEGA, 0.2, 0.2) < FOUND.variance(OMEGA, 0.2, 0.2))
    # Of a fleet, the most doubtful robot counts.
    of_fleet = AmplitudeDependence.of_fleet([sticks, FOUND])
    assert of_fleet is not None
    assert of_fleet.equals(FOUND)


def test_robots_whose_responses_agreed_count_when_others_are_judged_by_them() -> None:
    of_fleet = AmplitudeDependence.of_fleet([FOUND, None])
    assert of_fleet is not None
    np.testing.assert_allclose(of_fleet.squared, FOUND.squared / 2)
    assert AmplitudeDependence.of_fleet([None, None]) is None
    assert AmplitudeDependence.of_fleet([]) is None


@pytest.mark.parametrize(
    ("one", "other", "apart"), [(0.1, 0.2, True), (0.1, 0.11, False), (None, 0.1, False)]
)
def test_amplitudes_differ_by_a_quarter(one: float | None, other: float, apart: bool) -> None:
    assert differ(one, other) is apart
    assert differ(other, one) is apart


def test_it_is_assumed_of_a_robot_until_its_own_tests_tell() -> None:
    rng = np.random.default_rng(0)
    test = first_look(BAND, SPEC, 11, 0.7).excitation("x")
    known = RobotKnowledge("robot", SPEC, BAND[1])
    known.learn(replace(Loop(3.0).answer(test, 0.01, rng), amplitude=0.2), rng)
    grid = np.linspace(1.0, 5.0, 20)

    def spread() -> float:
        return float(np.median(known.model.draw(grid, 300, rng).std(axis=0)))

    before = spread()
    known.assume(AmplitudeDependence(test_omega := np.array([0.5, 5.4]), np.full(2, 0.04)), 0.0)
    assert known.doubted
    assert spread() > 2 * before
    known.assume(AmplitudeDependence(test_omega, np.full(2, 0.04)), 0.0)
    known.learn(replace(Loop(3.0).answer(test, 0.01, rng), amplitude=0.1), rng)
    assert known.findings == ()
    known.assume(AmplitudeDependence(test_omega, np.full(2, 0.04)), 0.0)
    assert not known.doubted, "its own responses agreed"
    assert spread() < 1.5 * before


def test_a_test_that_is_distorted_does_not_show_that_amplitude_changes_nothing() -> None:
    """At half the amplitude a dead zone leaves hardly any response, which nothing contradicts."""
    rng = np.random.default_rng(0)
    test = first_look(BAND, SPEC, 11, 0.7).excitation("x")
    bent = Quality(
        warnings=(Finding(code="nonlinear", text="23 % of it is distortion", value=0.23),)
    )
    known = RobotKnowledge("robot", SPEC, BAND[1])
    known.learn(replace(Loop(3.0).answer(test, 0.01, rng), amplitude=0.2), rng)
    known.learn(replace(Loop(2.5).answer(test, 0.01, rng), amplitude=0.1, quality=bent), rng)
    known.assume(FOUND, 0.0)
    assert not known.compared
    assert known.by_amplitude is FOUND
