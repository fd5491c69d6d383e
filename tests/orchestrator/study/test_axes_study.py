"""The default algorithm on several axes, on loops whose truth is known on each."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest
from loops_on_axes import AXES, Loops, answer, spec_of
from random_loops import BAND, Loop

from nufleet.orchestrator.study.adaptive_algorithm import AdaptiveStudy
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.interface import DesiredMotion, Question, Report, StudyPlan
from nufleet.orchestrator.study.transfer_verdicts import judge_transfers
from nufleet.shared.arrays import ComplexArray
from nufleet.shared.distance.chordal import chordal_distance, matrix_chordal_distance
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Finding, Quality
from nufleet.shared.robots.spec import RobotSpec

FLEET: dict[str, Loops] = {
    "target": {"x": Loop(3.0), "y": Loop(3.5)},
    "alike-on-x": {"x": Loop(3.0), "y": Loop(1.8, delay_s=0.15)},
    "alike-on-y": {"x": Loop(4.8), "y": Loop(3.5)},
    "balanced": {"x": Loop(3.4), "y": Loop(3.9)},
}
SOURCES = tuple(FLEET)[1:]


PLAN = StudyPlan("target", SOURCES, BAND, 8, "x", also=("y",))


def begin(
    spec: RobotSpec,
    plan: StudyPlan = PLAN,
    stored: Mapping[str, Sequence[FrequencyResponse]] | None = None,
) -> AdaptiveStudy:
    settings = AdaptiveSettings(samples=200, grid_points=96)
    specs, rng = dict.fromkeys(FLEET, spec), np.random.default_rng(0)
    return AdaptiveStudy(plan, specs, rng, stored=stored, settings=settings)


def to_the_end(
    study: AdaptiveStudy, deviation: float = 0.01, across: float = 0.0, silent: str | None = None
) -> tuple[list[Question], list[Report]]:
    rng = np.random.default_rng(1)
    questions, reports = [], []
    while (question := study.ask()) is not None:
        questions.append(question)
        answers = {
            name: answer(
                *(FLEET[name], test, deviation, rng, across), silent if name == "target" else None
            )
            for name, test in question.tests.items()
        }
        reports.append(study.tell(answers, {}))
    return questions, reports


class Ended(NamedTuple):
    """A study that has ended."""

    questions: list[Question]
    reports: list[Report]
    study: AdaptiveStudy


@pytest.fixture(scope="module")
def ended() -> Ended:
    """The study of robots whose axes do not answer to each other."""
    study = begin(spec_of())
    return Ended(*to_the_end(study), study)


def true_psi_star(source: str, axis: str) -> float:
    grid = np.linspace(*BAND, 2001)
    return float(chordal_distance(FLEET["target"][axis].z(grid), FLEET[source][axis].z(grid)).max())


def test_the_worst_axis_decides_and_every_estimate_says_which(ended: Ended) -> None:
    questions, reports, _ = ended
    last = reports[-1]
    assert last.selected == "balanced"
    assert last.confidence is not None
    assert last.confidence >= 0.95
    decided = {estimate.robot: estimate.axis for estimate in last.ranking}
    assert (decided["alike-on-x"], decided["alike-on-y"]) == ("y", "x")
    for estimate in last.ranking:
        assert estimate.axes is not None
        for axis, one in estimate.axes.items():
            truth = true_psi_star(estimate.robot, axis)
            assert one.psi_low - 0.01 < truth < one.psi_high + 0.01
        assert estimate.psi >= max(one.psi for one in estimate.axes.values()) - 1e-3
    assert all(
        [one.axis for one in test.played] in (["x", "y"], ["y", "x"])
        for question in questions
        for test in question.tests.values()
    )


def test_every_axis_of_the_contenders_reaches_the_lower_end_before_anything_is_claimed(
    ended: Ended,
) -> None:
    questions, reports, _ = ended
    assert reports[0].confidence is not None
    assert reports[0].confidence < 0.95
    lowest = {
        axis: min(
            one.tones[0].omega_rad_s
            for question in questions
            for one in question.tests["balanced"].played
            if one.axis == axis
        )
        for axis in AXES
    }
    assert max(lowest.values()) <= 1.25 * 2 * BAND[0] * 1.001
    leads = [question.tests["balanced"].axis for question in questions]
    assert set(leads) == set(AXES)


def test_many_robots_are_looked_at_before_the_lower_end_of_the_band_and_few_from_it_on() -> None:
    def lowest_rad_s(sources: int) -> float:
        names = tuple(f"source-{n}" for n in range(sources))
        plan = StudyPlan("target", names, BAND, 8, "x", also=("y",))
        specs = dict.fromkeys(("target", *names), spec_of())
        question = AdaptiveStudy(plan, specs, np.random.default_rng(0)).ask()
        assert question is not None
        return question.omega_rad_s[0]

    assert lowest_rad_s(3) == pytest.approx(1.25 * 2 * BAND[0])
    assert lowest_rad_s(30) > 3 * BAND[0]


def test_a_second_look_from_the_lower_end_is_played_at_half_the_amplitude(ended: Ended) -> None:
    questions = ended.questions
    first, second = (question.tests["balanced"] for question in questions[:2])
    assert [one.amplitude for one in first.played] == [None, None]
    assert [one.amplitude for one in second.played] == [0.05, 0.05]


def test_an_axis_that_may_not_move_with_others_is_tested_after_them_and_that_is_said() -> None:
    questions, reports = to_the_end(begin(spec_of("y")))
    assert all(not test.also for question in questions for test in question.tests.values())
    assert [{test.axis for test in question.tests.values()} for question in questions[:2]] == [
        {"x"},
        {"y"},
    ]
    assert questions[1].purpose == "a first look at y alone"
    assert reports[0].confidence is not None
    assert reports[0].confidence < 0.95
    last = reports[-1]
    assert last.selected == "balanced"
    assert "tested one after the other: y may not move with another axis" in last.findings


def test_axes_that_answer_to_each_other_are_reported_and_compared_as_matrices(ended: Ended) -> None:
    apart = ended.reports
    assert not any(finding.startswith(("target: ", "target, ")) for finding in apart[-1].findings)
    said = "no axis answers to another, so that each is compared by itself"
    assert said in apart[-1].findings
    _, coupled = to_the_end(begin(spec_of()), across=0.2)
    last = coupled[-1]
    found = [finding for finding in last.findings if finding.startswith(("target: ", "target, "))]
    assert len(found) == 2
    assert found[0].startswith("target: x answers to y with 2")
    assert any("whole response matrices" in finding for finding in last.findings)
    grid = np.linspace(*BAND, 500)

    def matrices(loops: Loops) -> ComplexArray:
        own = np.stack([loops[axis].z(grid) for axis in AXES], axis=1)
        shares = np.where(np.eye(2) > 0, 1.0, 0.2)
        return np.asarray(shares * own[:, :, None])

    for estimate in last.ranking:
        at_source = matrices(FLEET[estimate.robot])
        truth = matrix_chordal_distance(matrices(FLEET["target"]), at_source).max()
        assert estimate.psi_low - 0.01 < truth < estimate.psi_high + 0.01


def test_a_source_whose_tests_fail_is_left_out_and_a_target_ends_the_study() -> None:
    study, rng = begin(spec_of()), np.random.default_rng(1)
    question = study.ask()
    assert question is not None
    answers = {
        name: answer(FLEET[name], test, 0.01, rng)
        for name, test in question.tests.items()
        if name != "alike-on-y"
    }
    report = study.tell(answers, {"alike-on-y": "it fell"})
    assert report.dropped == {"alike-on-y": "it fell"}
    study = begin(spec_of())
    assert study.ask() is not None
    with pytest.raises(StudyError, match="the target target cannot be tested: it fell"):
        study.tell({}, {"target": "it fell"})


def test_a_target_with_an_axis_that_never_responds_ends_the_study_by_its_name() -> None:
    words = "the target target cannot be tested: axis y responds to no tone from"
    with pytest.raises(StudyError, match=words):
        to_the_end(begin(spec_of()), silent="y")


def along(axis: str) -> StudyPlan:
    """The plan of a ranking for a path at 1 to 3 rad/s, nearly all of it along one axis."""
    omega = tuple(np.linspace(1.0, 3.0, 20).tolist())
    (other,) = set(AXES) - {axis}
    parts = {axis: (0.999,) * 20, other: (0.001,) * 20}
    return replace(PLAN, motion=DesiredMotion("path", omega, (1.0,) * 20, parts))


def test_the_best_source_for_a_path_is_that_of_the_axis_along_which_it_leads() -> None:
    axis, best = "y", "alike-on-y"
    plan, rng = along(axis), np.random.default_rng(0)
    study = begin(spec_of(), plan)
    _, reports = to_the_end(study)
    last = reports[-1]
    assert last.selected == best
    assert (last.stopped_because or "").startswith(f"{best} leaves the smallest error")
    specs = dict.fromkeys(FLEET, spec_of())
    verdicts = judge_transfers(plan, last.ranking, specs, study.responses, rng).verdicts
    found = verdicts[best]
    assert found.axes is not None
    assert found.error_with.median == pytest.approx(found.axes[axis].error_with.median, abs=0.03)
    assert found.error_with.median == min(one.error_with.median for one in verdicts.values())


def test_without_a_path_the_squares_of_the_errors_on_all_axes_add_up(ended: Ended) -> None:
    specs, rng = dict.fromkeys(FLEET, spec_of()), np.random.default_rng(0)
    last, responses = ended.reports[-1], ended.study.responses
    found = judge_transfers(PLAN, last.ranking, specs, responses, rng).verdicts
    for verdict in found.values():
        assert verdict.axes is not None
        each = [one.error_with.median**2 for one in verdict.axes.values()]
        assert verdict.error_with.median**2 == pytest.approx(sum(each) / 2, rel=0.1)
    worse = found["alike-on-x"].axes
    assert worse is not None
    assert worse["y"].error_with.median > 5 * worse["x"].error_with.median


def test_a_source_whose_stored_tests_played_all_axes_is_not_tested_again(ended: Ended) -> None:
    known = [ended.reports[0].responses["alike-on-x"]]
    question = begin(spec_of(), stored={"alike-on-x": known}).ask()
    assert question is not None
    assert set(question.tests) == set(FLEET) - {"alike-on-x"}
    partly = [known[0].own_entries["x"]]
    question = begin(spec_of(), stored={"alike-on-x": partly}).ask()
    assert question is not None
    assert set(question.tests) == set(FLEET)


def test_the_interval_over_all_axes_is_narrowed_to_the_precision_that_is_asked_for(
    ended: Ended,
) -> None:
    best = ended.reports[-1].ranking[0]
    precision = 0.9 * (best.psi_high - best.psi_low)
    questions, reports = to_the_end(begin(spec_of(), replace(PLAN, precision=precision)))
    told = len(ended.questions)
    assert [one.tests for one in questions[:told]] == [one.tests for one in ended.questions]
    assert reports[told - 1].ranking == ended.reports[-1].ranking, "the same answers, the same"
    best = reports[-1].ranking[0]
    assert best.psi_high - best.psi_low <= precision
    assert "is wanted" in questions[-1].purpose


def test_tests_of_all_axes_are_played_at_the_amplitude_of_the_task() -> None:
    question = begin(spec_of(), replace(PLAN, amplitude=0.05)).ask()
    assert question is not None
    played = [one.amplitude for test in question.tests.values() for one in test.played]
    assert played == [0.05] * (2 * len(FLEET))


def test_robots_that_move_too_briefly_for_all_axes_at_once_play_them_one_by_one() -> None:
    brief = spec_of().model_copy(update={"duration_max_s": 9.0})
    study = begin(brief)
    question = study.ask()
    assert question is not None
    assert all(not test.also for test in question.tests.values())


def test_on_each_axis_a_robot_that_settles_slowly_is_at_least_as_far_away_as_it_seems() -> None:
    """Its tests ring 14 times as long as it states, and its tones are too coarse for that."""
    ringing = Finding(code="ringing", text="it still rings", value=56.0)
    study, rng = begin(spec_of(), replace(PLAN, iterations=1)), np.random.default_rng(1)
    question = study.ask()
    assert question is not None
    given = {name: answer(FLEET[name], test, 0.01, rng) for name, test in question.tests.items()}
    for name, one in given.items():
        assert one.matrix is not None
        rows = [replace(row, quality=Quality(warnings=(ringing,))) for row in one.matrix.rows]
        given[name] = replace(one, matrix=replace(one.matrix, rows=tuple(rows)))
    report = study.tell(given, {})
    for estimate in report.ranking:
        assert estimate.axes is not None
        assert estimate.psi_low > 0.0
        assert estimate.psi_high == 1.0
        assert {one.psi_high for one in estimate.axes.values()} == {1.0}
    (said,) = [finding for finding in report.findings if "may be larger" in finding]
    assert "balanced" in said
