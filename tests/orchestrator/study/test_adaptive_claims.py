"""What a study claims, what it leaves open, and what it does before it claims anything."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest
from random_loops import BAND, SPEC, Loop, answers

from nufleet.orchestrator.study.adaptive_algorithm import AdaptiveStudy
from nufleet.orchestrator.study.interface import Report, StudyPlan
from nufleet.orchestrator.study.tone_choice import first_look, lowest_look
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Finding, Quality

FLEET = {
    "target": Loop(3.0),
    "near": Loop(3.1, damping=0.75),
    "middle": Loop(4.0),
    "far": Loop(1.6, delay_s=0.2),
}
RINGING = Quality(warnings=(Finding(code="ringing", text="it still rings", value=40.0),))
"""What tests say of a robot that settles ten times more slowly than `SPEC` states."""
SILENT = Quality(warnings=(Finding(code="no-response", text="no response"),))


class Shaking(Loop):
    """A loop on which something shakes, with a damping ratio of 0.04, between 1.5 and 2.5 rad/s."""

    def z(self, omega_rad_s: FloatArray) -> ComplexArray:
        s = 1j * omega_rad_s / 1.95
        damping = 2 * 0.04 * s
        return super().z(omega_rad_s) * (1 + damping / (s**2 + damping + 1))


MISSTATED = {"target": Loop(3.0), "near": Loop(3.8), "rival": Shaking(3.1)}
"""Loops of which the one that shakes is the closest at the tones of a first test."""


def still(response: FrequencyResponse) -> FrequencyResponse:
    return replace(response, z=0.001 * response.z, quality=SILENT)


def last_of(
    fleet: Mapping[str, Loop],
    *,
    silent: tuple[str, ...] = (),
    failed: Mapping[str, str] | None = None,
    weaker: Mapping[str, float] | None = None,
    plan: StudyPlan | None = None,
    ringing: bool = False,
) -> tuple[Report, list[tuple[str, ...]]]:
    """Return the last report of a study, and the robots of each round."""
    sources = tuple(name for name in fleet if name != "target")
    plan = plan or StudyPlan("target", sources, BAND, 8, "x")
    rng = np.random.default_rng(0)
    study = AdaptiveStudy(plan, dict.fromkeys(fleet, SPEC), rng)
    report, asked = None, []
    while (question := study.ask()) is not None:
        asked.append(question.robots)
        given = answers(fleet, question, 0.005, rng)
        for name in question.robots:
            played = question.tests[name].amplitude or 0.2
            share = 1 + (weaker or {}).get(name, 0.0) * np.log2(0.2 / played)
            given[name] = replace(given[name], z=share * given[name].z, amplitude=played)
            if ringing:
                given[name] = replace(given[name], quality=RINGING)
            if name in silent:
                given[name] = still(given[name])
            if name in (failed or {}):
                del given[name]
        report = study.tell(given, failed or {})
    assert report is not None
    return report, asked


def test_a_source_that_could_not_be_measured_counts_as_possibly_the_closest() -> None:
    report, _ = last_of(FLEET, failed={"middle": "its battery is empty"})
    assert report.selected == "near"
    assert report.confidence == pytest.approx(2 / 3, abs=0.02)
    assert report.stopped_because is not None
    assert "test again: middle (its battery is empty)" in report.stopped_because


def test_a_robot_that_responds_to_no_tone_is_asked_for_lower_ones_and_dropped() -> None:
    report, asked = last_of(FLEET, silent=("far",))
    assert report.selected == "near"
    if "far" in report.dropped:
        assert "responds to no tone from 0.2 rad/s on" in report.dropped["far"]
        assert "dead zone" in report.dropped["far"]
    else:
        assert "far" in report.eliminated, "no response is a measurement, and a far one"
    assert len(asked) <= 3


def test_a_target_that_responds_to_no_tone_ends_the_study_with_the_reason() -> None:
    with pytest.raises(StudyError, match="target cannot be tested: it responds to no tone"):
        last_of(FLEET, silent=("target",))


@pytest.mark.parametrize("absent", [(), ("near", "far")])
def test_stored_responses_that_contradict_each_other_or_todays_are_said_with_what_helps(
    absent: tuple[str, ...],
) -> None:
    rng = np.random.default_rng(1)
    first = first_look(BAND, SPEC, 11, 0.7)
    early, late = first.excitation("x"), lowest_look(SPEC, 2 * BAND[0], first).excitation("x")
    fleet = {name: FLEET[name] for name in ("target", "near", "far")}
    loaded = Loop(3.1, damping=0.75, gain=0.8)
    stored = {
        "near": [loaded.answer(early, 0.005, rng)],
        "far": [fleet["far"].answer(early, 0.005, rng)],
    }
    if absent:
        stored["near"].append(fleet["near"].answer(late, 0.005, rng))
    plan = StudyPlan("target", ("near", "far"), BAND, 8, "x")
    specs = dict.fromkeys(fleet, SPEC)
    study = AdaptiveStudy(plan, specs, rng, stored=stored, absent=absent)
    while (question := study.ask()) is not None:
        report = study.tell(answers(fleet, question, 0.005, rng), {})
    assert report.stopped_because is not None
    (said,) = [finding for finding in report.findings if finding.startswith("near: its response")]
    assert "changed between tests, by 0.2" in said or "changed between tests, by 0.1" in said
    assert said.endswith("if it has changed, test again without --reuse")
    near = report.ranking[0]
    assert near.robot == "near"
    assert near.psi_high - near.psi_low > 0.1, "neither of the two is believed more"


def test_a_response_that_depends_on_the_amplitude_is_said_and_believed_less() -> None:
    linear, _ = last_of(FLEET)
    bent, _ = last_of(FLEET, weaker={"target": -0.1})
    assert linear.findings == ()
    said = [finding for finding in bent.findings if "depends on the amplitude" in finding]
    assert len(said) == 1
    assert said[0].startswith("target: its response depends on the amplitude: at 0.1 m it is 0.")
    assert said[0].endswith("as with friction")
    widths = [r.ranking[0].psi_high - r.ranking[0].psi_low for r in (linear, bent)]
    assert widths[1] > 2 * widths[0]


@pytest.mark.parametrize(("amplitude", "larger"), [(None, False), (0.2, False), (1.0, True)])
def test_a_task_larger_than_any_test_is_said(amplitude: float | None, larger: bool) -> None:
    plan = StudyPlan("target", ("near", "middle", "far"), BAND, 8, "x", amplitude=amplitude)
    report, _ = last_of(FLEET, plan=plan)
    said = [finding for finding in report.findings if "larger motions" in finding]
    assert bool(said) is larger
    if larger:
        robots, _, text = said[0].partition(": ")
        assert robots == "target, near"
        assert text.startswith("the task moves by 1 m, and tests by 0.")


def test_a_task_smaller_than_any_stored_test_is_said() -> None:
    rng = np.random.default_rng(1)
    first = first_look(BAND, SPEC, 11, 0.7).excitation("x")
    tests = [replace(FLEET["near"].answer(first, 0.005, rng), amplitude=0.3)]
    plan = StudyPlan("target", ("near",), BAND, 8, "x", amplitude=0.02)
    specs = dict.fromkeys(("target", "near"), SPEC)
    study = AdaptiveStudy(plan, specs, rng, stored={"near": tests}, absent=("near",))
    question = study.ask()
    assert question is not None
    given = {
        name: replace(one, amplitude=question.tests[name].amplitude)
        for name, one in answers(FLEET, question, 0.005, rng).items()
    }
    (said,) = [one for one in study.tell(given, {}).findings if "the task moves" in one]
    assert said.startswith("near: the task moves by 0.02 m, and tests by 0.3 m at least")


def test_with_a_precision_it_goes_on_until_the_interval_is_as_narrow() -> None:
    plan = StudyPlan("target", ("near", "middle", "far"), BAND, 12, "x")
    loose, rounds = last_of(FLEET, plan=plan)
    width = loose.ranking[0].psi_high - loose.ranking[0].psi_low
    tight, more = last_of(FLEET, plan=replace(plan, precision=0.7 * width))
    assert tight.ranking[0].psi_high - tight.ranking[0].psi_low <= 0.7 * width
    assert len(more) > len(rounds)


def test_the_estimate_names_the_largest_distance_that_was_measured() -> None:
    report, _ = last_of(FLEET)
    for estimate in report.ranking:
        assert estimate.measured_psi is not None
        assert estimate.measured_omega_rad_s is not None
        assert BAND[0] <= estimate.measured_omega_rad_s <= BAND[1]
        assert estimate.psi_low - 0.02 < estimate.measured_psi < estimate.psi_high + 0.02
        assert estimate.psi_low <= estimate.psi <= estimate.psi_high


def test_a_rival_is_not_asked_below_its_lowest_tone_where_what_was_seen_of_it_is_enough() -> None:
    fleet = {"target": Loop(3.0), "near": Loop(3.3), "rival": Loop(3.31)}
    report, asked = last_of(fleet)
    assert report.selected == "near"
    assert (report.confidence or 0.0) >= 0.95
    assert "rival" not in report.eliminated
    assert sum("rival" in robots for robots in asked) == 1, "unseen, it can only be further away"
    assert sum("near" in robots for robots in asked) == 2


def test_a_test_that_a_claim_needs_anyway_comes_before_others_of_what_is_contested() -> None:
    fleet = {"target": Loop(3.0), "one": Loop(3.3), "other": Loop(2.75)}
    study = AdaptiveStudy(
        StudyPlan("target", ("one", "other"), BAND, 8, "x"),
        dict.fromkeys(fleet, SPEC),
        np.random.default_rng(0),
    )
    rng = np.random.default_rng(0)
    for purpose in ("a first look", "what is contested"):
        question = study.ask()
        assert question is not None
        assert question.purpose.startswith(purpose)
        report = study.tell(answers(fleet, question, 0.02, rng), {})
    assert question.robots == ("target",)
    assert question.tests["target"].tones[0].omega_rad_s <= 2.5 * BAND[0]
    assert report.stopped_because is None


def test_a_doubt_that_no_test_tells_ends_the_study_before_its_rounds_are_used() -> None:
    fleet = {"target": Loop(3.0), "one": Loop(3.3), "other": Loop(2.7)}
    report, asked = last_of(fleet, weaker={"target": -0.4, "one": -0.4, "other": -0.4})
    assert (report.confidence or 0.0) < 0.95
    assert report.stopped_because is not None
    assert report.stopped_because.startswith("no further test would help")
    assert len(asked) < 8


def test_where_something_is_doubted_tests_that_told_nothing_are_not_repeated() -> None:
    fleet = {"target": Loop(3.0), "one": Loop(3.3), "other": Loop(2.7)}
    report, asked = last_of(fleet, weaker={"target": -0.3})
    assert (report.confidence or 0.0) < 0.95
    assert report.stopped_because is not None
    assert report.stopped_because.startswith("no further test would help")
    assert len(asked) == 3


def test_a_rival_is_not_beaten_by_what_nothing_measured_between_its_tones() -> None:
    report, asked = last_of(MISSTATED, ringing=True)
    assert report.selected == "near"
    assert (report.confidence or 0.0) >= 0.95
    assert "rival" in asked[-1], "resonances as narrow as settling is slow were looked for"
    ranking = {one.robot: one for one in report.ranking}
    assert ranking["rival"].psi_low > ranking["near"].psi_high
    assert max(one.psi_high for one in report.ranking) < 0.5
    assert not [one for one in report.findings if "may be larger" in one]


def test_what_several_robots_misstate_alike_is_one_finding() -> None:
    report, _ = last_of(MISSTATED, ringing=True)
    found = [finding for finding in report.findings if "settling time is stated" in finding]
    assert len(found) == 1
    assert found[0].startswith("target, near, rival: the settling time is stated as 4 s, and it")


def test_a_robot_that_settles_slowly_is_at_least_as_far_away_as_its_coarse_tones_say() -> None:
    grid = np.linspace(*BAND, 2001)
    plan = StudyPlan("target", ("near", "rival"), BAND, 1, "x")
    settled, _ = last_of(MISSTATED, plan=plan)
    report, _ = last_of(MISSTATED, plan=plan, ringing=True)
    assert max(one.psi_high for one in settled.ranking) < 0.5
    for one in report.ranking:
        truth = chordal_distance(MISSTATED["target"].z(grid), MISSTATED[one.robot].z(grid)).max()
        assert one.psi_low < truth < one.psi_high == 1.0
    (said,) = [one for one in report.findings if "may be larger" in one]
    assert said == (
        "the distance of near, rival may be larger: resonances as narrow as settling was found to "
        "be slow were not looked for in the whole band on target, near, rival"
    )


def test_a_study_that_ends_says_what_was_not_seen_of_rivals_that_cannot_be_tested() -> None:
    rng = np.random.default_rng(0)
    first = first_look(BAND, SPEC, 11, 0.7)
    tests = [first, lowest_look(SPEC, 2 * BAND[0], first)]
    known = [MISSTATED["rival"].answer(test.excitation("x"), 0.001, rng) for test in tests]
    study = AdaptiveStudy(
        StudyPlan("target", ("near", "rival"), BAND, 8, "x"),
        dict.fromkeys(MISSTATED, SPEC),
        rng,
        stored={"rival": known},
        absent=("rival",),
    )
    while (question := study.ask()) is not None:
        given = answers(MISSTATED, question, 0.005, rng)
        report = study.tell({n: replace(one, quality=RINGING) for n, one in given.items()}, {})
    assert (report.confidence or 0.0) < 0.95
    assert report.stopped_because is not None
    assert report.stopped_because.startswith(
        "resonances as narrow as settling is slow were not looked for on rival; P("
    )
