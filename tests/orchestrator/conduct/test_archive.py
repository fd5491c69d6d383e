"""Studies stored so that they can be replayed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from archived_studies import DESCRIPTIONS, PLAN, SPEC, archive, begin, measure

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.recipe import make_study, recipe_of
from nufleet.orchestrator.conduct.replay import ResumeError, round_of
from nufleet.orchestrator.repository.errors import DamagedRecordError, UnknownRecordError
from nufleet.orchestrator.repository.records import StudyStatus
from nufleet.orchestrator.study.adaptive_algorithm import AdaptiveStudy
from nufleet.orchestrator.study.paper_algorithm import PaperStudy
from nufleet.shared.errors import StudyError

__all__ = ["archive"]


def test_what_robots_said_of_themselves_comes_back_as_it_was(archive: Archive) -> None:
    begin(archive, "paper")
    stored = archive.repository.studies.study("run-paper")
    assert (stored.fleet, stored.plan, stored.seed) == ("lab", PLAN, 2**70)
    assert recipe_of(stored).specs == dict.fromkeys(DESCRIPTIONS, SPEC)
    assert {r.robot for r in archive.repository.robots.robots("lab")} == set(DESCRIPTIONS)


@pytest.mark.parametrize("algorithm", ["paper", "adaptive"])
def test_a_study_that_is_made_again_asks_what_it_asked(archive: Archive, algorithm: str) -> None:
    begun = begin(archive, algorithm)
    again = archive.repository.studies.study(begun.study_id)
    rng = np.random.default_rng(2**70)
    direct = (
        PaperStudy(PLAN, rng)
        if algorithm == "paper"
        else AdaptiveStudy(PLAN, dict.fromkeys(DESCRIPTIONS, SPEC), rng)
    )
    for record in (begun, again):
        assert make_study(record, archive.repository.studies).ask() == direct.ask()


def test_an_adaptive_study_begins_with_the_responses_that_it_was_given(archive: Archive) -> None:
    first = begin(archive, "adaptive")
    question = make_study(first, archive.repository.studies).ask()
    assert question is not None
    answers = {
        test.robot: measure(archive, test) for test in round_of(first.study_id, question).tests
    }
    second = archive.begin(
        "run-2", "adaptive", PLAN, 1, DESCRIPTIONS, {"near": (f"{first.study_id}.1.near.1",)}
    )
    study = make_study(second, archive.repository.studies)
    question = study.ask()
    assert question is not None
    assert set(question.robots) == {"target", "far"}
    (known,) = study.responses["near"]
    assert known.z.tobytes() == answers["near"].z.tobytes()


def test_a_response_that_is_not_there_is_named(archive: Archive) -> None:
    record = begin(archive, "adaptive", {"near": ("run-0.1.near.1",)})
    with pytest.raises(UnknownRecordError, match=r"run-0\.1\.near\.1"):
        make_study(record, archive.repository.studies)


def test_a_study_of_an_algorithm_that_is_not_known_is_not_guessed_at(archive: Archive) -> None:
    with pytest.raises(ResumeError, match="'oracle'"):
        make_study(begin(archive, "oracle"), archive.repository.studies)


def test_altered_parameters_are_refused(archive: Archive) -> None:
    record = replace(begin(archive, "paper"), parameters={"specs": {"target": 3}})
    with pytest.raises(DamagedRecordError, match=r"run-paper: specs\.target"):
        make_study(record, archive.repository.studies)


@pytest.mark.parametrize(
    ("error", "status"),
    [
        (StudyError("the target is gone"), StudyStatus.FAILED),
        (ResumeError("not its trials"), StudyStatus.OPEN),
        (KeyboardInterrupt(), StudyStatus.OPEN),
    ],
)
def test_only_what_the_study_itself_cannot_get_over_ends_it(
    archive: Archive, error: BaseException, status: StudyStatus
) -> None:
    begin(archive, "paper")
    with pytest.raises(type(error)), archive.conducting("run-paper", lambda: None):
        raise error
    assert archive.repository.studies.study("run-paper").status is status
