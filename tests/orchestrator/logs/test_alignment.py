"""Two signals of a log at the robot's sample times: nothing is made up where nothing was logged."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.orchestrator.logs.alignment import align
from nufleet.orchestrator.logs.signals import LogError, Signal
from nufleet.shared.arrays import FloatArray

STEP_S = 0.02


def signal(name: str, time_s: FloatArray, value: FloatArray, clock: str = "device") -> Signal:
    return Signal.model_validate(
        {"name": name, "time_s": time_s, "value": value, "clock": clock}, strict=True
    )


def times(count: int = 500, step_s: float = STEP_S) -> FloatArray:
    return np.arange(count) * step_s


def moving(time_s: FloatArray) -> FloatArray:
    return np.asarray(np.sin(1.3 * time_s) + 0.3 * np.sin(4.0 * time_s))


def test_samples_at_the_robots_own_times_stay_as_they_are() -> None:
    at_s = times()
    found = align(signal("u", at_s, moving(at_s)), signal("y", at_s, moving(at_s - 0.1)), STEP_S)
    (stretch,) = found.stretches
    np.testing.assert_allclose(stretch.reference, moving(at_s))
    np.testing.assert_allclose(stretch.output, moving(at_s - 0.1), atol=1e-12)
    assert (found.reference.gaps, found.output.gaps, found.delay_std_s) == (0, 0, 0.0)


def test_the_reference_is_held_and_the_output_is_interpolated() -> None:
    at_s, irregular_s = times(), np.sort(np.random.default_rng(1).uniform(0, 10, 1500))
    sent = signal("u", irregular_s, np.floor(irregular_s))
    found = align(sent, signal("y", irregular_s, moving(irregular_s)), STEP_S)
    stretch = found.stretches[0]
    grid_s = found.began_s + np.arange(len(stretch.output)) * STEP_S
    np.testing.assert_allclose(stretch.output, moving(grid_s), atol=2e-3)
    assert set(stretch.reference.tolist()) <= set(np.arange(10.0).tolist())
    last_sent = irregular_s[np.searchsorted(irregular_s, grid_s + 1e-9, side="right") - 1]
    np.testing.assert_array_equal(stretch.reference, np.floor(last_sent))
    assert found.output.jitter_s > 0
    assert len(at_s) >= len(stretch.output)


def test_times_in_another_unit_are_suspected_where_a_log_is_too_short_for_the_robot() -> None:
    at_s = times() / 1000
    with pytest.raises(LogError, match=r"have 0\.00998 s in common.*--time COLUMN:UNIT"):
        align(signal("u", at_s, moving(at_s)), signal("y", at_s, moving(at_s)), STEP_S)


def test_a_gap_cuts_the_record_in_two_and_is_counted() -> None:
    at_s = times()
    there = (at_s < 4.0) | (at_s > 4.5)
    found = align(
        signal("u", at_s, moving(at_s)), signal("y", at_s[there], moving(at_s[there])), STEP_S
    )
    assert [len(stretch.output) for stretch in found.stretches] == [200, 274]
    assert (found.reference.gaps, found.output.gaps) == (0, 1)


def test_stamps_in_seconds_since_1970_belong_to_the_samples_that_they_say() -> None:
    """They are rounded to 2e-7 s, which must not hold the reference back by a sample."""
    at_s = times() + 1_700_000_000.0
    found = align(signal("u", at_s, at_s), signal("y", at_s, at_s), STEP_S)
    stretch = found.stretches[0]
    np.testing.assert_allclose(stretch.reference, stretch.output, atol=1e-5)


def test_one_lost_sample_is_no_gap() -> None:
    at_s = times()
    there = np.arange(len(at_s)) != 250
    found = align(
        signal("u", at_s, moving(at_s)), signal("y", at_s[there], moving(at_s[there])), STEP_S
    )
    (stretch,) = found.stretches
    np.testing.assert_allclose(stretch.output, moving(at_s), atol=1e-4)


def test_samples_that_came_twice_or_late_are_left_out_and_counted() -> None:
    at_s = times()
    order = np.insert(np.arange(len(at_s)), 300, [100, 299])
    found = align(
        signal("u", at_s, moving(at_s)), signal("y", at_s[order], moving(at_s[order])), STEP_S
    )
    assert found.output.disordered == 2
    np.testing.assert_allclose(found.stretches[0].output, moving(at_s), atol=1e-12)


def test_a_clock_that_steps_back_again_and_again_is_refused() -> None:
    at_s = times()
    jumping = at_s - np.where(np.arange(len(at_s)) % 10 == 5, 0.5, 0.0)
    with pytest.raises(LogError, match=r"50 of the 500 time stamps of y step back"):
        align(signal("u", at_s, moving(at_s)), signal("y", jumping, moving(at_s)), STEP_S)


def test_trims_count_from_the_beginning_of_the_log() -> None:
    at_s = times() + 1e9
    found = align(
        signal("u", at_s, moving(at_s)),
        signal("y", at_s, moving(at_s)),
        STEP_S,
        begin_s=2.0,
        end_s=6.0,
    )
    assert found.began_s == pytest.approx(1e9 + 2.0)
    assert sum(len(stretch.output) for stretch in found.stretches) == 201
    with pytest.raises(LogError, match="only 0 samples between --from and --to"):
        align(signal("u", at_s, at_s), signal("y", at_s, at_s), STEP_S, begin_s=100.0)


def test_signals_of_different_clocks_have_no_time_in_common() -> None:
    at_s = times()
    with pytest.raises(LogError, match="of the same clock"):
        align(signal("u", at_s, moving(at_s)), signal("y", at_s + 1e9, moving(at_s)), STEP_S)


def test_a_reference_logged_rarely_and_stamps_of_receipt_leave_the_delay_open() -> None:
    at_s, rarely_s = times(), times(100, 0.1)
    jittery_s = at_s + np.random.default_rng(2).uniform(0, 0.01, len(at_s))
    rare = align(signal("u", rarely_s, moving(rarely_s)), signal("y", at_s, moving(at_s)), STEP_S)
    assert rare.delay_std_s == pytest.approx(0.1 / np.sqrt(12))
    received = align(
        signal("u", at_s, moving(at_s)), signal("y", jittery_s, moving(at_s), "receipt"), STEP_S
    )
    assert 0.002 < received.delay_std_s < 0.006
    assert (
        align(
            signal("u", at_s, moving(at_s)), signal("y", jittery_s, moving(at_s)), STEP_S
        ).delay_std_s
        == 0.0
    )


def test_an_output_logged_rarely_bounds_the_band() -> None:
    at_s, rarely_s = times(), times(100, 0.1)
    found = align(signal("u", at_s, moving(at_s)), signal("y", rarely_s, moving(rarely_s)), STEP_S)
    assert found.omega_max_rad_s == pytest.approx(8.0)
