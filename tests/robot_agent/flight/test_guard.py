"""The guard takes the prior back when it is worse than the baseline, and only then."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nufleet.robot_agent.flight.guard import Guard, GuardSettings
from nufleet.shared.arrays import FloatArray

STEP_S = 0.02
PULL_MAX = 2.0
SPEED_MAX = 0.6
STILL = np.zeros(2)
SAMPLES = 500
NEEDED = np.zeros((SAMPLES, 2))


def baseline() -> FloatArray:
    time_s = np.arange(SAMPLES) * STEP_S
    return 0.1 * np.stack([np.sin(2 * time_s), np.cos(3 * time_s)], axis=1)


def squares(errors: FloatArray) -> FloatArray:
    """The squared errors of a baseline that is known exactly."""
    return np.asarray((errors**2).sum(axis=1)[np.newaxis])


KNOWN = squares(baseline())


def judged(errors: FloatArray, noise_variance: float = 0.0) -> tuple[list[float], Guard]:
    guard = Guard(
        KNOWN,
        noise_variance,
        STEP_S,
        PULL_MAX,
        NEEDED,
        correction_speed_max=SPEED_MAX,
    )
    return [guard.judge(k, error, STILL) for k, error in enumerate(errors)], guard


def test_a_model_as_good_as_the_baseline_is_left_alone() -> None:
    shares, guard = judged(baseline())
    assert shares == [1.0] * SAMPLES
    assert guard.event is None


def test_a_model_that_is_slightly_worse_all_the_way_is_taken_back_in_time() -> None:
    shares, guard = judged(1.08 * baseline())
    assert guard.event is not None
    assert "1.08 times the error of the baseline" in guard.event.reason
    assert shares[-1] == 0.0


def test_an_error_beyond_the_baselines_worst_is_taken_back_within_a_fifth_of_a_second() -> None:
    errors = 0.2 * baseline()
    errors[250:] = 0.3
    _, guard = judged(errors)
    assert guard.event is not None
    assert 250 <= guard.event.sample <= 250 + round(0.2 / STEP_S)


def test_the_hand_over_is_smooth_and_takes_its_time() -> None:
    errors = np.full((SAMPLES, 2), 1.0)
    shares, guard = judged(errors)
    assert guard.event is not None
    fall = np.array([1.0, *shares[guard.event.sample :]])
    steps = round(GuardSettings().hand_over_s / STEP_S)
    assert (np.diff(fall) <= 0).all()
    assert np.abs(np.diff(fall)).max() < math.pi / 2 / steps * 1.01
    assert fall[steps] == pytest.approx(0.0)
    assert fall[steps - 1] > 0.0


def oscillating(amplitude: float, omega_rad_s: float) -> Guard:
    """Corrections that swing while the robot stays on its path."""
    guard = Guard(KNOWN, 0.0, STEP_S, PULL_MAX, NEEDED, correction_speed_max=SPEED_MAX)
    for k in range(SAMPLES):
        swing = amplitude * (1 - np.cos(omega_rad_s * k * STEP_S))
        guard.judge(k, np.zeros(2), np.array([0.0, swing]))
    return guard


def test_corrections_that_oscillate_are_taken_back_before_the_robot_is_off_its_path() -> None:
    """At 10 rad/s, 4 cm to each side are 4 m/s²: a quadrotor tilts by 22 degrees, to and fro."""
    event = oscillating(0.04, 10.0).event
    assert event is not None
    assert "oscillate" in event.reason
    assert event.sample * STEP_S < 0.5


def test_slow_corrections_as_large_are_left_alone() -> None:
    assert oscillating(0.1, 3.0).event is None


def test_corrections_that_are_as_fast_as_the_baseline_needs_are_left_alone() -> None:
    time_s = np.arange(SAMPLES) * STEP_S
    needed = 0.04 * np.stack([np.cos(10.0 * time_s), np.zeros(SAMPLES)], axis=1)
    guard = Guard(KNOWN, 0.0, STEP_S, PULL_MAX, needed, correction_speed_max=SPEED_MAX)
    for k in range(SAMPLES):
        guard.judge(k, np.zeros(2), needed[k])
    assert guard.event is None


def test_a_single_kink_is_no_oscillation() -> None:
    guard = Guard(KNOWN, 0.0, STEP_S, PULL_MAX, NEEDED, correction_speed_max=math.inf)
    for k in range(SAMPLES):
        kinked = max(0.0, 0.6 * (k - 200) * STEP_S)
        guard.judge(k, np.zeros(2), np.array([kinked, 0.0]))
    assert guard.event is None


def test_once_taken_back_it_stays_so() -> None:
    errors = np.zeros((SAMPLES, 2))
    errors[100:120] = 1.0
    shares, _ = judged(errors)
    assert shares[-1] == 0.0


def test_measurement_noise_is_not_held_against_the_model() -> None:
    noise = 0.01 * np.random.default_rng(0).standard_normal((SAMPLES, 2))
    guard = Guard(
        np.zeros((1, SAMPLES)),
        2 * 0.01**2,
        STEP_S,
        PULL_MAX,
        NEEDED,
        GuardSettings(budget=0.2),
        correction_speed_max=SPEED_MAX,
    )
    for k, error in enumerate(noise):
        guard.judge(k, error, STILL)
    assert guard.event is None


def test_an_error_that_is_not_finite_takes_the_prior_back_at_once() -> None:
    errors = baseline()
    errors[7, 1] = np.nan
    _, guard = judged(errors)
    assert guard.event is not None
    assert (guard.event.sample, guard.event.reason) == (7, "the tracking error is not finite")


@settings(max_examples=50, deadline=None)
@given(st.integers(0, 1000), st.floats(0.0, 5.0))
def test_a_model_that_obeys_its_share_never_costs_a_tenth_more_than_the_baseline(
    seed: int, scale: float
) -> None:
    """The error that is left is baseline + share × (what the model adds), a slow walk."""
    rng = np.random.default_rng(seed)
    harm = scale * 0.05 * np.cumsum(rng.standard_normal((SAMPLES, 2)), axis=0) / math.sqrt(SAMPLES)
    own, guard = (
        baseline(),
        Guard(KNOWN, 0.0, STEP_S, PULL_MAX, NEEDED, correction_speed_max=SPEED_MAX),
    )
    share, spent = 1.0, 0.0
    for k in range(SAMPLES):
        error = own[k] + share * harm[k]
        spent += float(error @ error)
        share = guard.judge(k, error, STILL)
    assert math.sqrt(spent / float((own**2).sum())) <= 1.1


def taken_back_at(correction: FloatArray, needed: FloatArray) -> int | None:
    """When a correction that grows as fast as it may is withdrawn, before any error shows."""
    guard = Guard(
        KNOWN,
        0.0,
        STEP_S,
        PULL_MAX,
        np.tile(needed, (SAMPLES, 1)),
        correction_speed_max=SPEED_MAX,
    )
    size = float(np.linalg.norm(correction))
    for k, error in enumerate(baseline()):
        grown = min(1.0, SPEED_MAX * STEP_S * k / size)
        guard.judge(k, error, grown * correction)
    return None if guard.event is None else guard.event.sample


def test_a_correction_is_taken_back_while_its_way_back_is_still_short() -> None:
    """Half a metre takes 0.8 s to grow and as long to go back; the loop's lag hides it at first."""
    wrong, needed = np.array([0.5, 0.0]), np.array([0.02, 0.0])
    sample = taken_back_at(wrong, needed)
    assert sample is not None
    # The sum over the removal, against the budget: c³/3 − c² n = 0.05 v T Σ|e|².
    whole = float((baseline() ** 2).sum())
    size = SPEED_MAX * STEP_S * np.arange(SAMPLES)
    cost = (size**3 / 3 - size**2 * 0.02) / (SPEED_MAX * STEP_S)
    assert sample == pytest.approx(int(np.argmax(cost > 0.05 * whole)), abs=1)


def test_a_correction_that_the_baseline_needs_may_be_as_large() -> None:
    large = np.array([0.5, 0.0])
    assert taken_back_at(large, large) is None
    assert taken_back_at(large, 0.4 * large) is None
    assert taken_back_at(-large, large) is not None
    assert taken_back_at(np.array([0.0, 0.5]), large) is not None


# What is taken back is weighed against what is lost.


def swinging(amplitude: float, share_of_baseline: float, starts_s: float = 2.0) -> Guard:
    """Corrections that begin to swing at 10 rad/s while the error is a share of the baseline's."""
    guard = Guard(KNOWN, 0.0, STEP_S, PULL_MAX, NEEDED, correction_speed_max=SPEED_MAX)
    for k, error in enumerate(baseline()):
        time_s = max(0.0, k * STEP_S - starts_s)
        swing = amplitude * (1 - math.cos(10.0 * time_s))
        guard.judge(k, share_of_baseline * error, np.array([0.0, swing]))
    return guard


def test_a_correction_that_leaves_a_tenth_of_the_error_is_kept_for_a_little_restlessness() -> None:
    """3 cm at 10 rad/s are 2.1 m/s² RMS, where 2 are enough: 20 mm of error instead of 200."""
    assert swinging(0.03, 0.1).event is None
    event = swinging(0.03, 0.9).event
    assert event is not None
    assert "oscillate" in event.reason


def test_however_good_it_is_a_correction_that_swings_twice_as_hard_is_taken_back() -> None:
    event = swinging(0.08, 0.1).event
    assert event is not None
    assert "oscillate" in event.reason


# The less is known of the baseline, the stricter the guard.


def uncertain(spread: float, draws: int = 100) -> FloatArray:
    sizes = 1 + spread * np.random.default_rng(0).standard_normal((draws, 1))
    return np.asarray(sizes**2 * KNOWN)


def withdrawn(model: FloatArray, ratio: float) -> int:
    """The sample at which an error of a multiple of the baseline's is taken back."""
    guard = Guard(model, 0.0, STEP_S, PULL_MAX, NEEDED, correction_speed_max=SPEED_MAX)
    for k, error in enumerate(ratio * baseline()):
        guard.judge(k, error, STILL)
    return SAMPLES if guard.event is None else guard.event.sample


def test_a_vague_baseline_makes_the_guard_stricter() -> None:
    samples = [withdrawn(uncertain(spread), 1.2) for spread in (0.0, 0.1, 0.2, 0.4)]
    assert samples == sorted(samples, reverse=True)
    assert samples[-1] < samples[0]
    assert withdrawn(uncertain(0.2), 0.5) == SAMPLES


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.floats(0.02, 0.3), st.floats(0.5, 4.0))
def test_the_promise_holds_for_nineteen_of_twenty_robots_that_the_belief_allows(
    seed: int, spread: float, harm: float
) -> None:
    """The true baseline is a draw of the belief, not of its lowest twentieth; harm takes 2 s."""
    size = 1 + spread * np.random.default_rng(seed).standard_normal()
    if size < 1 - 1.6 * spread:
        return
    guard = Guard(uncertain(spread), 0.0, STEP_S, PULL_MAX, NEEDED, correction_speed_max=SPEED_MAX)
    own, share, spent = size * baseline(), 1.0, 0.0
    for k in range(SAMPLES):
        error = own[k] * (1 + share * harm * min(1.0, k * STEP_S / 2))
        spent += float(error @ error)
        share = guard.judge(k, error, STILL)
    assert math.sqrt(spent / float((own**2).sum())) <= 1.1


# What flies on when a correction is withdrawn.


def with_fallback(errors: FloatArray) -> tuple[list[float], Guard]:
    guard = Guard(
        KNOWN, 0.0, STEP_S, PULL_MAX, NEEDED, correction_speed_max=SPEED_MAX, fallback=True
    )
    shares = []
    for k, error in enumerate(errors):
        learned = guard.judge(k, error, STILL)
        shares.append(guard.fallback_share(k))
        assert 0.0 <= learned + shares[-1] <= 1.0 + 1e-12
    return shares, guard


def test_a_withdrawn_correction_gives_way_to_the_robots_own_and_smoothly() -> None:
    errors = 0.1 * baseline()
    errors[100:110] = 1.0
    shares, guard = with_fallback(errors)
    assert guard.event is not None
    assert guard.event.given_to == "own"
    assert shares[guard.event.sample - 1] == 0.0
    assert shares[-1] == 1.0
    assert np.abs(np.diff(shares)).max() < 0.1


def test_the_robots_own_correction_is_judged_as_well() -> None:
    errors = 0.1 * baseline()
    errors[100:110] = 1.0
    errors[300:] = 1.0
    shares, guard = with_fallback(errors)
    assert guard.event is not None
    assert guard.event.given_to == "baseline"
    assert "its model of itself was taken back, too" in guard.event.reason
    assert shares[-1] == 0.0


def test_the_reason_for_taking_back_the_robots_own_counts_from_when_it_took_over() -> None:
    """Until then the error was far below the baseline's, which is no reason to take it back."""
    guard = Guard(
        KNOWN, 0.0, STEP_S, PULL_MAX, NEEDED, correction_speed_max=SPEED_MAX, fallback=True
    )
    for k, error in enumerate(baseline()):
        swing = 0.08 * (1 - math.cos(10.0 * k * STEP_S)) if k < 60 else 0.0
        guard.judge(k, (0.1 if k < 60 else 1.2) * error, np.array([0.0, swing]))
    assert guard.event is not None
    first, second = guard.event.reason.split("; then")
    assert "oscillate" in first
    times = re.search(r"the error since \S+ s was (\S+) times the error", second)
    assert times is not None
    assert float(times[1]) > 1.0


def test_an_oscillation_that_is_hardly_too_hard_shows_by_how_much() -> None:
    guard = Guard(KNOWN, 0.0, STEP_S, PULL_MAX, NEEDED, correction_speed_max=SPEED_MAX)
    for k in range(50):
        pulled = 1.0001 * PULL_MAX * (k * STEP_S) ** 2 / 2
        guard.judge(k, STILL, np.array([pulled, 0.0]))
    assert guard.event is not None
    assert "they accelerate by 2.0002 m/s²" in guard.event.reason
    assert "; 2 m/s² is enough" in guard.event.reason


def test_an_error_that_is_hardly_too_large_shows_by_how_much() -> None:
    window = np.ones(10) / 10
    worst = 1.3 * math.sqrt(np.convolve(KNOWN[0], window, mode="same").max())
    errors = np.zeros((SAMPLES, 2))
    errors[300:, 0] = 1.00001 * worst
    _, guard = judged(errors)
    assert guard.event is not None
    shown = re.search(r"error was (\S+) mm RMS .* worst allows, (\S+) mm$", guard.event.reason)
    assert shown is not None
    assert float(shown[1]) > float(shown[2])


@pytest.mark.parametrize("unit", ["m", "rad"])
def test_a_reason_says_when_and_how_much_in_the_units_of_the_robot(unit: str) -> None:
    guard = Guard(KNOWN, 0.0, STEP_S, PULL_MAX, NEEDED, correction_speed_max=SPEED_MAX, unit=unit)
    for k, error in enumerate(1.08 * baseline()):
        guard.judge(k, error, STILL)
    assert guard.event is not None
    after_s = (guard.event.sample + 1) * STEP_S
    assert f"after {after_s:.2f} s" in guard.event.reason
    assert f" m{unit} RMS instead of" in guard.event.reason
