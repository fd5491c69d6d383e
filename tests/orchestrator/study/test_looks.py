"""Every test that a study may ask for is one that its robot accepts, and what it costs is known."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from loops_on_axes import answer
from random_loops import BAND, SPEC, Loop

from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.orchestrator.study.looks import Looks
from nufleet.orchestrator.study.tone_choice import ToneChoice
from nufleet.robot_agent.motion.excitation import plan_excitation
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.robots.spec import RobotSpec


def looks_of(
    spec: RobotSpec,
    band: tuple[float, float] = BAND,
    amplitude: float | None = None,
    *,
    alone: bool = False,
) -> tuple[Looks, AxesKnowledge]:
    plan = StudyPlan("robot", ("source",), band, 8, "x", amplitude=amplitude)
    untested = ("robot",) if alone else ("robot", "source")
    known = {name: AxesKnowledge(name, spec, band[1], ("x",)) for name in untested}
    return Looks(plan, AdaptiveSettings(), known), known["robot"]


@pytest.mark.thorough
@settings(max_examples=15, deadline=None)
@given(
    settling_time_s=st.floats(1e-3, 100.0),
    low=st.floats(0.01, 1.0),
    span=st.floats(1.5, 300.0),
    sample_time_s=st.sampled_from([0.001, 0.02, 0.1, 1.0]),
    amplitude=st.none() | st.floats(1e-3, 10.0),
    played=st.floats(0.01, 0.5),
    std=st.sampled_from([0.01, 0.2]),
    alone=st.booleans(),
)
def test_a_robot_accepts_every_test_from_one_millisecond_to_one_second(
    settling_time_s: float,
    low: float,
    span: float,
    sample_time_s: float,
    amplitude: float | None,
    played: float,
    std: float,
    alone: bool,
) -> None:
    high = min(low * span, 0.9 * np.pi / sample_time_s)
    if high < 1.2 * low:
        low = high / 1.5
    spec = SPEC.model_copy(
        update={
            "settling_time_s": settling_time_s,
            "sample_time_s": sample_time_s,
            "omega_min_rad_s": low,
            "omega_max_rad_s": high,
            "duration_max_s": 3600.0,
        }
    )
    looks, known = looks_of(spec, (low, high), amplitude, alone=alone)
    first = looks.first["robot"]
    rng = np.random.default_rng(0)
    test = looks.excitation("robot", first)
    plan_excitation(test, spec, "robot")
    response = Loop(0.5 * high).answer(test, std, rng)
    known.learn(replace(response, amplitude=played), rng)
    assert np.all(np.isfinite(known.axes["x"].model.draw(np.linspace(low, high, 8), 20, rng)))
    for choice in looks.candidates("robot", (low, 0.5 * (low + high))):
        plan = plan_excitation(looks.excitation("robot", choice), spec, "robot")
        assert plan.duration_s == pytest.approx(looks.duration_s("robot", choice))
        assert amplitude is None or plan.amplitude <= amplitude


def claimed_look(looks: Looks, known: AxesKnowledge, std: float = 0.01) -> ToneChoice:
    """What a claim lacks after a first test at 0.1 m; once it is played, nothing is lacking."""
    rng = np.random.default_rng(0)
    first = looks.first["robot"]
    response = Loop(3.0).answer(looks.excitation("robot", first), std, rng)
    known.learn(replace(response, amplitude=0.1), rng)
    look = looks.due(["robot"])["robot"]
    test = looks.excitation("robot", look)
    assert test.amplitude == pytest.approx(0.05)
    response = Loop(3.0).answer(test, std, rng)
    known.learn(replace(response, amplitude=test.amplitude), rng)
    assert looks.due(["robot"]) == {}
    return look


def test_the_lowest_look_reaches_down_to_the_lower_end_at_half_the_amplitude() -> None:
    looks, known = looks_of(SPEC)
    lowest = claimed_look(looks, known)
    assert 1.25 * BAND[0] < lowest.omega_rad_s[0] <= 2.5 * BAND[0]
    assert looks.asked_s > looks.lowest_asked_s > 0.5 * looks.asked_s


def test_the_lowest_look_repeats_the_tones_of_the_first_test_above_its_own_lowest() -> None:
    looks, known = looks_of(SPEC)
    first, lowest = looks.first["robot"], claimed_look(looks, known)
    shared = np.isclose(lowest.omega_rad_s[:, None], first.omega_rad_s, rtol=1e-9, atol=0.0)
    assert shared.any(axis=0)[1:].all()
    assert np.diff(lowest.harmonics).min() >= 2


def test_a_part_of_a_first_test_that_reaches_as_low_is_repeated_at_half_the_amplitude() -> None:
    spec = SPEC.model_copy(update={"settling_time_s": 100.0})
    looks, known = looks_of(spec)
    first, again = looks.first["robot"], claimed_look(looks, known)
    assert first.omega_rad_s[0] < 3 * BAND[0]
    shared = np.isclose(again.omega_rad_s[:, None], first.omega_rad_s, rtol=1e-9, atol=0.0)
    assert shared.any(axis=1).all()
    assert again.measure_s < 0.3 * first.measure_s
    assert again.omega_rad_s[-1] > 0.8 * first.omega_rad_s[-1]
    assert looks.lowest_asked_s == 0.0, "a narrower band would not save it"


@pytest.mark.parametrize("settling_time_s", [1.0, 12.0, 40.0])
def test_a_target_that_alone_lacks_tests_reaches_down_at_once_where_that_is_shorter(
    settling_time_s: float,
) -> None:
    spec = SPEC.model_copy(update={"settling_time_s": settling_time_s})
    usual, plan = looks_of(spec)[0], StudyPlan("robot", ("source",), BAND, 8, "x")
    known = {name: AxesKnowledge(name, spec, BAND[1], ("x",)) for name in ("robot", "source")}
    rng = np.random.default_rng(0)
    known["source"].learn(Loop(3.0).answer(usual.first["source"].excitation("x"), 0.01, rng), rng)
    looks = Looks(plan, AdaptiveSettings(), known)
    first, again = looks.first["robot"], claimed_look(looks, known["robot"])
    assert first.omega_rad_s[0] <= 2.5 * BAND[0] * (1 + 1e-6) < usual.first["robot"].omega_rad_s[0]
    assert np.diff(first.omega_rad_s).max() <= np.diff(usual.first["robot"].omega_rad_s).max()
    shared = np.isclose(again.omega_rad_s[:, None], first.omega_rad_s, rtol=1e-9, atol=0.0)
    assert shared.any(axis=1).all()
    before_s = sum(
        usual.duration_s("robot", one)
        for one in (usual.first["robot"], usual.lowest("robot", usual.first["robot"]))
    )
    assert looks.asked_s < 0.95 * before_s


def test_where_noise_leaves_no_room_for_a_smaller_amplitude_none_is_asked_for() -> None:
    looks, known = looks_of(SPEC.model_copy(update={"settling_time_s": 100.0}))
    rng = np.random.default_rng(0)
    response = Loop(3.0).answer(looks.excitation("robot", looks.first["robot"]), 0.1, rng)
    known.learn(replace(response, amplitude=0.1), rng)
    assert looks.due(["robot"]) == {}


@pytest.mark.parametrize("std", [0.01, 0.2])
@pytest.mark.parametrize("played", [0.02, 0.3])
def test_no_test_is_larger_than_the_study_allows_whatever_was_played_before(
    std: float, played: float
) -> None:
    looks, known = looks_of(SPEC, amplitude=0.02)
    rng = np.random.default_rng(0)
    response = Loop(3.0).answer(looks.excitation("robot", looks.first["robot"]), std, rng)
    known.learn(replace(response, amplitude=played), rng)
    for choice in (*looks.candidates("robot", (1.0, 3.0)), *looks.due(["robot"]).values()):
        asked = looks.excitation("robot", choice).amplitude
        assert asked is not None
        assert asked <= 0.02


def test_the_lowest_look_is_as_low_as_the_longest_motion_of_the_robot_allows() -> None:
    short = SPEC.model_copy(update={"duration_max_s": 60.0})
    low = 0.04
    looks, _ = looks_of(short, (low, BAND[1]))
    lowest = looks.lowest("robot", looks.first["robot"])
    assert 2.5 * low < lowest.omega_rad_s[0] < looks.first["robot"].omega_rad_s[0]
    assert looks.duration_s("robot", lowest) <= 60.0


def test_a_robot_that_was_measured_to_settle_slowly_is_waited_for() -> None:
    looks, known = looks_of(SPEC)
    share = AdaptiveSettings().settle_share
    test = looks.excitation("robot", looks.first["robot"])
    assert test.settle_s == pytest.approx(share * SPEC.settling_time_s)
    known.axes["x"].settling_time_s = 3 * SPEC.settling_time_s
    test = looks.excitation("robot", looks.first["robot"])
    assert test.settle_s == pytest.approx(3 * share * SPEC.settling_time_s)


def test_of_the_slowest_robots_long_tests_wait_less_than_short_ones() -> None:
    settings, settling_s, period_s = AdaptiveSettings(), 400.0, 2 * math.pi / BAND[0]
    slow = SPEC.model_copy(update={"settling_time_s": settling_s, "duration_max_s": 3600.0})
    looks, known = looks_of(slow)
    first = looks.first["robot"]
    longest_s = settings.first_longest * period_s
    assert longest_s <= first.measure_s < 1.1 * longest_s < settings.share_of_settling * settling_s
    test = looks.excitation("robot", first)
    assert test.settle_s == pytest.approx(settings.settle_longest * period_s)
    known.learn(Loop(3.0).answer(test, 0.01, np.random.default_rng(0)), np.random.default_rng(0))
    part = looks.lowest("robot", first, [])
    assert part.measure_s < first.measure_s
    test = looks.excitation("robot", part)
    assert test.settle_s == pytest.approx(settings.settle_share * settling_s)


def test_in_a_narrow_band_a_test_waits_for_what_decays_soon() -> None:
    slow = SPEC.model_copy(update={"settling_time_s": 30.0, "duration_max_s": 3600.0})
    looks, _ = looks_of(slow, (2.0, 5.4))
    test = looks.excitation("robot", looks.first["robot"])
    periods = AdaptiveSettings().settle_periods
    assert test.settle_s == pytest.approx(periods * 2 * math.pi / 5.4)


def test_the_slowest_robots_are_waited_for_in_tests_of_several_axes() -> None:
    slow = SPEC.model_copy(update={"settling_time_s": 400.0, "duration_max_s": 3600.0})
    both = tuple(slow.axes[0].model_copy(update={"name": axis}) for axis in "xy")
    slow = slow.model_copy(update={"axes": both})
    plan = StudyPlan("robot", ("source",), BAND, 8, "x", also=("y",))
    known = {name: AxesKnowledge(name, slow, BAND[1], ("x", "y")) for name in ("robot", "source")}
    looks = Looks(plan, AdaptiveSettings(), known)
    test = looks.excitation("robot", looks.first["robot"])
    assert test.settle_s == pytest.approx(AdaptiveSettings().settle_share * slow.settling_time_s)


REACHED_RAD_S = 2.5 * 0.2 * (1 + 1e-6)
"""Highest frequency of the lowest tone that a claim rests on, in the band of `looks_over`."""


def looks_over(axes: int) -> Looks:
    """The tests of four robots with this many axes, which settle soon."""
    (axis,) = SPEC.axes
    names = tuple(f"axis-{n}" for n in range(axes))
    each = tuple(axis.model_copy(update={"name": name}) for name in names)
    spec = SPEC.model_copy(update={"axes": each, "settling_time_s": 4.0})
    robots = ("target", "source-1", "source-2", "source-3")
    plan = StudyPlan("target", robots[1:], (0.2, 8.0), 8, names[0], also=names[1:])
    known = {name: AxesKnowledge(name, spec, 8.0, names) for name in robots}
    return Looks(plan, AdaptiveSettings(), known)


def lowest_looks(looks: Looks) -> list[ToneChoice]:
    """The tests that the target plays after its first one until each axis has reached down."""
    first = looks.first["target"]
    lacking = [axis for axis in first.axes if first.omegas_of(axis)[0] > REACHED_RAD_S]
    found = [] if lacking else [looks.lowest("target", first)]
    while lacking:
        found.append(looks.lowest("target", first, lacking))
        lacking = [axis for axis in lacking if found[-1].omegas_of(axis)[0] > REACHED_RAD_S]
    return found


def least_s(axes: int) -> float:
    """Robot time of a first look at all robots, and of the lowest looks of the two in a claim."""
    looks = looks_over(axes)
    played = [looks.first["target"]] * 4 + lowest_looks(looks) * 2
    return sum(looks.duration_s("target", one) for one in played)


@pytest.mark.parametrize(("axes", "times"), [(2, 1.15), (3, 1.4), (4, 1.75), (5, 2.3)])
def test_tests_of_several_axes_take_little_more_robot_time_than_those_of_one(
    axes: int, times: float
) -> None:
    assert least_s(axes) <= times * least_s(1)


@pytest.mark.parametrize("axes", [2, 3, 4, 5])
def test_each_axis_plays_three_tones_at_first_and_later_down_to_the_lower_end(axes: int) -> None:
    looks = looks_over(axes)
    first, lowest = looks.first["target"], lowest_looks(looks)
    assert all(len(first.omegas_of(place)) >= 3 for place in range(axes))
    assert len(lowest) == math.ceil((axes - 1) / 3)
    for one in lowest:
        assert one.omega_rad_s[0] >= 0.2
        assert all(len(one.omegas_of(place)) >= 1 for place in range(axes))
        assert len(one.harmonics) >= 1.5 * axes


def test_a_robot_that_misstated_its_settling_plays_the_first_test_that_it_would_have_played() -> (
    None
):
    looks, known = looks_of(SPEC)
    rng, robot = np.random.default_rng(0), Loop(3.0)
    known.learn(robot.answer(looks.first["robot"].excitation("x"), 0.01, rng), rng)
    assert looks.finer(["robot"]) == {}
    measured_s = 10 * SPEC.settling_time_s
    known.axes["x"].expect_settling(measured_s)
    look = looks.finer(["robot"])["robot"]
    told, _ = looks_of(SPEC.model_copy(update={"settling_time_s": measured_s}))
    assert look == told.first["robot"]
    known.learn(robot.answer(look.excitation("x"), 0.01, rng), rng)
    assert looks.finer(["robot"]) == {}


def test_between_tones_too_coarse_for_its_settling_a_robot_is_seen_near_them_only() -> None:
    looks, known = looks_of(SPEC)
    rng, robot, omega_rad_s = np.random.default_rng(0), Loop(3.0), np.linspace(0.01, 5.4, 2000)
    first = looks.first["robot"]
    known.learn(robot.answer(first.excitation("x"), 0.01, rng), rng)
    (above,) = looks.seen("robot").values()
    lowest_rad_s = first.omega_rad_s[0]
    np.testing.assert_array_equal(above.at(omega_rad_s), omega_rad_s >= lowest_rad_s)
    assert looks.unlooked("robot") == (), "as settling was stated well, its tones are close enough"
    known.axes["x"].expect_settling(14 * SPEC.settling_time_s)
    (near,) = looks.seen("robot").values()
    off = np.abs(omega_rad_s[:, None] - first.omega_rad_s).min(axis=1)
    spacing_rad_s = float(np.diff(first.omega_rad_s)[0])
    at = near.at(omega_rad_s)
    assert at[(off < 0.14 * spacing_rad_s) & (omega_rad_s > lowest_rad_s)].all()
    assert not at[(off > 0.16 * spacing_rad_s) | (omega_rad_s < lowest_rad_s)].any()
    assert looks.unlooked("robot") == ("x",)
    finer = looks.finer(["robot"])["robot"]
    known.learn(robot.answer(finer.excitation("x"), 0.01, rng), rng)
    assert looks.seen("robot") == {}
    assert looks.unlooked("robot") == ()


def test_a_robot_that_moves_too_briefly_for_a_finer_look_stays_seen_near_its_tones_only() -> None:
    (axis,) = SPEC.axes
    axes = tuple(axis.model_copy(update={"name": name}) for name in ("x", "y"))
    spec = SPEC.model_copy(update={"axes": axes, "duration_max_s": 60.0})
    known = AxesKnowledge("robot", spec, BAND[1], ("x", "y"))
    plan = StudyPlan("robot", (), BAND, 8, "x", also=("y",))
    looks, rng = Looks(plan, AdaptiveSettings(), {"robot": known}), np.random.default_rng(0)
    test = looks.excitation("robot", looks.first["robot"])
    known.learn(answer({"x": Loop(3.0), "y": Loop(3.0)}, test, 0.01, rng), rng)
    for one in known.axes.values():
        one.expect_settling(200.0)
    assert looks.finer(["robot"]) == {}
    assert looks.unlooked("robot") == ("x", "y")
    for axis_seen in looks.seen("robot").values():
        assert 0 < axis_seen.at(np.linspace(*BAND, 1000)).mean() < 0.4


@pytest.mark.parametrize("axes", [2, 3, 5])
@pytest.mark.parametrize("times_as_slow", [3, 10])
def test_one_finer_look_is_enough_for_all_axes_that_share_its_tones(
    axes: int, times_as_slow: int
) -> None:
    """An axis may play no tone near the upper end of the band, in any of the looks."""
    (axis,) = SPEC.axes
    names = tuple(f"axis-{n}" for n in range(axes))
    each = tuple(axis.model_copy(update={"name": name}) for name in names)
    known = AxesKnowledge("robot", SPEC.model_copy(update={"axes": each}), BAND[1], names)
    plan = StudyPlan("robot", (), BAND, 8, names[0], also=names[1:])
    looks, rng = Looks(plan, AdaptiveSettings(), {"robot": known}), np.random.default_rng(0)

    def play(choice: ToneChoice) -> None:
        for test in looks.excitation("robot", choice).played:
            alone = Excitation(axis=test.axis, tones=test.tones)
            known.axes[test.axis].learn(Loop(3.0).answer(alone, 0.01, rng), rng)

    play(looks.first["robot"])
    for one in known.axes.values():
        one.expect_settling(times_as_slow * SPEC.settling_time_s)
    for look in looks.finer(["robot"]).values():
        play(look)
    assert looks.finer(["robot"]) == {}
