"""A planned excitation keeps every limit, or is refused with the limit's name."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from nufleet.robot_agent.motion.excitation import (
    peak_velocity_and_acceleration,
    plan_excitation,
    reference_of,
)
from nufleet.shared.errors import RefusedError
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan, Tone
from nufleet.shared.robots.joint_limits import HEADROOM
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

SAMPLE_TIME_S = 0.02
BAND = (0.05, 60.0)


def spec_with(
    *,
    amplitude_max: float = 1.0,
    velocity_max: float = 1e9,
    acceleration_max: float = 1e9,
    duration_max_s: float = 4000.0,
    settling_time_s: float = 3.0,
    sample_time_s: float = SAMPLE_TIME_S,
) -> RobotSpec:
    return RobotSpec(
        kind="test-robot",
        axes=(
            AxisSpec(
                name="x",
                unit="m",
                amplitude_max=amplitude_max,
                velocity_max=velocity_max,
                acceleration_max=acceleration_max,
            ),
        ),
        sample_time_s=sample_time_s,
        omega_min_rad_s=BAND[0],
        omega_max_rad_s=BAND[1],
        duration_max_s=duration_max_s,
        settling_time_s=settling_time_s,
        simulated=True,
    )


def tones_at(*omegas_rad_s: float) -> tuple[Tone, ...]:
    return tuple(Tone(omega_rad_s=omega) for omega in omegas_rad_s)


def peaks_of(plan: ExcitationPlan) -> tuple[float, float, float]:
    reference = reference_of(plan)
    return (
        float(np.max(np.abs(reference))),
        *peak_velocity_and_acceleration(reference, plan.sample_time_s),
    )


omegas = st.floats(0.2, BAND[1])
phases = st.floats(-math.pi, math.pi)


@st.composite
def excitations(draw: st.DrawFn, amplitude: float | None = None) -> Excitation:
    chosen = draw(st.lists(omegas, min_size=1, max_size=4))
    assume(min(np.diff(sorted(chosen)), default=1.0) > 0.05)
    tones = tuple(
        Tone(omega_rad_s=omega, weight=draw(st.floats(0.01, 10.0)), phase_rad=draw(phases))
        for omega in chosen
    )
    return Excitation(axis="x", tones=tones, amplitude=amplitude, segments=draw(st.integers(3, 6)))


@settings(deadline=None)
@given(excitations(), st.floats(0.1, 10.0), st.floats(0.1, 10.0), st.floats(0.1, 100.0))
def test_an_amplitude_the_robot_chooses_uses_its_headroom_of_the_tightest_limit(
    excitation: Excitation, amplitude_max: float, velocity_max: float, acceleration_max: float
) -> None:
    spec = spec_with(
        amplitude_max=amplitude_max, velocity_max=velocity_max, acceleration_max=acceleration_max
    )
    plan = plan_excitation(excitation, spec, "r1")
    _, velocity, acceleration = peaks_of(plan)
    used = max(
        plan.amplitude / amplitude_max, velocity / velocity_max, acceleration / acceleration_max
    )
    assert used == pytest.approx(HEADROOM, rel=1e-9)


@settings(deadline=None)
@given(excitations(amplitude=0.7))
def test_a_reference_begins_and_ends_at_rest_and_never_exceeds_its_amplitude(
    excitation: Excitation,
) -> None:
    plan = plan_excitation(excitation, spec_with(), "r1")
    reference = reference_of(plan)
    assert reference.shape == (plan.samples,)
    assert reference[0] == 0.0
    assert reference[-1] == 0.0
    assert np.max(np.abs(reference)) <= 0.7


@settings(deadline=None)
@given(excitations(amplitude=0.5), st.sampled_from(["amplitude", "velocity", "acceleration"]))
def test_a_motion_is_accepted_at_a_limit_and_refused_just_over_it(
    excitation: Excitation, limit: str
) -> None:
    _, velocity, acceleration = peaks_of(plan_excitation(excitation, spec_with(), "r1"))
    at_limit = {"amplitude": 0.5, "velocity": velocity, "acceleration": acceleration}[limit]

    accepted = spec_with(**{f"{limit}_max": at_limit * (1 + 1e-9)})
    assert plan_excitation(excitation, accepted, "r1").amplitude == 0.5

    too_tight = spec_with(**{f"{limit}_max": at_limit * (1 - 1e-9)})
    with pytest.raises(RefusedError) as refused:
        plan_excitation(excitation, too_tight, "r1")
    assert refused.value.code == limit
    assert refused.value.robot == "r1"


@settings(deadline=None)
@given(excitations())
def test_a_test_is_accepted_at_the_longest_duration_and_refused_one_sample_over_it(
    excitation: Excitation,
) -> None:
    plan = plan_excitation(excitation, spec_with(), "r1")
    exact = spec_with(duration_max_s=plan.duration_s)
    assert plan_excitation(excitation, exact, "r1").samples == plan.samples

    too_short = spec_with(duration_max_s=plan.duration_s - 0.5 * SAMPLE_TIME_S)
    with pytest.raises(RefusedError) as refused:
        plan_excitation(excitation, too_short, "r1")
    assert refused.value.code == "duration"


@pytest.mark.parametrize("omega", BAND)
def test_the_edges_of_the_band_belong_to_it(omega: float) -> None:
    excitation = Excitation(axis="x", tones=tones_at(omega))
    assert plan_excitation(excitation, spec_with(), "r1").tones == excitation.tones


@settings(deadline=None)
@given(st.one_of(st.floats(5e-324, BAND[0] * (1 - 1e-9)), st.floats(BAND[1] * (1 + 1e-9), 1e300)))
def test_a_tone_outside_the_band_is_refused(omega: float) -> None:
    excitation = Excitation(axis="x", tones=tones_at(1.0, omega))
    with pytest.raises(RefusedError) as refused:
        plan_excitation(excitation, spec_with(), "r1")
    assert refused.value.code == "omega-out-of-band"


def test_a_tone_near_zero_is_refused_with_the_length_of_its_period() -> None:
    excitation = Excitation(axis="x", tones=tones_at(0.001))
    with pytest.raises(RefusedError, match="one period of it would take 6283 s"):
        plan_excitation(excitation, spec_with(), "r1")


def test_an_unknown_axis_is_refused_with_the_axes_there_are() -> None:
    with pytest.raises(RefusedError, match=r"there are \['x'\]") as refused:
        plan_excitation(Excitation(axis="y", tones=tones_at(1.0)), spec_with(), "r1")
    assert refused.value.code == "unknown-axis"


@pytest.mark.parametrize(
    "excitation",
    [
        Excitation(axis="x", tones=tones_at(1.0), segment_min_s=1e300),
        Excitation(axis="x", tones=tones_at(1.0), settle_s=1e300),
        Excitation(axis="x", tones=tones_at(1.0, 1.0 + 1e-15)),
        Excitation(axis="x", tones=tones_at(1.0), segments=64, segment_min_s=1.7e308),
    ],
)
def test_an_absurd_length_is_refused_without_allocating_it(excitation: Excitation) -> None:
    with pytest.raises(RefusedError) as refused:
        plan_excitation(excitation, spec_with(), "r1")
    assert refused.value.code == "duration"


@settings(deadline=None)
@given(excitations())
def test_a_segment_of_one_tone_holds_its_period_and_all_segments_those_of_many_and_two_beats(
    excitation: Excitation,
) -> None:
    plan = plan_excitation(excitation, spec_with(), "r1")
    frequencies = sorted(tone.omega_rad_s for tone in plan.tones)
    segment_s = plan.segment_samples * plan.sample_time_s
    measured_s = plan.segments * segment_s
    period_within_s = segment_s if len(frequencies) == 1 else measured_s
    assert period_within_s * frequencies[0] >= 2 * math.pi * (1 - 1e-12)
    for closest in np.diff(frequencies):
        assert measured_s * closest >= 4 * math.pi * (1 - 1e-12)


def test_the_measuring_part_begins_after_the_robots_own_settling_time() -> None:
    excitation = Excitation(axis="x", tones=tones_at(2.0))
    plan = plan_excitation(excitation, spec_with(settling_time_s=7.31), "r1")
    assert plan.settle_samples * SAMPLE_TIME_S >= 7.31
    reference = reference_of(plan)[plan.ramp_samples : plan.samples - plan.ramp_samples]
    times_s = SAMPLE_TIME_S * (plan.ramp_samples + np.arange(len(reference)))
    scale = reference[0] / math.sin(2.0 * times_s[0])
    np.testing.assert_allclose(reference, scale * np.sin(2.0 * times_s), atol=1e-12)


@pytest.mark.parametrize("settle_s", [0.0, 1.5])
def test_a_settling_time_that_is_asked_for_replaces_the_robots_own(settle_s: float) -> None:
    excitation = Excitation(axis="x", tones=tones_at(2.0), settle_s=settle_s)
    plan = plan_excitation(excitation, spec_with(settling_time_s=9.0), "r1")
    assert plan.settle_samples == round(settle_s / SAMPLE_TIME_S)


def test_a_slow_tone_is_measured_for_most_of_its_test() -> None:
    plan = plan_excitation(Excitation(axis="x", tones=tones_at(0.05)), spec_with(), "r1")
    measured = plan.segments * plan.segment_samples
    assert measured / plan.samples > 0.9


def test_a_reference_that_jumps_from_rest_or_to_rest_counts_its_jump() -> None:
    for reference in ([1.0, 1.0, 0.0], [0.0, 0.5, 1.0]):
        velocity, acceleration = peak_velocity_and_acceleration(np.array(reference), 0.1)
        assert velocity == pytest.approx(10.0)
        assert acceleration >= 100.0


@pytest.mark.parametrize(
    ("omega", "velocity_factor", "acceleration_factor"),
    [(0.06, 3.0, 10.0), (0.5, 2.0, 4.0), (3.0, 1.02, 1.1), (30.0, 1.02, 1.1)],
)
def test_ramps_add_little_to_a_fast_sinusoid_and_a_small_multiple_to_a_slow_one(
    omega: float, velocity_factor: float, acceleration_factor: float
) -> None:
    excitation = Excitation(axis="x", tones=tones_at(omega), amplitude=1.0)
    # Sampled finely, so that difference quotients are derivatives.
    spec = spec_with(sample_time_s=min(SAMPLE_TIME_S, 0.05 / omega))
    amplitude, velocity, acceleration = peaks_of(plan_excitation(excitation, spec, "r1"))
    assert amplitude == pytest.approx(1.0, rel=1e-3)
    assert 0.99 * omega < velocity < velocity_factor * omega
    assert 0.99 * omega**2 < acceleration < acceleration_factor * omega**2
