"""Errors predicted for paths, compared with closed forms and with flights."""

from __future__ import annotations

import numpy as np
import pytest
from loops_on_axes import spec_of
from random_loops import BAND, SPEC, Loop

from nufleet.orchestrator.evaluation.comparison import Psi, summarise
from nufleet.orchestrator.evaluation.pairs import compare_pairs
from nufleet.orchestrator.evaluation.results import EvaluationResult, FlightRecord
from nufleet.orchestrator.flights.labels import BASELINE, NO_PRIOR
from nufleet.orchestrator.study.predicted_errors import PredictedRms, predict_rms
from nufleet.orchestrator.study.tone_choice import first_look
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

FLEET = {"target": Loop(3.0), "near": Loop(3.2), "far": Loop(1.8, delay_s=0.2)}
PERIOD_S = 40.0
TIMES_S = np.arange(0.0, PERIOD_S, SPEC.sample_time_s)


def path(*tones: tuple[int, float]) -> FloatArray:
    """A closed path of two axes: harmonics of its duration, with their amplitudes."""
    phase = 2 * np.pi * TIMES_S / PERIOD_S
    x = sum(a * np.sin(n * phase) for n, a in tones)
    y = sum(a * (np.cos(n * phase) - 1) for n, a in tones)
    return np.stack([x, y], axis=1)


def expected(source: str | None, *tones: tuple[int, float]) -> float:
    """The closed form: both axes have a mean square of a²/2 at every harmonic."""
    total = 0.0
    for n, amplitude in tones:
        omega = np.array([2 * np.pi * n / PERIOD_S])
        inverse = 1.0 if source is None else 1 / FLEET[source].z(omega)[0]
        total += amplitude**2 * abs(1 - FLEET["target"].z(omega)[0] * inverse) ** 2
    return float(np.sqrt(total))


def answer_of(loop: Loop, rng: np.random.Generator) -> list[FrequencyResponse]:
    return [loop.answer(first_look(BAND, SPEC, 11, 0.7).excitation("x"), 0.003, rng)]


def one_tone(omega_rad_s: float) -> Excitation:
    return Excitation(axis="x", tones=(Tone(omega_rad_s=omega_rad_s),), segments=3)


SLOW = ((2, 0.5), (5, 0.2))
FAST = ((10, 0.3), (20, 0.1))


def test_predicted_errors_are_those_of_the_closed_form_averaged_over_the_paths() -> None:
    rng = np.random.default_rng(0)
    found = predict_rms(
        "target",
        ("near", "far"),
        dict.fromkeys(FLEET, spec_of()),
        {name: answer_of(loop, rng) for name, loop in FLEET.items()},
        [path(*SLOW), path(*FAST)],
        rng,
        omega_max_rad_s=BAND[1],
        axes=("x",),
    )
    for source, error in ((None, found.without), *found.of.items()):
        truth = np.mean([expected(source, *SLOW), expected(source, *FAST)])
        assert error == pytest.approx(truth, rel=0.1, abs=0.004)


def test_tests_at_one_frequency_each_tell_as_much_as_many_at_once() -> None:
    rng = np.random.default_rng(1)
    omega = np.linspace(BAND[0], BAND[1], 12)[1:]
    singles = {
        name: [loop.answer(one_tone(w), 0.003, rng) for w in omega.tolist()]
        for name, loop in FLEET.items()
    }
    specs = dict.fromkeys(FLEET, spec_of())
    found = predict_rms(
        *("target", ("near",), specs, singles, [path(*FAST)], rng),
        omega_max_rad_s=BAND[1],
        axes=("x",),
    )
    assert found.of["near"] == pytest.approx(expected("near", *FAST), rel=0.1)


def flown(target: str, errors: dict[str, float]) -> EvaluationResult:
    """An evaluation whose ψ* is in the wrong order and whose predicted errors are in the right."""
    flights = [
        FlightRecord(
            target=target,
            inverse=inverse,
            drawing="pear",
            speed_m_s=0.6,
            rms_m=rms,
            taken_back=None,
            failure=None,
            deadline_misses=0,
        )
        for inverse, rms in {BASELINE: 0.1, NO_PRIOR: 0.09, **errors}.items()
    ]
    return summarise(
        target,
        flights,
        {source: Psi(1 - rms, 0.01) for source, rms in errors.items()},
        "preview",
        unit="m",
        guarded=True,
        run="run",
        predicted=PredictedRms(0.11, {source: 1.2 * rms for source, rms in errors.items()}),
    )


def test_the_order_of_predicted_errors_stands_beside_that_of_the_distance() -> None:
    result = flown("t", {"a": 0.02, "b": 0.05, "c": 0.08})
    assert (result.kendall_tau, result.kendall_tau_trajectory) == (-1.0, 1.0)
    assert {s.robot: s.predicted_rms_m for s in result.sources} == pytest.approx(
        {"a": 0.024, "b": 0.06, "c": 0.096}
    )
    assert result.baseline.predicted_rms_m == 0.11
    pairs = compare_pairs([result, flown("u", {"d": 0.03, "e": 0.07})], "run")
    assert pairs.kendall_tau_trajectory == 1.0
    assert pairs.kendall_tau_trajectory_pooled == pytest.approx(1.0)
    assert pairs.pairs[0].predicted_ratio == pytest.approx(0.096 / 0.11)


def test_an_evaluation_without_predictions_says_nothing_of_their_order() -> None:
    old = flown("t", {"a": 0.02, "b": 0.05}).model_dump(by_alias=True)
    for source in old["sources"]:
        del source["predicted_rms_m"]
    del old["kendall_tau_trajectory"], old["baseline"]["predicted_rms_m"]
    result = EvaluationResult.model_validate(old)
    assert result.kendall_tau_trajectory is None
    assert compare_pairs([result], "run").kendall_tau_trajectory_pooled is None
