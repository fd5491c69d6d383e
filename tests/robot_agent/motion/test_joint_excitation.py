"""Axes that play together keep the limits that they have together, or the test is refused."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from nufleet.orchestrator.study.tone_choice import (
    first_look,
    lowest_look,
    lowest_look_together,
)
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RefusedError
from nufleet.shared.frequency_test.duration import timing
from nufleet.shared.frequency_test.excitation import AxisTones, Excitation, ExcitationPlan, Tone
from nufleet.shared.frequency_test.multitone import largest_amplitudes
from nufleet.shared.robots.joint_limits import HEADROOM
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

BAND = (0.2, 8.0)
NAMES = ("x", "y", "yaw")
limits = st.tuples(st.floats(0.05, 2.0), st.floats(0.1, 4.0), st.floats(0.5, 20.0))


def spec_of(*axes: tuple[float, float, float], alone: tuple[str, ...] = ()) -> RobotSpec:
    return RobotSpec(
        kind="any",
        axes=tuple(
            AxisSpec(
                name=name,
                unit="rad" if name == "yaw" else "m",
                amplitude_max=amplitude,
                velocity_max=velocity,
                acceleration_max=acceleration,
                together=name not in alone,
            )
            for name, (amplitude, velocity, acceleration) in zip(NAMES, axes, strict=False)
        ),
        sample_time_s=0.02,
        omega_min_rad_s=0.05,
        omega_max_rad_s=20.0,
        duration_max_s=600.0,
        settling_time_s=2.0,
        simulated=True,
    )


def request_for(spec: RobotSpec, amplitudes: tuple[float, ...] | None = None) -> Excitation:
    choice = first_look(BAND, spec, 11, 0.7, tuple(range(len(spec.axes))))
    return choice.excitation(*NAMES, amplitudes=amplitudes)


def used(plan: ExcitationPlan, spec: RobotSpec) -> FloatArray:
    """Return the largest shares of the limits that a test uses: of each axis, and together."""
    reference = reference_of(plan)
    padded = np.pad(reference, ((2, 2), (0, 0)))
    shares = [np.abs(reference).max(axis=0) / [axis.amplitude_max for axis in spec.axes]]
    for order, name in ((1, "velocity_max"), (2, "acceleration_max")):
        moved = np.diff(padded, order, axis=0) / spec.sample_time_s**order
        most = np.array([getattr(axis, name) for axis in spec.axes])
        shares.append(np.linalg.norm(moved / most, axis=1).max(keepdims=True))
    return np.concatenate(shares)


@settings(max_examples=20)
@given(axes=st.lists(limits, min_size=2, max_size=3))
def test_axes_that_move_together_stay_within_the_ellipsoid_of_their_limits(
    axes: list[tuple[float, float, float]],
) -> None:
    spec = spec_of(*axes)
    shares = used(plan_excitation(request_for(spec), spec, "robot"), spec)
    assert shares.max() == pytest.approx(HEADROOM)


def test_axes_with_equal_limits_are_together_no_faster_than_one_of_them() -> None:
    spec = spec_of((1.0, 0.5, 100.0), (1.0, 0.5, 100.0))
    plan = plan_excitation(request_for(spec), spec, "robot")
    speed = np.linalg.norm(np.diff(reference_of(plan), axis=0), axis=1) / spec.sample_time_s
    assert speed.max() == pytest.approx(HEADROOM * 0.5, rel=1e-3)


def test_amplitudes_that_only_together_are_too_large_are_refused() -> None:
    spec = spec_of((1.0, 0.5, 100.0), (1.0, 0.5, 100.0))
    free = plan_excitation(request_for(spec), spec, "robot")
    larger = tuple(1.05 / HEADROOM * one.amplitude for one in free.played)
    with pytest.raises(RefusedError, match=r"axes x and y together would reach 1\.05") as raised:
        plan_excitation(request_for(spec, larger), spec, "robot")
    assert raised.value.code == "together"
    kept = plan_excitation(request_for(spec, tuple(0.5 * a for a in larger)), spec, "robot")
    assert [one.amplitude for one in kept.played] == [0.5 * a for a in larger]


@settings(max_examples=20)
@given(axes=st.lists(limits, min_size=2, max_size=3))
def test_the_largest_amplitudes_that_are_foreseen_are_accepted(
    axes: list[tuple[float, float, float]],
) -> None:
    spec = spec_of(*axes)
    choices = [
        first_look(BAND, spec, 11, 0.7, tuple(range(len(axes)))),
        lowest_look_together(BAND, spec, 0.5, tuple(range(len(axes))), len(axes)),
    ]
    for choice in choices:
        assert choice is not None
        test = choice.excitation(*NAMES)
        played = [one.tones for one in test.played]
        ramp_s = timing(test, spec).ramp_s
        amplitudes = largest_amplitudes(played, spec.axes, choice.base_rad_s, ramp_s)
        plan_excitation(choice.excitation(*NAMES, amplitudes=amplitudes), spec, "robot")


@settings(max_examples=60, deadline=None)
@given(
    low=st.floats(0.01, 1.0),
    span=st.floats(2.0, 100.0),
    axis=limits,
    sample_time_s=st.sampled_from([0.001, 0.02, 0.1]),
    settling_time_s=st.floats(0.1, 100.0),
)
def test_ramps_are_foreseen_in_every_band_at_hardly_less_than_the_robot_would_choose(
    low: float,
    span: float,
    axis: tuple[float, float, float],
    sample_time_s: float,
    settling_time_s: float,
) -> None:
    high = min(low * span, 0.9 * np.pi / sample_time_s)
    spec = spec_of(axis).model_copy(
        update={
            "sample_time_s": sample_time_s,
            "settling_time_s": settling_time_s,
            "omega_min_rad_s": low,
            "omega_max_rad_s": high,
            "duration_max_s": 1e5,
        }
    )
    first = first_look((low, high), spec, 11, 0.5)
    for choice in (first, lowest_look(spec, 2.5 * low, first)):
        test = choice.excitation("x")
        ramp_s = timing(test, spec).ramp_s
        amplitudes = largest_amplitudes([test.tones], spec.axes, choice.base_rad_s, ramp_s)
        asked = choice.excitation("x", amplitudes=amplitudes)
        chosen = plan_excitation(test, spec, "robot").amplitude
        assert 0.4 * chosen < plan_excitation(asked, spec, "robot").amplitude < 1.05 * chosen


def test_a_band_of_five_decades_takes_no_gigabytes() -> None:
    spec = spec_of((1.0, 1.0, 5.0)).model_copy(
        update={
            "sample_time_s": 0.001,
            "omega_min_rad_s": 0.01,
            "omega_max_rad_s": 1000.0,
            "duration_max_s": 1e5,
        }
    )
    choice = lowest_look(spec, 0.025, first_look((0.01, 1000.0), spec, 11, 0.5))
    test = choice.excitation("x")
    tracemalloc.start()
    try:
        ramp_s = timing(test, spec).ramp_s
        largest_amplitudes([test.tones], spec.axes, choice.base_rad_s, ramp_s)
        _, most = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert most < 2e8


def test_an_axis_that_may_not_move_with_another_is_tested_alone() -> None:
    spec = spec_of((1.0, 1.0, 5.0), (1.0, 1.0, 5.0), alone=("y",))
    with pytest.raises(RefusedError, match="axis y may not move at the same time as another"):
        plan_excitation(request_for(spec), spec, "robot")
    alone = first_look(BAND, spec, 11, 0.7, (1,)).excitation(*NAMES)
    assert plan_excitation(alone, spec, "robot").axis == "y"


def test_an_axis_that_the_robot_lacks_is_refused_by_its_name() -> None:
    spec = spec_of((1.0, 1.0, 5.0), (1.0, 1.0, 5.0))
    request = first_look(BAND, spec, 11, 0.7, (0, 1)).excitation("x", "height")
    with pytest.raises(RefusedError, match="height") as raised:
        plan_excitation(request, spec, "robot")
    assert raised.value.code == "unknown-axis"


TONE, OTHER = (Tone(omega_rad_s=1.0),), (Tone(omega_rad_s=2.0),)


@pytest.mark.parametrize(
    ("also", "words"),
    [
        (AxisTones(axis="y", tones=TONE), "different frequencies"),
        (AxisTones(axis="x", tones=OTHER), "plays once in a test"),
        (AxisTones(axis="y", tones=OTHER, amplitude=0.1), "of all axes are requested, or of none"),
    ],
)
def test_a_request_whose_axes_cannot_be_told_apart_is_not_valid(
    also: AxisTones, words: str
) -> None:
    with pytest.raises(ValidationError, match=words):
        Excitation(axis="x", tones=TONE, also=(also,))
