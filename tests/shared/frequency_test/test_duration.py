"""The duration that is expected of a test is the one that a robot plans."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.robot_agent.motion.excitation import plan_excitation
from nufleet.shared.frequency_test.duration import duration_s, timing
from nufleet.shared.frequency_test.excitation import AxisTones, Excitation, Tone
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

omegas = st.lists(st.integers(1, 200), min_size=1, max_size=12, unique=True)


@given(
    hundredths=omegas,
    segments=st.integers(3, 8),
    segment_min_s=st.floats(0.0, 20.0),
    settle_s=st.none() | st.floats(0.0, 20.0),
    settling_time_s=st.floats(0.0, 50.0),
    sample_time_s=st.sampled_from([0.005, 0.015, 0.02]),
)
def test_it_is_the_duration_of_the_robots_own_plan(
    hundredths: list[int],
    segments: int,
    segment_min_s: float,
    settle_s: float | None,
    settling_time_s: float,
    sample_time_s: float,
) -> None:
    spec = RobotSpec(
        kind="any",
        axes=(AxisSpec(name="x", unit="m", amplitude_max=1, velocity_max=1, acceleration_max=1),),
        sample_time_s=sample_time_s,
        omega_min_rad_s=1e-3,
        omega_max_rad_s=100.0,
        duration_max_s=1e6,
        settling_time_s=settling_time_s,
        simulated=True,
    )
    excitation = Excitation(
        axis="x",
        tones=tuple(Tone(omega_rad_s=h / 20) for h in hundredths),
        segments=segments,
        segment_min_s=segment_min_s,
        settle_s=settle_s,
    )
    plan = plan_excitation(excitation, spec, "robot")
    assert duration_s(excitation, spec) == pytest.approx(plan.duration_s, rel=1e-12)


@pytest.mark.parametrize(
    ("omegas_rad_s", "ramp_s"),
    [
        ((2.0,), math.pi),
        ((1.0, 4.0), math.pi),
        ((0.5, 2.0, 8.0), math.pi),
        ((0.1,), math.tau / 0.8),
        ((0.05, 0.2), math.tau / 0.8),
    ],
)
def test_a_ramp_lasts_a_period_of_the_tone_or_of_the_middle_of_several(
    omegas_rad_s: tuple[float, ...], ramp_s: float
) -> None:
    spec = RobotSpec(
        kind="any",
        axes=(AxisSpec(name="x", unit="m", amplitude_max=1, velocity_max=1, acceleration_max=1),),
        sample_time_s=0.02,
        omega_min_rad_s=1e-3,
        omega_max_rad_s=100.0,
        duration_max_s=1e6,
        settling_time_s=4.0,
        simulated=True,
    )
    tones = tuple(Tone(omega_rad_s=omega) for omega in omegas_rad_s)
    excitation = Excitation(axis="x", tones=tones, segments=3)
    assert timing(excitation, spec).ramp_s == pytest.approx(ramp_s)


def test_two_beats_are_measured_within_an_axis_and_half_of_one_across_axes() -> None:
    axis = AxisSpec(name="x", unit="m", amplitude_max=1, velocity_max=1, acceleration_max=1)
    spec = RobotSpec(
        kind="any",
        axes=(axis, axis.model_copy(update={"name": "y"})),
        sample_time_s=0.02,
        omega_min_rad_s=1e-3,
        omega_max_rad_s=100.0,
        duration_max_s=1e6,
        settling_time_s=4.0,
        simulated=True,
    )
    first, near, far = (Tone(omega_rad_s=omega) for omega in (2.0, 2.5, 3.0))
    alone = Excitation(axis="x", tones=(first, near), segments=3)
    across = Excitation(
        axis="x", tones=(first, far), also=(AxisTones(axis="y", tones=(near,)),), segments=3
    )
    measured_s = [3 * timing(one, spec).segment_s for one in (alone, across)]
    assert measured_s == pytest.approx([2 * math.tau / 0.5, 2 * math.tau / 1.0])
    closer = across.model_copy(update={"tones": (first, Tone(omega_rad_s=4.0))})
    assert 3 * timing(closer, spec).segment_s == pytest.approx(math.tau / 1.0)
