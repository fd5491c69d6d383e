"""What is believed of an error response agrees with closed forms, within its own uncertainty."""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
import pytest
from scipy.signal import dlsim, lfilter

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.models.error_belief import MODEL_ERROR, ErrorBelief, believe, fitted, like
from nufleet.shared.models.error_response import ErrorBasis
from nufleet.shared.models.evidence import Evidence
from nufleet.shared.models.linear_model import LinearModel
from nufleet.shared.models.unexplained import correlation_samples
from nufleet.sims.double_integrator import DoubleIntegratorSettings, closed_loop

LOOP = closed_loop(DoubleIntegratorSettings(alpha=0.85, beta=0.003))
SLOWER = closed_loop(DoubleIntegratorSettings(alpha=0.6, beta=0.003))
BASIS = ErrorBasis(LOOP.sample_time_s, 5.5)
OMEGA = np.array([0.1, 0.3, 1.0, 2.0, 4.0, 6.0])


def played(reference: FloatArray, model: LinearModel = LOOP) -> FloatArray:
    a, b, c = np.array(model.a), np.array(model.b)[:, None], np.array(model.c)[None]
    return np.asarray(dlsim((a, b, c, [[model.d]], 1), reference)[1])[:, 0]


@lru_cache
def tones(duration_s: float = 20.0) -> FloatArray:
    """A multi-tone test over [1, 6] rad/s, ramped up and down, as large as a robot allows."""
    time_s = np.arange(0.0, duration_s, BASIS.sample_time_s)
    total = sum(np.sin(w * time_s + w**2) for w in (1.0, 2.3, 3.5, 4.7, 6.0))
    ramp = np.minimum(1.0, np.minimum(time_s, time_s[::-1]) / 2.0)
    return np.asarray(0.03 * total * (0.5 - 0.5 * np.cos(np.pi * ramp)))


def evidence(
    noise_std: float = 0.0, seed: int = 0, model: LinearModel = LOOP, offset: float = 0.0
) -> Evidence:
    noise = noise_std * np.random.default_rng(seed).standard_normal(len(tones()))
    return Evidence.of(BASIS, tones(), played(tones(), model) + noise + offset, 0.0)


@lru_cache
def belief(noise_std: float = 2e-3, seed: int = 0) -> ErrorBelief:
    return believe(BASIS, evidence(noise_std, seed))


HELD = 6e-3
"""How far off friction holds an axis, in m."""


def worn(reference: FloatArray) -> FloatArray:
    """A servo of 8 rad/s with dry friction, and a sensor with noise of 0.2 mm."""
    steps, stiffness, damping = 20, 64.0, 11.2
    step_s, place, speed, found = BASIS.sample_time_s / steps, 0.0, 0.0, []
    for wanted in reference:
        found.append(place)
        for _ in range(steps):
            pull = speed + step_s * (stiffness * (wanted - place) - damping * speed)
            # What friction takes in a step is at most all of the speed.
            speed = math.copysign(max(0.0, abs(pull) - step_s * stiffness * HELD), pull)
            place += step_s * speed
    return np.array(found) + 2e-4 * np.random.default_rng(0).standard_normal(len(found))


@lru_cache
def path_and_error() -> tuple[FloatArray, float]:
    """A path of the worn axis, and the error that it leaves there."""
    path = 0.3 * np.sin(1.6 * np.arange(1000) * BASIS.sample_time_s)
    return path, float(np.std(path - worn(path)))


def low_error(found: ErrorBelief) -> float:
    """The least error that the worn axis is believed to leave, as a multiple of what it leaves."""
    path, made = path_and_error()
    drawn = BASIS.columns(path, 0.0) @ found.draws(
        400, np.random.default_rng(0), float(np.std(path))
    )
    return float(np.quantile(np.std(drawn, axis=0), 0.05)) / made


def exact(omega: FloatArray, model: LinearModel = LOOP) -> np.ndarray:
    return model.frequency_response(omega)


def test_one_test_shows_the_response_over_its_band_and_below_as_far_as_it_says() -> None:
    """By the closed form; over twenty tests the misses have the size that is believed."""
    ratios = []
    for seed in range(20):
        z, variance = belief(seed=seed).response(OMEGA)
        miss = np.abs(z - exact(OMEGA)) ** 2
        assert np.sqrt(miss.max()) < 0.1
        ratios.append(miss / variance)
    assert 0.3 < np.mean(ratios) < 2.5


def test_a_loop_comes_to_rest_where_its_reference_is() -> None:
    z, variance = belief().response(np.array([1e-3]))
    assert abs(z[0] - 1) < 0.01
    assert math.sqrt(variance[0]) < 0.01


def test_a_flight_with_holds_shows_a_loop_that_rests_short_of_its_reference() -> None:
    """Nine tenths of the way, as a robot without integral action may: no tone of a test says so."""
    holds = np.repeat([0.0, 0.5, -0.3, 0.8, 0.0], 800)
    rng = np.random.default_rng(0)
    output = 0.9 * played(holds) + 1e-3 * rng.standard_normal(len(holds))
    z, _ = believe(BASIS, Evidence.of(BASIS, holds, output, 0.0)).response(np.array([1e-3]))
    assert abs(z[0] - 0.9) < 0.01


def test_the_noise_is_found() -> None:
    assert belief(2e-3).noise_std == pytest.approx(2e-3, rel=0.1)


@pytest.mark.parametrize("noise_std", [1e-4, 1e-2])
@pytest.mark.parametrize("lasting", [0.0, 0.95])
def test_a_single_wide_prior_leaves_of_a_motion_what_the_likeliest_one_leaves(
    noise_std: float, lasting: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    white = np.random.default_rng(1).standard_normal(len(tones()))
    output = played(tones()) + noise_std * lfilter([1.0], [1.0, -lasting], white)
    shown = Evidence.of(BASIS, tones(), output, 0.0)

    def left(belief: ErrorBelief) -> FloatArray:
        found = belief.error(tones(), 0.0) - (tones() - output)
        return np.asarray(found - found.mean())

    likeliest = left(believe(BASIS, shown))
    decompositions, eigh = [], np.linalg.eigh
    with monkeypatch.context() as patched:
        patched.setattr(np.linalg, "eigh", lambda a: decompositions.append(a) or eigh(a))
        wide = left(fitted(BASIS, shown))
    assert len(decompositions) == 1, "a robot fits a response after every test"
    assert np.std(wide) == pytest.approx(np.std(likeliest), rel=0.02)
    assert correlation_samples(wide) == pytest.approx(correlation_samples(likeliest), rel=0.05)


def test_a_loop_that_was_seen_to_be_linear_is_believed_to_be() -> None:
    """Under much noise, three hundredths of its error may be hidden; without, hardly any."""
    assert belief(2e-2).model_error == MODEL_ERROR
    assert belief(2e-3).model_error < MODEL_ERROR
    assert belief(1e-6).model_error < 0.1 * MODEL_ERROR


def test_a_sensors_offset_is_no_error_response() -> None:
    shifted = believe(BASIS, evidence(2e-3, offset=0.4))
    np.testing.assert_allclose(shifted.mean, belief(2e-3).mean, atol=1e-6)


def test_evidence_of_two_flights_is_that_of_both_and_makes_more_certain() -> None:
    both = believe(BASIS, evidence(2e-3, 1) + evidence(2e-3, 2))
    assert both.flown_s == pytest.approx(2 * belief().flown_s)
    _, variance = both.response(OMEGA)
    assert (variance < belief().response(OMEGA)[1]).mean() > 0.8


def test_the_first_output_never_answers_its_reference() -> None:
    assert belief().mean[0] == pytest.approx(1.0, abs=1e-4)
    assert np.abs(belief().factor[0]).max() < 1e-4


def test_the_error_on_a_path_is_predicted_with_its_uncertainty() -> None:
    path = np.sin(0.8 * np.arange(1000) * BASIS.sample_time_s)
    made = path - played(path)
    predicted = belief().error(path, 0.0)
    assert np.sqrt(np.mean((predicted - made) ** 2)) < 0.03 * np.sqrt(np.mean(made**2))
    drawn = BASIS.columns(path, 0.0) @ belief().draws(
        200, np.random.default_rng(0), float(np.std(path))
    )
    rms = np.sqrt(np.mean(drawn**2, axis=0))
    low, high = np.quantile(rms, [0.01, 0.99])
    assert low < np.sqrt(np.mean(made**2)) < high


@pytest.mark.parametrize("size", [0.5, 1.0, 2.0, 4.0, 16.0])
def test_an_axis_with_dry_friction_is_not_believed_to_leave_more_than_it_does(size: float) -> None:
    """Whatever the test's size, in multiples of what friction holds the axis by."""
    test = size * HELD / float(np.std(tones())) * tones()
    assert low_error(believe(BASIS, Evidence.of(BASIS, test, worn(test), 0.0))) < 1.1


@pytest.mark.parametrize("lasting_s", [0.1, 1.0])
def test_gusts_are_hardly_taken_for_friction(lasting_s: float) -> None:
    """Though they leave a seventh of the error unexplained, and last while the axis moves."""
    keep = math.exp(-BASIS.sample_time_s / lasting_s)
    for seed in range(4):
        white = np.random.default_rng(seed).standard_normal(len(tones()) + 500)
        gusts = 5e-3 * math.sqrt(1 - keep**2) * lfilter([1.0], [1.0, -keep], white)[500:]
        found = believe(BASIS, Evidence.of(BASIS, tones(), played(tones()) + gusts, 0.0))
        assert found.open(100 * float(np.std(tones()))) < 0.45


def test_a_linear_loop_is_believed_to_leave_as_much_more_as_the_path_is_larger() -> None:
    for seed in range(5):
        assert belief(seed=seed).open(100 * float(np.std(tones()))) < 0.05


def test_an_axis_that_a_test_did_not_move_may_follow_a_larger_motion_at_once() -> None:
    still = 1e-3 * np.random.default_rng(0).standard_normal(len(tones()))
    found = believe(BASIS, Evidence.of(BASIS, tones(), still, 0.0))
    assert found.open(100 * float(np.std(tones()))) == pytest.approx(0.99, abs=0.01)
    assert found.open(float(np.std(tones()))) == 0.0


def test_a_changed_robot_surprises_and_the_same_one_does_not() -> None:
    assert belief().surprise(evidence(2e-3, 7)) < 1.3
    assert belief().surprise(evidence(2e-3, 7, SLOWER)) > 2.0


def test_an_axis_that_never_moved_is_like_the_others_and_less_certain() -> None:
    other = like([belief()])
    np.testing.assert_array_equal(other.mean, belief().mean)
    assert other.flown_s == 0.0
    z, variance = other.response(OMEGA)
    assert (variance > belief().response(OMEGA)[1]).all()
    # An axis a tenth slower lies within what is believed.
    assert (np.abs(z - exact(1.1 * OMEGA)) < 3 * np.sqrt(variance)).all()


def test_two_axes_that_differ_make_a_third_less_certain() -> None:
    slower = believe(BASIS, evidence(2e-3, 3, SLOWER))
    _, variance = like([belief(), slower]).response(OMEGA)
    assert (variance > like([belief()]).response(OMEGA)[1]).mean() > 0.8


@pytest.mark.parametrize(
    ("reference", "output"),
    [
        ([0.0], [0.0]),
        ([0.0, 1.0, 2.0], [0.0, math.nan, 1.0]),
        ([0.0, 1.0, 2.0], [0.0, 1e200, 1.0]),
    ],
)
def test_what_tells_nothing_is_refused(reference: list[float], output: list[float]) -> None:
    with pytest.raises(InvalidInputError, match="tells nothing"):
        Evidence.of(BASIS, np.array(reference), np.array(output), 0.0)


def test_a_motionless_record_leaves_what_was_believed_before() -> None:
    noise = 2e-3 * np.random.default_rng(0).standard_normal(500)
    nothing = believe(BASIS, Evidence.of(BASIS, np.zeros(500), noise, 0.0))
    _, variance = nothing.response(OMEGA)
    assert (variance[2:] > 0.01).all()
