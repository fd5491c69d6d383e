"""What the default algorithm makes of flights: it tests what is missing, and before it claims."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from random_loops import BAND, SPEC, Loop, answers

from nufleet.orchestrator.study.adaptive_algorithm import AdaptiveStudy
from nufleet.orchestrator.study.interface import Question, Report, StudyPlan
from nufleet.orchestrator.study.tone_choice import first_look
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.frequency_response import Flight, FrequencyResponse
from nufleet.shared.frequency_test.quality import Quality

FLEET = {"target": Loop(3.0), "near": Loop(3.1, damping=0.75), "far": Loop(1.6, delay_s=0.2)}
WHOLE_BAND = np.linspace(0.25, 5.3, 20)


def flight_of(
    loop: Loop,
    omega_rad_s: FloatArray = WHOLE_BAND,
    *,
    deviation: float = 0.01,
    speed: float = 0.6,
    seed: int = 0,
) -> FrequencyResponse:
    rng = np.random.default_rng([seed, 7])
    error = deviation * rng.standard_normal((2, len(omega_rad_s))) / np.sqrt(2)
    return FrequencyResponse(
        omega_rad_s=omega_rad_s,
        z=loop.z(omega_rad_s) + error[0] + 1j * error[1],
        variance=np.full(len(omega_rad_s), deviation**2),
        segments=3,
        quality=Quality(),
        degrees=np.full(len(omega_rad_s), 60.0),
        flight=Flight(speed=speed, noise_std=0.003),
    )


def study_of(
    stored: Mapping[str, list[FrequencyResponse]],
    *,
    absent: tuple[str, ...] = (),
    fleet: Mapping[str, Loop] = FLEET,
    rounds: int = 8,
) -> AdaptiveStudy:
    plan = StudyPlan("target", tuple(n for n in fleet if n != "target"), BAND, rounds, "x")
    rng = np.random.default_rng(0)
    return AdaptiveStudy(plan, dict.fromkeys(fleet, SPEC), rng, stored=stored, absent=absent)


def to_the_end(
    study: AdaptiveStudy, fleet: Mapping[str, Loop] = FLEET, deviation: float = 0.01
) -> tuple[list[Question], list[Report]]:
    rng = np.random.default_rng(1)
    questions, reports = [], []
    while (question := study.ask()) is not None:
        questions.append(question)
        reports.append(study.tell(answers(fleet, question, deviation, rng), {}))
    return questions, reports


def test_sources_that_flew_need_no_first_test_and_the_selected_one_is_tested_before_the_claim() -> (
    None
):
    stored = {name: [flight_of(FLEET[name], seed=n)] for n, name in enumerate(("near", "far"))}
    questions, reports = to_the_end(study_of(stored))
    assert [question.robots for question in questions] == [
        ("target",),
        ("near",),
        ("target", "near"),
    ]
    reach_rad_s = 2.5 * BAND[0] * (1 + 1e-6)
    assert all(questions[n].omega_rad_s[0] <= reach_rad_s for n in (0, 1)), "nothing is left below"
    assert questions[2].purpose == "what another amplitude does"
    assert reports[0].confidence is not None
    assert reports[0].confidence < 0.95, "nothing is claimed from flights alone"
    assert reports[0].stopped_because is None
    last = reports[-1]
    assert last.selected == "near"
    assert last.confidence is not None
    assert last.confidence >= 0.95
    assert last.findings == ()


def test_a_target_that_flew_is_tested_all_the_same() -> None:
    stored = {name: [flight_of(loop)] for name, loop in FLEET.items()}
    first = study_of(stored).ask()
    assert first is not None
    assert first.robots == ("target",)


def test_what_is_known_of_an_absent_robot_from_flights_alone_is_no_claim() -> None:
    stored = {"near": [flight_of(FLEET["near"])]}
    questions, reports = to_the_end(study_of(stored, absent=("near",)))
    assert all("near" not in question.robots for question in questions)
    last = reports[-1]
    assert last.selected == "near"
    assert last.confidence is not None
    assert last.confidence < 0.95
    assert last.stopped_because is not None
    assert "from flights alone" in last.stopped_because


def test_a_target_whose_test_misses_its_flight_makes_all_flights_doubtful() -> None:
    """As on robots that are not linear: the response to a drawing is not that to tones."""
    other = {"target": Loop(2.2), "near": Loop(2.3, damping=0.75), "far": Loop(3.3)}
    stored = {name: [flight_of(loop)] for name, loop in other.items()}
    study = study_of(stored)
    questions, reports = to_the_end(study)
    assert any("its flights and its test" in finding for finding in reports[0].findings)
    assert set(questions[1].robots) == {"near", "far"}, "no source is judged by flights any more"
    last = reports[-1]
    assert last.confidence is not None
    assert last.confidence < 0.95
    assert last.stopped_because is not None
    assert "without a claim" in last.stopped_because
    assert reports[-1].selected == "near"


def test_a_source_with_stored_tests_is_tested_again_where_they_leave_the_choice_open() -> None:
    fleet = {"target": Loop(3.0), "one": Loop(3.5), "other": Loop(2.6)}
    rng = np.random.default_rng(0)
    test = first_look(BAND, SPEC, 11, 0.7).excitation("x")
    stored = {name: [fleet[name].answer(test, 0.2, rng)] for name in ("one", "other")}
    questions, _ = to_the_end(study_of(stored, fleet=fleet, rounds=4), fleet, 0.02)
    assert questions[0].robots == ("target",)
    assert any({"one", "other"} & set(question.robots) for question in questions[1:])


def test_a_part_of_the_band_that_no_flight_covers_is_tested() -> None:
    slow = np.linspace(0.25, 1.5, 8)
    fleet = {"target": Loop(3.0), "one": Loop(3.4), "other": Loop(2.5)}
    stored = {name: [flight_of(fleet[name], slow)] for name in ("one", "other")}
    questions, reports = to_the_end(study_of(stored, fleet=fleet), fleet)
    tested = {robot for question in questions for robot in question.robots}
    assert reports[-1].selected in tested
    assert reports[-1].selected == "one"
