"""Responses from records of any reference: as certain as they say, silent where they must be."""

from __future__ import annotations

import numpy as np
import pytest
from robots_that_learn import double_integrator
from scipy.signal import cont2discrete, lfilter

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.record_response import (
    RecordResponse,
    Stretch,
    estimate_record_response,
)
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.paths.installed import find_drawing
from nufleet.shared.paths.trajectories import travel

STEP_S = 0.02
BAND = (0.1, 5.4)
SETTLING_S = 5.0
NOISE_M = 0.003


class Loop:
    """A second-order loop with a delay of whole samples, sampled exactly."""

    def __init__(self, omega_rad_s: float = 3.0, damping: float = 0.6, delay: int = 4) -> None:
        num, den, _ = cont2discrete(
            ([omega_rad_s**2], [1.0, 2 * damping * omega_rad_s, omega_rad_s**2]), STEP_S
        )
        self._num = np.concatenate([np.zeros(delay), num.ravel()])
        self._den = den

    def play(self, reference: FloatArray, rng: np.random.Generator) -> FloatArray:
        clean = lfilter(self._num, self._den, reference)
        return np.asarray(clean + NOISE_M * rng.standard_normal(len(reference)))

    def response(self, omega_rad_s: FloatArray) -> ComplexArray:
        z = np.exp(-1j * omega_rad_s * STEP_S)
        return np.asarray(np.polyval(self._num[::-1], z) / np.polyval(self._den[::-1], z))


def wandering(
    seconds: float, rng: np.random.Generator, *, highest_rad_s: float = 5.0
) -> FloatArray:
    """Return a smooth reference of no special frequencies, about 0.5 m large, from rest."""
    samples = round(seconds / STEP_S)
    omega = rng.uniform(0.1, highest_rad_s, 40)
    phase = rng.uniform(0, 2 * np.pi, 40)
    time_s = np.arange(samples) * STEP_S
    signal = np.sin(np.outer(time_s, omega) + phase) @ (0.06 / np.sqrt(omega))
    return np.asarray(signal * np.minimum(1.0, time_s / 2) ** 2)


def estimated(*stretches: Stretch, **circumstances: float) -> RecordResponse:
    settling_s = circumstances.pop("settling_time_s", SETTLING_S)
    return estimate_record_response(stretches, STEP_S, BAND, settling_s, **circumstances)


def relative_errors(found: RecordResponse, loop: Loop) -> FloatArray:
    response = found.response
    away = np.abs(response.z - loop.response(response.omega_rad_s)) ** 2
    return np.asarray(away / response.variance)


def codes(found: RecordResponse) -> set[str]:
    quality = found.response.quality
    return {finding.code for finding in (*quality.reasons, *quality.warnings)}


@pytest.mark.parametrize("cut", [0.0, 4.0])
def test_errors_are_as_large_as_claimed_from_rest_and_cut_out_of_the_middle(cut: float) -> None:
    """A record cut out of a flight begins and ends with transients that it does not show whole."""
    squares = []
    for seed in range(6):
        rng = np.random.default_rng(seed)
        loop = Loop(rng.uniform(2, 4), rng.uniform(0.4, 1.0), int(rng.integers(8)))
        reference = wandering(25.0 + cut, rng)
        output = loop.play(reference, rng)
        first = round(cut / STEP_S)
        found = estimated(Stretch(reference[first:], output[first:]))
        assert found.response.quality.usable
        assert len(found.response.z) >= 12
        squares.append(relative_errors(found, loop))
    assert 0.3 < float(np.mean(np.concatenate(squares))) < 1.7
    assert float(np.max(np.concatenate(squares))) < 14


def test_a_longer_record_knows_more_frequencies_and_each_of_them_better() -> None:
    rng = np.random.default_rng(3)
    loop, reference = Loop(), wandering(100.0, rng)
    output = loop.play(reference, rng)
    short = estimated(Stretch(reference[:1250], output[:1250]))
    whole = estimated(Stretch(reference, output))
    assert len(whole.response.z) > 1.5 * len(short.response.z)
    assert np.median(whole.response.variance) < np.median(short.response.variance)
    assert float(np.mean(relative_errors(whole, loop))) < 1.7


def test_nothing_is_claimed_where_the_reference_has_no_power() -> None:
    rng = np.random.default_rng(4)
    loop, reference = Loop(), wandering(40.0, rng, highest_rad_s=1.5)
    # From rest to rest, smoothly: a record that breaks off in motion excites everything.
    reference = reference * np.hanning(len(reference)) ** 2
    found = estimated(Stretch(reference, loop.play(reference, rng)))
    assert found.band_rad_s is not None
    assert found.band_rad_s[1] < 2.5
    assert float(np.max(found.response.omega_rad_s)) == found.band_rad_s[1]


@pytest.mark.thorough
def test_a_resonance_that_outlasts_its_excitation_is_not_taken_for_another() -> None:
    squares = []
    for seed in range(4):
        rng = np.random.default_rng(seed)
        loop, reference = Loop(2.5, 0.12), wandering(40.0, rng)
        found = estimated(Stretch(reference, loop.play(reference, rng)), settling_time_s=25.0)
        squares.append(relative_errors(found, loop))
    assert float(np.median(np.concatenate(squares))) < 2.0
    assert float(np.mean(np.concatenate(squares))) < 4.0


def test_stretches_between_gaps_are_estimated_together() -> None:
    rng = np.random.default_rng(5)
    loop, reference = Loop(), wandering(60.0, rng)
    output = loop.play(reference, rng)
    parts = [Stretch(reference[k : k + 900], output[k : k + 900]) for k in (0, 950, 2000)]
    one, all_of_them = estimated(parts[0]), estimated(*parts)
    assert all_of_them.duration_s == pytest.approx(54.0)
    assert np.median(all_of_them.response.variance) < np.median(one.response.variance)
    assert float(np.mean(relative_errors(all_of_them, loop))) < 1.7


def test_an_output_that_moves_before_its_reference_is_refused() -> None:
    """As when the two are exchanged, or the reference was logged late."""
    rng = np.random.default_rng(6)
    loop, reference = Loop(delay=0), wandering(25.0, rng)
    output = loop.play(reference, rng)
    found = estimated(Stretch(output, reference))
    assert not found.response.quality.usable
    assert "non-causal" in codes(found)
    assert "before its reference" in str(found.response.quality)


def test_a_loop_that_leads_without_knowing_the_future_is_not_refused() -> None:
    """Feedforward of the reference's speed makes the phase rise at low frequencies."""
    rng = np.random.default_rng(7)
    reference = wandering(25.0, rng)
    plain = Loop(4.0, 0.5, 0)
    lead = lfilter([1 + 10.0, -10.0], [1.0], reference)  # 1 + 0.2 s d/dt
    output = plain.play(np.asarray(lead), rng)
    assert "non-causal" not in codes(estimated(Stretch(reference, output)))


def test_drift_is_reported_and_an_offset_is_not() -> None:
    rng = np.random.default_rng(8)
    loop, reference = Loop(), wandering(30.0, rng)
    output = loop.play(reference, rng)
    away = np.linspace(0.0, 0.5, len(output))
    assert "drift" in codes(estimated(Stretch(reference, output + away)))
    assert "drift" not in codes(estimated(Stretch(reference, output + 0.5)))
    drifting = estimated(Stretch(reference, output + away))
    assert float(np.mean(relative_errors(drifting, loop))) < 2.0


def test_an_output_of_something_else_gives_no_response() -> None:
    rng = np.random.default_rng(9)
    found = estimated(Stretch(wandering(25.0, rng), Loop().play(wandering(25.0, rng), rng)))
    assert not found.response.quality.usable or found.band_rad_s is None


@pytest.mark.parametrize(
    ("seconds", "settling_s", "text"),
    [(1.0, 1.0, "without a gap"), (10.0, 30.0, "at least 24 s are needed")],
)
def test_a_record_that_is_too_short_says_how_long_it_should_be(
    seconds: float, settling_s: float, text: str
) -> None:
    rng = np.random.default_rng(10)
    reference = wandering(seconds, rng)
    found = estimated(Stretch(reference, Loop().play(reference, rng)), settling_time_s=settling_s)
    assert not found.response.quality.usable
    assert text in str(found.response.quality)


def test_an_unknown_delay_between_the_clocks_widens_the_estimates_with_frequency() -> None:
    rng = np.random.default_rng(11)
    loop, reference = Loop(), wandering(40.0, rng)
    stretch = Stretch(reference, loop.play(reference, rng))
    sure, unsure = estimated(stretch), estimated(stretch, delay_std_s=0.01)
    common = np.isin(sure.response.omega_rad_s, unsure.response.omega_rad_s)
    more = unsure.response.variance - sure.response.variance[common]
    expected = (0.01 * unsure.response.omega_rad_s * np.abs(unsure.response.z)) ** 2
    np.testing.assert_allclose(more, expected, rtol=1e-6)


def test_samples_that_are_not_finite_are_left_out_with_their_stretch() -> None:
    rng = np.random.default_rng(12)
    reference = wandering(30.0, rng)
    output = Loop().play(reference, rng)
    broken = output.copy()
    broken[100] = np.nan
    found = estimated(Stretch(reference, broken), Stretch(reference, output))
    assert found.response.quality.usable
    assert found.duration_s == pytest.approx(30.0)
    assert not estimated(Stretch(reference, broken)).response.quality.usable


def test_speed_and_amplitude_of_the_reference_are_told() -> None:
    rng = np.random.default_rng(13)
    time_s = np.arange(1500) * STEP_S
    reference = 0.4 * np.sin(1.5 * time_s) + 0.01 * wandering(30.0, rng)
    found = estimated(Stretch(reference, Loop().play(reference, rng)))
    assert found.response.flight is not None
    assert found.response.flight.speed == pytest.approx(0.6, rel=0.1)
    assert found.response.flight.noise_std == pytest.approx(NOISE_M, rel=0.5)
    assert found.response.amplitude == pytest.approx(0.4, rel=0.1)


@pytest.mark.thorough
@pytest.mark.parametrize("omega_max_rad_s", [5.0, 50.0])
@pytest.mark.parametrize("delay", [0, 1, 4])
def test_a_drawing_followed_without_noise_has_a_response_all_the_same(
    delay: int, omega_max_rad_s: float
) -> None:
    step_s = 0.015
    reference = travel(read_drawing(find_drawing("clover")), 0.6, 2.0, step_s)[:, 0]
    output = np.concatenate([np.full(delay, reference[0]), reference[: len(reference) - delay]])
    found = estimate_record_response(
        [Stretch(reference, output)], step_s, (0.01, omega_max_rad_s), settling_time_s=5.4
    )
    z = np.exp(-1j * found.response.omega_rad_s * delay * step_s)
    assert found.band_rad_s is not None
    assert np.all(np.abs(found.response.z - z) < 0.05 + 3 * np.sqrt(found.response.variance))


@pytest.mark.parametrize("speed_m_s", [0.02, 0.1])
def test_a_drawing_followed_slowly_and_without_noise_has_a_response_too(speed_m_s: float) -> None:
    robot = double_integrator()
    step_s = robot.spec.sample_time_s
    path = travel(read_drawing(find_drawing("pear"))[:, :1], speed_m_s, 1.5, step_s)
    path = path - path[0]
    output = robot.run(path)
    found = estimate_record_response(
        [Stretch(path[:, 0], output[:, 0])],
        step_s,
        (robot.spec.omega_min_rad_s, 10.0),
        robot.spec.settling_time_s,
    )
    assert found.response.quality.usable
    omega, z = found.response.omega_rad_s, found.response.z
    impulse = np.zeros((2000, 1))
    impulse[0] = 1e-3
    answer = double_integrator().run(impulse)[:, 0] / 1e-3
    exact = np.exp(-1j * np.outer(omega, step_s * np.arange(2000))) @ answer
    assert np.all(np.abs(z - exact) < 0.05 + 3 * np.sqrt(found.response.variance))
