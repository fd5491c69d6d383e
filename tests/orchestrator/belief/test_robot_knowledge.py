"""What a robot's tests say together, and when they contradict each other."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from random_loops import BAND, SPEC, Loop
from robots_that_learn import double_integrator

from benchmarks.selection_families import BAND_RAD_S, LinearLoop, Mode
from benchmarks.selection_fleets import TestedRobot
from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge
from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.orchestrator.study.tone_choice import first_look
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Finding, Quality
from nufleet.sims.double_integrator import DoubleIntegratorSettings, closed_loop

LOOP = Loop(3.0)
GRID = np.linspace(*BAND, 50)


def one_test(loop: Loop, rng: np.random.Generator, periods: int = 11) -> FrequencyResponse:
    excitation = first_look(BAND, SPEC, periods, 0.7).excitation("x")
    return loop.answer(excitation, 0.01, rng)


def spread(knowledge: RobotKnowledge, rng: np.random.Generator) -> float:
    return float(np.median(knowledge.model.draw(GRID, 300, rng).std(axis=0)))


@pytest.mark.thorough
def test_repeated_tests_of_the_same_robot_agree() -> None:
    contradicted = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        knowledge = RobotKnowledge("robot", SPEC, BAND[1])
        for periods in (11, 15, 11):
            knowledge.learn(one_test(LOOP, rng, periods), rng)
        contradicted += bool(knowledge.findings)
    assert contradicted <= 1


@pytest.mark.parametrize(
    ("alpha", "omega_rad_s"), [(0.33, (3.0, 0.05)), (0.85, (0.5, 9.0, 4.0)), (1.0, (0.5, 9.0, 4.0))]
)
def test_a_tone_far_from_those_before_it_contradicts_nothing(
    alpha: float, omega_rad_s: tuple[float, ...]
) -> None:
    """The paper's tests are single tones: what a model expects far from them is no measurement."""
    robot = double_integrator(alpha)
    loop = closed_loop(DoubleIntegratorSettings(alpha=alpha, beta=0.003))
    known = RobotKnowledge("robot", robot.spec, 10.0)
    for omega in omega_rad_s:
        at = np.array([omega])
        tone = FrequencyResponse(at, loop.frequency_response(at), np.array([1e-8]), 4, Quality())
        known.learn(tone, np.random.default_rng(0))
    assert known.findings == ()


@pytest.mark.parametrize("changed", [Loop(3.5), Loop(3.0, gain=1.1), Loop(3.0, delay_s=0.1)])
def test_a_response_that_changes_between_tests_is_said_and_believed_less(changed: Loop) -> None:
    rng = np.random.default_rng(0)
    steady, moved = (RobotKnowledge("robot", SPEC, BAND[1]) for _ in range(2))
    for knowledge, second in ((steady, LOOP), (moved, changed)):
        knowledge.learn(one_test(LOOP, rng), rng)
        knowledge.learn(one_test(second, rng), rng)
    assert steady.findings == ()
    assert len(moved.findings) == 1
    assert moved.findings[0].startswith("robot: its response changed between tests, by 0.")
    assert spread(moved, rng) > 2 * spread(steady, rng)


def after_a_repetition(noise: float, rng: np.random.Generator) -> tuple[RobotKnowledge, float]:
    """Return what is known of a robot that was asked for a first look and played half of it."""
    known = RobotKnowledge("robot", SPEC, BAND[1])
    asked = first_look(BAND, SPEC, 11, 0.7).excitation("x")
    half = asked.model_copy(update={"tones": asked.tones[: len(asked.tones) // 2]})
    response = LOOP.answer(half, noise, rng)
    known.learn(response, rng)
    before = spread(known, rng)
    known.compare_to_asked(response.omega_rad_s, np.array(asked.omega_rad_s))
    return known, before


def test_a_robot_that_fails_at_many_tones_and_is_quiet_at_fewer_is_hardly_known() -> None:
    rng = np.random.default_rng(0)
    known, before = after_a_repetition(0.01, rng)
    assert spread(known, rng) > max(3 * before, 0.3)
    (finding,) = known.findings
    assert finding.startswith("robot: it answers to 6 tones at once as if most of it were noise")
    assert "--amplitude" in finding


def test_noise_that_just_hides_many_tones_is_not_taken_for_actuators_at_their_limits() -> None:
    known = [after_a_repetition(0.045, np.random.default_rng(seed))[0] for seed in range(60)]
    assert sum(bool(one.findings) for one in known) <= 2


@pytest.mark.parametrize(("gain", "silent"), [(0.0, True), (0.1, False)])
def test_a_response_that_noise_hides_at_each_tone_is_one_if_all_tones_show_it(
    gain: float, silent: bool
) -> None:
    hidden = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        robot = TestedRobot(LinearLoop((Mode(3.0, 0.7, gain=gain),), 0.05), 0.012, rng)
        test = first_look(BAND_RAD_S, robot.spec, 11, 0.7).excitation("x")
        known = RobotKnowledge("robot", robot.spec, BAND_RAD_S[1])
        known.learn(robot.test(test)[0], rng)
        if "no-response" in {one.code for one in known.responses[0].quality.warnings}:
            hidden += 1
            assert known.silent == silent
    assert hidden >= 5


def test_tests_of_several_axes_tell_what_each_was_asked_for() -> None:
    rng = np.random.default_rng(0)
    asked = first_look(BAND, SPEC, 11, 0.7).excitation("x")
    half = asked.model_copy(update={"tones": asked.tones[:3]})
    for played, findings in ((half, 1), (asked, 0)):
        known = AxesKnowledge("robot", SPEC, BAND[1], ("x",))
        known.learn(LOOP.answer(played, 0.01, rng), rng, asked=asked)
        assert len(known.axes["x"].findings) == findings


def test_a_robot_whose_noise_hides_many_tones_is_known_by_fewer() -> None:
    rng = np.random.default_rng(0)
    known, before = after_a_repetition(0.1, rng)
    assert spread(known, rng) == pytest.approx(before, rel=0.2)
    assert known.findings == ()


def test_a_response_that_is_not_linear_is_said_and_believed_less() -> None:
    rng = np.random.default_rng(0)
    good = one_test(LOOP, rng)
    finding = Finding(code="nonlinear", text="5 % of it is distortion")
    bent = replace(good, quality=Quality(warnings=(finding,)))
    linear, nonlinear = (RobotKnowledge("robot", SPEC, BAND[1]) for _ in range(2))
    linear.learn(good, rng)
    nonlinear.learn(bent, rng)
    assert nonlinear.findings == ("robot: 5 % of it is distortion",)
    assert spread(nonlinear, rng) > 1.3 * spread(linear, rng)


def test_a_quiet_test_at_a_smaller_amplitude_says_nothing_of_the_larger_one() -> None:
    rng = np.random.default_rng(0)
    finding = Finding(code="nonlinear", text="5 % of it is distortion", value=0.05)
    large = replace(one_test(LOOP, rng), quality=Quality(warnings=(finding,)), amplitude=0.2)
    spreads = {}
    for name, amplitude in (("smaller", 0.1), ("larger", 0.4)):
        knowledge = RobotKnowledge("robot", SPEC, BAND[1])
        knowledge.learn(large, rng)
        knowledge.learn(replace(one_test(LOOP, rng), amplitude=amplitude), rng)
        spreads[name] = spread(knowledge, rng)
    assert spreads["smaller"] > 3 * spreads["larger"]


def test_tones_that_could_not_be_estimated_are_left_out() -> None:
    rng = np.random.default_rng(0)
    good = one_test(LOOP, rng)
    z, variance = good.z.copy(), good.variance.copy()
    z[1], variance[1] = complex(np.nan, np.nan), np.inf
    knowledge = RobotKnowledge("robot", SPEC, BAND[1])
    knowledge.learn(replace(good, z=z, variance=variance), rng)
    assert len(knowledge.omega_rad_s) == len(good.z) - 1
    assert np.all(np.isfinite(knowledge.model.draw(GRID, 50, rng)))


def test_a_test_is_expected_to_be_as_noisy_as_those_before_it() -> None:
    rng = np.random.default_rng(0)
    knowledge = RobotKnowledge("robot", SPEC, BAND[1])
    first = one_test(LOOP, rng)
    knowledge.learn(first, rng)
    same = knowledge.expected_variance(first.omega_rad_s, 1.0)
    longer = knowledge.expected_variance(first.omega_rad_s, 4.0)
    assert np.median(same) == pytest.approx(1e-4, rel=0.6)
    np.testing.assert_allclose(longer, same / 4)
