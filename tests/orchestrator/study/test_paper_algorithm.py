"""Algorithm 1 as a pure study: fed with closed forms, no robot and no network."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

from nufleet.orchestrator.study.interface import Report, StudyPlan
from nufleet.orchestrator.study.paper_algorithm import PaperStudy, expected_improvement
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Quality
from nufleet.sims.double_integrator import DoubleIntegratorSettings, closed_loop

# Section V's robots: (α, β) as the paper prints them.
LOOPS = {
    name: closed_loop(DoubleIntegratorSettings(alpha=alpha, beta=beta))
    for name, (alpha, beta) in {
        "target": (0.85, 0.003),
        "source-1": (1.0, 0.003),
        "source-2": (0.97, 0.004),
        "source-3": (0.9, 0.001),
    }.items()
}
SOURCES = ("source-1", "source-2", "source-3")
PLAN = StudyPlan("target", SOURCES, (0.05, 10.0), 7, "x")


def exactly(z: complex, omega: float, variance: float = 0.0) -> FrequencyResponse:
    return FrequencyResponse(np.array([omega]), np.array([z]), np.array([variance]), 4, Quality())


def answers(robots: tuple[str, ...], omega: float) -> Mapping[str, FrequencyResponse]:
    at = np.array([omega])
    return {robot: exactly(LOOPS[robot].frequency_response(at)[0], omega) for robot in robots}


def whole_study(seed: int, plan: StudyPlan = PLAN) -> list[Report]:
    study = PaperStudy(plan, np.random.default_rng(seed))
    reports = []
    while (question := study.ask()) is not None:
        reports.append(study.tell(answers(question.robots, question.omega_rad_s[0]), {}))
    return reports


def true_psi_star(source: str) -> float:
    omega = np.linspace(*PLAN.band_rad_s, 20_001)
    z_1 = LOOPS["target"].frequency_response(omega)
    z_2 = LOOPS[source].frequency_response(omega)
    psi = np.abs(z_1 - z_2) / np.sqrt((1 + np.abs(z_1) ** 2) * (1 + np.abs(z_2) ** 2))
    return float(psi.max())


@pytest.mark.parametrize("seed", range(20))
def test_section_v_selects_source_2_and_estimates_it_within_one_percent(seed: int) -> None:
    reports = whole_study(seed)
    assert [report.selected for report in reports[2:]] == ["source-2"] * 5
    last = reports[-1]
    for estimate in last.ranking:
        assert estimate.psi == pytest.approx(true_psi_star(estimate.robot), rel=0.01)
        assert estimate.tests == PLAN.iterations


def test_the_same_seed_asks_the_same_questions() -> None:
    first, second = whole_study(3), whole_study(3)
    assert [r.omega_rad_s for r in first] == [r.omega_rad_s for r in second]
    assert [r.ranking for r in first] == [r.ranking for r in second]


def test_the_first_frequency_is_uniform_over_the_band() -> None:
    firsts = [
        question.omega_rad_s[0]
        for seed in range(400)
        if (question := PaperStudy(PLAN, np.random.default_rng(seed)).ask()) is not None
    ]
    low, high = PLAN.band_rad_s
    assert min(firsts) >= low
    assert max(firsts) <= high
    quarters, _ = np.histogram(firsts, bins=4, range=PLAN.band_rad_s)
    assert quarters.min() > 60  # of 100 expected; a χ² test at p < 1e-4


def test_asking_twice_is_one_question() -> None:
    study = PaperStudy(PLAN, np.random.default_rng(0))
    assert study.ask() is study.ask()


def test_every_frequency_asked_for_lies_in_the_band() -> None:
    low, high = PLAN.band_rad_s
    assert all(low <= r.omega_rad_s[0] <= high for seed in range(5) for r in whole_study(seed))


def test_the_study_goes_on_without_a_source_that_failed_and_says_so() -> None:
    study = PaperStudy(PLAN, np.random.default_rng(0))
    question = study.ask()
    assert question is not None
    without = {
        robot: response
        for robot, response in answers(question.robots, question.omega_rad_s[0]).items()
        if robot != "source-2"
    }
    report = study.tell(without, {"source-2": "its battery is empty"})
    assert report.dropped == {"source-2": "its battery is empty"}
    assert {estimate.robot for estimate in report.ranking} == {"source-1", "source-3"}
    question = study.ask()
    assert question is not None
    assert question.robots == ("target", "source-1", "source-3")


def test_a_study_without_its_target_ends_with_the_reason() -> None:
    study = PaperStudy(PLAN, np.random.default_rng(0))
    study.ask()
    with pytest.raises(StudyError, match=r"target.*crashed"):
        study.tell({}, {"target": "crashed"})


def test_a_study_whose_sources_are_all_gone_ends_with_the_reasons() -> None:
    study = PaperStudy(PLAN, np.random.default_rng(0))
    study.ask()
    only_target = {"target": exactly(1.0, 1.0)}
    with pytest.raises(StudyError, match=r"source-1: lost; source-2: lost; source-3: lost"):
        study.tell(only_target, dict.fromkeys(SOURCES, "lost"))


def test_identical_robots_give_a_finite_study() -> None:
    plan = StudyPlan("target", ("twin",), (0.1, 10.0), 7, "x")
    study = PaperStudy(plan, np.random.default_rng(0))
    while (question := study.ask()) is not None:
        same = answers(("target",), question.omega_rad_s[0])["target"]
        report = study.tell({"target": same, "twin": same}, {})
    assert report.ranking[0].psi == pytest.approx(0.0, abs=1e-6)


@given(
    mean=st.floats(-1, 1),
    std=st.floats(1e-3, 1),
    best=st.floats(0, 1),
    exploration=st.floats(0, 0.1),
)
def test_expected_improvement_is_the_integral_it_abbreviates(
    mean: float, std: float, best: float, exploration: float
) -> None:
    threshold = best + exploration
    # E[max(ψ − threshold, 0)], written with the survival function to stay accurate in the tail.
    direct, _ = quad(
        lambda t: norm.sf((t - mean) / std), threshold, max(threshold, mean) + 12 * std, limit=200
    )
    found = expected_improvement(np.array([mean]), np.array([std]), best, exploration)[0]
    assert found == pytest.approx(direct, rel=1e-6, abs=1e-9)


def test_expected_improvement_is_zero_where_nothing_is_uncertain() -> None:
    found = expected_improvement(np.array([0.9]), np.array([0.0]), best=0.1, exploration=0.0)
    assert found.tolist() == [0.0]
