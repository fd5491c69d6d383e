"""Tones that a robot can separate, within the band and its limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nufleet.orchestrator.study import tone_choice
from nufleet.orchestrator.study.tone_choice import closer_looks, first_look, lowest_look
from nufleet.robot_agent.motion.excitation import plan_excitation
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

bands = st.tuples(st.floats(0.01, 1.0), st.floats(2.0, 20.0))


def robot(settling_time_s: float) -> RobotSpec:
    return RobotSpec(
        kind="any",
        axes=(AxisSpec(name="x", unit="m", amplitude_max=1, velocity_max=1, acceleration_max=5),),
        sample_time_s=0.02,
        omega_min_rad_s=0.005,
        omega_max_rad_s=25.0,
        duration_max_s=3600.0,
        settling_time_s=settling_time_s,
        simulated=False,
    )


@given(band=bands, settling_time_s=st.floats(0.0, 60.0))
def test_the_first_look_reaches_from_low_in_the_band_to_its_upper_end(
    band: tuple[float, float], settling_time_s: float
) -> None:
    choice = first_look(band, robot(settling_time_s), 11, 0.7)
    omega = choice.omega_rad_s
    assert omega[-1] == pytest.approx(band[1])
    assert omega[-1] <= band[1]  # a robot whose own band ends there refuses anything above
    assert omega[0] >= band[0]
    assert len(omega) <= 64


@given(band=bands, settling_time_s=st.floats(0.0, 60.0))
def test_a_robot_plans_it_with_no_more_time_than_it_asks_for(
    band: tuple[float, float], settling_time_s: float
) -> None:
    spec = robot(settling_time_s)
    choice = first_look(band, spec, 11, 0.7)
    plan = plan_excitation(choice.excitation("x"), spec, "robot")
    measured_s = plan.segments * plan.segment_samples * plan.sample_time_s
    assert measured_s == pytest.approx(choice.measure_s, abs=3 * spec.sample_time_s)
    assert choice.duration_s(spec) == pytest.approx(plan.duration_s)


def test_a_robot_that_settles_slowly_is_looked_at_more_closely() -> None:
    quick, slow = (first_look((0.1, 5.4), robot(s), 11, 0.7) for s in (2.0, 50.0))
    assert np.diff(slow.omega_rad_s)[0] < 0.5 * np.diff(quick.omega_rad_s)[0]


@given(
    band=bands,
    centres=st.lists(st.floats(0.0, 20.0), max_size=3),
    lengths=st.lists(st.floats(0.5, 4.0), min_size=1, max_size=3),
)
def test_every_closer_look_stays_in_the_band_two_beats_apart(
    band: tuple[float, float], centres: list[float], lengths: list[float]
) -> None:
    measure_s = 11 * 2 * np.pi / band[1]
    choices = closer_looks(band, measure_s, lengths, centres, window_tones=5)
    assert len(set(choices)) == len(choices) > 0
    for choice in choices:
        omega = choice.omega_rad_s
        assert band[0] * (1 - 1e-6) <= omega[0] <= omega[-1] <= band[1] * (1 + 1e-6)
        periods = 3 if len(omega) == 1 else 1
        assert 2 * np.pi / omega[0] <= choice.measure_s / periods * (1 + 1e-9)
        if len(omega) > 1:
            assert np.diff(omega).min() >= 4 * np.pi / choice.measure_s * (1 - 1e-9)


def test_a_closer_look_surrounds_its_centre() -> None:
    choices = closer_looks((0.1, 5.4), 20.0, [2.0], [3.0], window_tones=5)
    window = [c for c in choices if len(c.harmonics) <= 6]
    assert len(window) == 1
    assert window[0].omega_rad_s[0] < 3.0 < window[0].omega_rad_s[-1]


def test_a_slow_robot_in_a_wide_band_is_not_offered_thousands_of_tests(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried = 0
    between = tone_choice._between

    def counted(*arguments: object) -> object:
        nonlocal tried
        tried += 1
        return between(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(tone_choice, "_between", counted)
    spec = robot(100.0).model_copy(update={"sample_time_s": 0.001, "omega_max_rad_s": 3000.0})
    choice = first_look((0.1, 2800.0), spec, 11, 0.7)
    assert len(choice.harmonics) == 64
    assert tried <= 4


def test_a_tone_that_would_leave_the_band_by_a_billionth_is_moved_inside_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    steps = []

    def step(value: float, towards: float) -> float:
        steps.append(value)
        assert len(steps) < 100, "it would take millions of the smallest steps"
        return float(np.nextafter(value, towards))

    monkeypatch.setattr(tone_choice.math, "nextafter", step)
    # A lowest look lasts one period of its lowest tone, a billionth above twice the lower end.
    measure_s = 2 * np.pi / (0.2 * (1 + 1e-9))
    for choice in closer_looks((0.1, 5.4), measure_s, (1.0, 1.7, 3.0), (5.4,), 5, (0, 1)):
        assert choice.omega_rad_s[-1] <= 5.4


@given(low=st.floats(0.01, 3.0), span=st.floats(1.4, 300.0), settling_time_s=st.floats(0.01, 200.0))
@settings(max_examples=200, deadline=None)
def test_a_claim_rests_on_a_tone_near_the_lower_end_of_the_band(
    low: float, span: float, settling_time_s: float
) -> None:
    band = low, min(low * span, 100.0)
    spec = robot(settling_time_s).model_copy(
        update={"omega_min_rad_s": low, "omega_max_rad_s": 100.0, "duration_max_s": 1e6}
    )
    first = first_look(band, spec, 11, 0.7)
    lowest = lowest_look(spec, 2.5 * low, first)
    assert low <= lowest.omega_rad_s[0] <= 3 * low
    assert lowest.omega_rad_s[-1] <= first.omega_rad_s[-1]
