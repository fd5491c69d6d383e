"""Verdicts from the tests of a study, whichever algorithm chose them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from random_loops import BAND, SPEC, Loop, answers

from nufleet.orchestrator.runs.response_record import ResponseRecord
from nufleet.orchestrator.study.adaptive_algorithm import AdaptiveStudy
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.interface import DesiredMotion, SourceEstimate, Study, StudyPlan
from nufleet.orchestrator.study.paper_algorithm import PaperStudy
from nufleet.orchestrator.study.transfer_verdicts import (
    Judgement,
    by_predicted_error,
    judge_transfers,
)
from nufleet.orchestrator.study.verdict import Verdict
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.excitation import Excitation, Tone

FLEET = {
    "target": Loop(3.0),
    "near": Loop(3.1, damping=0.75),
    "worse": Loop(1.5, delay_s=0.3),
}
PLAN = StudyPlan("target", ("near", "worse"), BAND, 7, "x")
MOTION = DesiredMotion("slow", (0.3, 0.6, 1.0), (1.0, 0.3, 0.1))


def study_of(algorithm: str, plan: StudyPlan) -> Study:
    rng = np.random.default_rng(4)
    if algorithm == "paper":
        return PaperStudy(plan, rng)
    return AdaptiveStudy(plan, dict.fromkeys(FLEET, SPEC), rng)


def judged(
    algorithm: str, plan: StudyPlan = PLAN, deviation: float = 0.005, seed: int = 2
) -> Judgement:
    study, rng = study_of(algorithm, plan), np.random.default_rng(seed)
    while (question := study.ask()) is not None:
        study.tell(answers(FLEET, question, deviation, rng), {})
    return judge_transfers(
        plan, ranked(*plan.sources), dict.fromkeys(FLEET, SPEC), study.responses, rng
    )


def ranked(*sources: str) -> tuple[SourceEstimate, ...]:
    return tuple(SourceEstimate(source, 0.1, 0.08, 0.12, 1.0, 7) for source in sources)


@pytest.mark.parametrize("algorithm", ["paper", "adaptive"])
def test_the_same_verdicts_follow_from_single_tones_and_from_many(algorithm: str) -> None:
    verdicts = judged(algorithm).verdicts
    assert {source: found.verdict for source, found in verdicts.items()} == {
        "near": Verdict.TRANSFER,
        "worse": Verdict.DO_NOT_TRANSFER,
    }
    for found in verdicts.values():
        assert (found.omega_rad_s[0], found.omega_rad_s[-1]) == BAND


@pytest.mark.thorough
@pytest.mark.parametrize("algorithm", ["paper", "adaptive"])
@settings(max_examples=12, deadline=None)
@example(sample_time_s=0.02, share_of_nyquist=0.0025, octaves=3.0, settling=0.9)  # 2.4 s, 0.4 rad/s
@example(sample_time_s=0.02, share_of_nyquist=0.0025, octaves=2.0, settling=2.30)
@example(sample_time_s=0.02, share_of_nyquist=0.0025, octaves=2.0, settling=2.31)
@example(sample_time_s=0.02, share_of_nyquist=0.0025, octaves=2.0, settling=2.5)
@example(sample_time_s=1.0, share_of_nyquist=0.9, octaves=1.0, settling=0.0)
@example(sample_time_s=1e-3, share_of_nyquist=0.9, octaves=10.0, settling=1e4)
@given(
    sample_time_s=st.floats(1e-3, 1.0),
    share_of_nyquist=st.floats(1e-3, 0.95),
    octaves=st.floats(0.3, 8.0),
    settling=st.one_of(st.just(0.0), st.floats(0.01, 5.0), st.floats(5.0, 3e3)),
)
def test_robots_of_any_pace_are_judged_without_a_warning(
    algorithm: str, sample_time_s: float, share_of_nyquist: float, octaves: float, settling: float
) -> None:
    """`settling` is the settling time in radians of the band's upper end: settling_time × ω_max."""
    omega_max = share_of_nyquist * np.pi / sample_time_s
    band = (omega_max / 2**octaves, omega_max)
    spec = SPEC.model_copy(
        update={
            "sample_time_s": sample_time_s,
            "omega_min_rad_s": band[0],
            "omega_max_rad_s": omega_max,
            "settling_time_s": settling / omega_max,
        }
    )
    fleet = {
        "target": Loop(0.6 * omega_max, delay_s=sample_time_s),
        "near": Loop(0.62 * omega_max, damping=0.75, delay_s=sample_time_s),
        "worse": Loop(0.3 * omega_max, delay_s=0.6 / omega_max),
    }
    plan = replace(PLAN, band_rad_s=band, iterations=2)
    rng, specs = np.random.default_rng(0), dict.fromkeys(fleet, spec)
    study: Study = PaperStudy(plan, rng)
    if algorithm == "adaptive":
        # It continues to the last round, which adds to earlier tests.
        impatient = AdaptiveSettings(delta=1e-9, epsilon=0.0)
        study = AdaptiveStudy(plan, specs, rng, settings=impatient)
    while (question := study.ask()) is not None:
        report = study.tell(answers(fleet, question, 0.005, rng), {})
        for estimate in report.ranking:
            assert 0.0 <= estimate.psi <= 1.0
    verdicts = judge_transfers(plan, report.ranking, specs, study.responses, rng).verdicts
    for found in verdicts.values():
        assert np.isfinite([found.error_with.median, found.error_without.median]).all()
    assert set(verdicts) == {"near", "worse"}


@pytest.mark.thorough
@pytest.mark.parametrize(("algorithm", "studies"), [("paper", 6), ("adaptive", 12)])
def test_gains_and_errors_lie_within_their_bounds_as_often_as_claimed(
    algorithm: str, studies: int
) -> None:
    gains, errors = [], []
    for seed in range(studies):
        for source, found in judged(algorithm, deviation=0.02, seed=seed).verdicts.items():
            omega = np.array(found.omega_rad_s)
            z_s, z_t = FLEET[source].z(omega), FLEET["target"].z(omega)
            with_transfer, without = np.abs(1 - z_t / z_s), np.abs(1 - z_t)
            for gain, truth in ((found.gain_with, with_transfer), (found.gain_without, without)):
                gains.append((np.array(gain.low) <= truth) & (truth <= np.array(gain.high)))
            for error, truth in ((found.error_with, with_transfer), (found.error_without, without)):
                errors.append(error.low <= np.sqrt(np.mean(truth**2)) <= error.high)
    # What is claimed is 0.95; errors of neighbouring frequencies and of one study go together.
    assert np.mean(gains) > 0.9
    assert np.mean(errors) > 0.87


@pytest.mark.parametrize("algorithm", ["paper", "adaptive"])
def test_with_a_trajectory_errors_are_those_on_it(algorithm: str) -> None:
    plan = StudyPlan("target", ("near", "worse"), BAND, 7, "x", MOTION)
    omega, share = np.array(MOTION.omega_rad_s), np.array(MOTION.power) / sum(MOTION.power)
    for source, found in judged(algorithm, plan).verdicts.items():
        gain = np.abs(1 - FLEET["target"].z(omega) / FLEET[source].z(omega))
        error = float(np.sqrt(gain**2 @ share))
        assert found.error_with.low <= error <= found.error_with.high
        assert found.error_with.median == pytest.approx(error, abs=0.02, rel=0.15)


def test_a_trajectory_beyond_the_tested_band_needs_more_tests_and_says_where() -> None:
    fast = DesiredMotion("fast", (1.0, 9.0), (1.0, 0.1))
    found = judged("adaptive", StudyPlan("target", ("near",), BAND, 7, "x", fast)).verdicts["near"]
    assert found.verdict is Verdict.NEED_MORE_TESTS
    # 0.1 · 9² of 1 + 0.1 · 9²
    assert "89 % of the trajectory's motion is above the tested band" in found.reason


def test_a_source_without_a_test_has_no_verdict() -> None:
    study, rng = study_of("paper", PLAN), np.random.default_rng(0)
    question = study.ask()
    assert question is not None
    responses = answers(FLEET, question, 0.01, rng)
    study.tell({robot: responses[robot] for robot in ("target", "near")}, {"worse": "it fell"})
    specs = dict.fromkeys(FLEET, SPEC)
    both = ranked("near", "worse")
    assert set(judge_transfers(PLAN, both, specs, study.responses, rng).verdicts) == {"near"}
    untested = {"near": study.responses["near"]}
    assert judge_transfers(PLAN, both, specs, untested, rng).verdicts == {}


def test_a_ranking_for_a_trajectory_has_the_smallest_error_first() -> None:
    verdicts = judged("paper").verdicts
    found = by_predicted_error(ranked("worse", "near"), verdicts)
    assert [e.robot for e in found] == ["near", "worse"]
    found = by_predicted_error(ranked("near", "worse"), verdicts, first="worse")
    assert [e.robot for e in found] == ["worse", "near"]


def test_a_response_comes_back_from_its_record() -> None:
    study, rng = study_of("adaptive", PLAN), np.random.default_rng(0)
    question = study.ask()
    assert question is not None
    response = answers(FLEET, question, 0.01, rng)["near"]
    text = ResponseRecord.of(response).model_dump_json()
    back = ResponseRecord.model_validate_json(text).response()
    for name in ("omega_rad_s", "z", "variance", "degrees_of_freedom"):
        np.testing.assert_array_equal(getattr(back, name), getattr(response, name))
    assert (back.segments, back.quality) == (response.segments, response.quality)


def tones(*omega_rad_s: float) -> Excitation:
    return Excitation(
        axis="x", tones=tuple(Tone(omega_rad_s=omega) for omega in omega_rad_s), segments=3
    )


LOW, HIGH = (0.3, 0.5, 0.7, 0.9), (3.0, 3.8, 4.6, 5.4)
NOISE = 0.005


def judged_from(
    at_target: Excitation, at_sources: Excitation, motion: DesiredMotion | None, seed: int = 1
) -> Judgement:
    """Judge by stored tests, with different tones on each robot."""
    rng = np.random.default_rng(seed)
    played = {name: at_target if name == "target" else at_sources for name in FLEET}
    stored = {name: [FLEET[name].answer(played[name], NOISE, rng)] for name in FLEET}
    plan = StudyPlan("target", PLAN.sources, BAND, 7, "x", motion)
    return judge_transfers(plan, ranked(*PLAN.sources), dict.fromkeys(FLEET, SPEC), stored, rng)


@pytest.mark.parametrize(("at_target", "at_sources"), [(LOW, HIGH), (HIGH, LOW)])
@pytest.mark.parametrize("motion", [None, MOTION])
def test_of_tests_on_disjoint_bands_no_verdict_is_wrong_and_the_gap_is_said(
    at_target: tuple[float, ...], at_sources: tuple[float, ...], motion: DesiredMotion | None
) -> None:
    found = judged_from(tones(*at_target), tones(*at_sources), motion)
    assert found.verdicts["near"].verdict is not Verdict.DO_NOT_TRANSFER
    assert found.verdicts["worse"].verdict is not Verdict.TRANSFER
    low, high = at_sources[0], at_sources[-1]
    assert any(
        f"near was tested from {low:.4g} to {high:.4g} rad/s" in finding
        and "test both over the same band" in finding
        for finding in found.findings
    )


@pytest.mark.parametrize("motion", [None, MOTION])
@pytest.mark.parametrize("at_sources", [(2.0,), (4.0,)])
def test_one_frequency_decides_nothing_and_asks_for_more(
    at_sources: tuple[float, ...], motion: DesiredMotion | None
) -> None:
    found = judged_from(tones(2.0), tones(*at_sources), motion)
    assert found.verdicts["near"].verdict is Verdict.NEED_MORE_TESTS
    assert found.verdicts["worse"].verdict is not Verdict.TRANSFER
    assert "target was tested at 2 rad/s only" in " ".join(found.findings)
    assert any(f.startswith(f"near was tested at {at_sources[0]:g}") for f in found.findings)


def test_a_stored_test_without_any_finite_estimate_is_refused_by_name() -> None:
    rng = np.random.default_rng(0)
    good = FLEET["near"].answer(tones(*HIGH), NOISE, rng)
    empty = replace(good, z=np.full(len(good.z), complex(np.nan, np.nan)))
    stored = {"target": [FLEET["target"].answer(tones(*HIGH), NOISE, rng)], "near": [good, empty]}
    with pytest.raises(InvalidInputError, match=r"near: .* no finite estimate: leave that test"):
        judge_transfers(PLAN, ranked("near"), dict.fromkeys(FLEET, SPEC), stored, rng)


def test_a_verdict_never_contradicts_its_own_bounds() -> None:
    for played in (HIGH, LOW, (1.0,)):
        for verdict in judged_from(tones(*LOW), tones(*played), MOTION).verdicts.values():
            if verdict.verdict is Verdict.TRANSFER:
                assert verdict.reduction.low > 0
            if verdict.verdict is Verdict.DO_NOT_TRANSFER:
                assert verdict.reduction.high < 0


def test_a_robot_that_changes_between_its_tests_is_said_beside_the_verdicts() -> None:
    rng = np.random.default_rng(0)
    test = tones(*np.linspace(0.6, 5.4, 9).tolist())
    stored = {name: [loop.answer(test, NOISE, rng)] for name, loop in FLEET.items()}
    steady = judge_transfers(PLAN, ranked("near"), dict.fromkeys(FLEET, SPEC), stored, rng)
    assert steady.findings == ()
    stored["near"].append(Loop(3.1, damping=0.75, gain=0.9).answer(test, NOISE, rng))
    moved = judge_transfers(PLAN, ranked("near"), dict.fromkeys(FLEET, SPEC), stored, rng)
    assert len(moved.findings) == 1
    assert moved.findings[0].startswith("near: its response changed between tests")
    wide, narrow = (j.verdicts["near"].error_with for j in (moved, steady))
    assert wide.high - wide.low > 2 * (narrow.high - narrow.low)
