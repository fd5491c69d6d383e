"""Studies kept so that they can be made again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from puppet_robot import puppet_spec

from orchestrator.adaptive_selection import AdaptiveStudy
from orchestrator.archive import Archive
from orchestrator.experience_selection import PaperStudy
from orchestrator.held_leases import hold_leases
from orchestrator.repository.errors import DamagedRecordError, UnknownRecordError
from orchestrator.repository.records import StudyRecord, StudyStatus
from orchestrator.repository.repository import open_repository
from orchestrator.resume import OpenTest, ResumeError, round_of
from orchestrator.study import StudyPlan
from orchestrator.study_recipe import make_study, recipe_of
from shared.errors import StudyError
from shared.excitation import ExcitationPlan
from shared.frequency_response import FrequencyResponse
from shared.linear_model import LinearModel
from shared.messages import Description, GoalResult, Outcome
from shared.response_quality import Quality

MODEL = LinearModel(a=((0.1 + 0.2,),), b=(1 / 3,), c=(1.0,), sample_time_s=0.01)
SPEC = puppet_spec()
SPEC = SPEC.model_copy(
    update={"axes": (SPEC.axes[0].model_copy(update={"model": MODEL}), SPEC.axes[1])}
)
PLAN = StudyPlan("target", ("near", "far"), (0.1 + 0.2, 10.0), 5, "x")
DESCRIPTIONS = {
    robot: Description(robot=robot, boot_id="boot-1", spec=SPEC)
    for robot in ("target", "near", "far")
}


@pytest.fixture
def archive(tmp_path: Path) -> Iterator[Archive]:
    with (
        open_repository(f"{tmp_path}/nufleet.sqlite") as repository,
        hold_leases(repository.leases, "lab", DESCRIPTIONS, owner="o") as leases,
    ):
        yield Archive(repository, "lab", leases)


def begin(
    archive: Archive, algorithm: str, stored: dict[str, tuple[str, ...]] | None = None
) -> StudyRecord:
    return archive.begin(f"run-{algorithm}", algorithm, PLAN, 2**70, DESCRIPTIONS, stored)


def measure(archive: Archive, test: OpenTest) -> FrequencyResponse:
    """Store a response to a test."""
    log = archive.log(test.goal_id.split(".")[0])
    omega = np.array([tone.omega_rad_s for tone in test.excitation.tones])
    z = 1 / (1 + 0.1j * omega)
    response = FrequencyResponse(omega, z, np.full(len(omega), 1e-6), 3, Quality())
    plan = ExcitationPlan(
        axis="x",
        tones=test.excitation.tones,
        amplitude=0.1,
        sample_time_s=0.01,
        ramp_samples=1,
        settle_samples=0,
        segments=3,
        segment_samples=4,
    )
    result = GoalResult(
        goal_id=test.goal_id,
        boot_id="boot-1",
        outcome=Outcome.COMPLETED,
        reason="",
        plan=plan,
        reference=np.zeros(plan.samples),
        response=np.zeros(plan.samples),
    )
    log.intend([test])
    log.measured(test, result, response)
    return response


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
