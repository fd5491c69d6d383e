"""Robots, studies, trials and responses: the same contract on both databases."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from learned_things import experience
from polling import PATIENCE_S
from repository_records import (
    FLEET,
    LONGER,
    PLAN,
    SPEC,
    STUDY,
    TEST,
    accepted,
    identical,
    intent,
    measurement,
    response,
    result,
)

from nufleet.orchestrator.repository.errors import (
    RecordConflictError,
    StaleEpochError,
    TrialEndedError,
    UnknownRecordError,
)
from nufleet.orchestrator.repository.records import (
    ExperienceRecord,
    RobotRecord,
    StudyStatus,
    TrialEnd,
    TrialRecord,
    TrialStatus,
)
from nufleet.orchestrator.repository.repository import Repository, open_repository
from nufleet.shared.frequency_test.excitation import ExcitationPlan, PlannedTones, Tone
from nufleet.shared.frequency_test.matrix_response import MatrixResponse
from nufleet.shared.frequency_test.quality import Finding
from nufleet.shared.wire.messages import Outcome

UNUSABLE = Finding(code="clipped", text="the output is clipped")


def test_a_robot_is_known_as_it_last_described_itself(repository: Repository) -> None:
    repository.robots.describe(RobotRecord(FLEET, "r2", SPEC, "boot-1"))
    repository.robots.describe(RobotRecord(FLEET, "r1", SPEC, "boot-1"))
    repository.robots.describe(RobotRecord("other", "r1", SPEC, "boot-1"))
    changed = RobotRecord(FLEET, "r1", SPEC.model_copy(update={"duration_max_s": 7.0}), "boot-2")
    repository.robots.describe(changed)
    assert repository.robots.robots(FLEET) == (
        changed,
        RobotRecord(FLEET, "r2", SPEC, "boot-1"),
    )


def test_a_study_is_returned_as_it_was_begun_by_another_process(
    begun: Repository, address: str
) -> None:
    with open_repository(address) as other:
        assert other.studies.study("run-1") == STUDY
        assert other.studies.studies(StudyStatus.OPEN) == (STUDY,)


def test_a_study_that_ended_is_not_open_any_more(begun: Repository) -> None:
    begun.studies.begin(replace(STUDY, study_id="run-2"))
    begun.studies.end("run-1", StudyStatus.FAILED, "the target is gone\x00 \ud800")
    assert [study.study_id for study in begun.studies.studies(StudyStatus.OPEN)] == ["run-2"]
    ended = begun.studies.study("run-1")
    assert (ended.status, ended.reason) == (StudyStatus.FAILED, "the target is gone\x00 \ud800")
    assert ended.result is None


def test_a_complete_study_has_its_result(begun: Repository) -> None:
    result = {"selected": "source", "psi": 0.1 + 0.2, "ranking": [{"robot": "source"}]}
    begun.studies.end("run-1", StudyStatus.COMPLETE, "sure enough", result)
    ended = begun.studies.study("run-1")
    assert (ended.status, ended.reason) == (StudyStatus.COMPLETE, "sure enough")
    assert ended.result == result


def test_a_study_begins_once(begun: Repository) -> None:
    with pytest.raises(RecordConflictError, match="repository"):
        begun.studies.begin(replace(STUDY, seed=1))
    assert begun.studies.study("run-1").seed == STUDY.seed


def test_what_was_never_stored_is_refused_by_name(repository: Repository) -> None:
    studies, robots = repository.studies, repository.robots
    with pytest.raises(UnknownRecordError, match="run-9"):
        studies.study("run-9")
    with pytest.raises(UnknownRecordError, match="run-9"):
        studies.end("run-9", StudyStatus.COMPLETE)
    with pytest.raises(UnknownRecordError):
        studies.intend(intent())
    with pytest.raises(UnknownRecordError, match=r"run-1\.1\.target\.1"):
        studies.accepted(accepted(intent()), epoch=1)
    with pytest.raises(UnknownRecordError, match=r"run-1\.1\.target\.1"):
        studies.result("run-1.1.target.1")
    with pytest.raises(UnknownRecordError, match=r"run-1\.1\.target\.1"):
        studies.response("run-1.1.target.1")
    with pytest.raises(UnknownRecordError, match="000"):
        robots.experience(FLEET, "0" * 64)
    with pytest.raises(UnknownRecordError):
        robots.add_experience(ExperienceRecord(FLEET, "run-1", experience("nobody")))


def test_the_intents_of_a_round_are_stored_together_or_not_at_all(begun: Repository) -> None:
    target, source = intent("target"), intent("source")
    assert [t.intent for t in begun.studies.intend(target, source)] == [target, source]
    second = intent("target", attempt=2)
    with pytest.raises(RecordConflictError):
        begun.studies.intend(second, replace(source, excitation=LONGER))
    assert {t.intent for t in begun.studies.trials("run-1")} == {target, source}


def test_an_intent_is_there_before_anything_is_sent(begun: Repository, address: str) -> None:
    begun.studies.intend(intent())
    with open_repository(address) as other:
        assert other.studies.trials("run-1") == (TrialRecord(intent(), TrialStatus.INTENDED),)


@pytest.mark.parametrize(
    "known",
    [
        {},
        {"degrees": np.array([3.9, 6.0]), "amplitude": 0.1},
        {"hidden_variance": np.array([1e-4, 0.0])},
    ],
)
def test_a_measured_trial_comes_back_bit_for_bit(
    begun: Repository, address: str, known: dict[str, Any]
) -> None:
    trial, measured = intent(), replace(response(), **known)
    begun.studies.intend(trial)
    begun.studies.accepted(accepted(trial), epoch=1)
    begun.studies.ended(trial.goal_id, measurement(trial, measured), epoch=1)
    with open_repository(address) as other:
        (record,) = other.studies.trials("run-1")
        back = other.studies.result(trial.goal_id)
        (kept,) = other.studies.responses(FLEET, "target", "x")
    assert (record.status, record.boot_id, record.plan) == (TrialStatus.MEASURED, "boot-1", PLAN)
    assert record.outcome is Outcome.COMPLETED
    assert record.robot_time_s == pytest.approx(PLAN.duration_s)
    assert record.response is not None
    assert identical(record.response, measured)
    assert identical(kept.response, measured)
    assert (kept.goal_id, kept.study_id, kept.kind) == (trial.goal_id, "run-1", SPEC.kind)
    assert abs(datetime.now(UTC) - kept.measured_at) < timedelta(minutes=10)
    assert identical(begun.studies.response(trial.goal_id).response, measured)
    sent = result(trial)
    assert back.reference.tobytes() == sent.reference.tobytes()
    assert back.response.tobytes() == sent.response.tobytes()
    assert back.plan == sent.plan


def test_a_test_of_several_axes_comes_back_with_every_entry_and_both_columns(
    begun: Repository, address: str
) -> None:
    joint = ExcitationPlan.model_validate(
        {
            **PLAN.model_dump(),
            "also": (PlannedTones(axis="y", tones=(Tone(omega_rad_s=1.0),), amplitude=0.2),),
        }
    )
    hidden = np.zeros(2), np.array([0.01, 0.0])
    rows = (
        replace(response(), hidden_variance=hidden[0]),
        replace(
            response(UNUSABLE),
            degrees=np.array([3.0, 6.0]),
            amplitude=0.2,
            hidden_variance=hidden[1],
        ),
    )
    correlation = np.array([[1.0, 0.1 - 0.2j], [0.1 + 0.2j, 1.0]])
    matrix = MatrixResponse(("x", "y"), np.array([0, 1]), rows, correlation)
    measured = replace(matrix.entry(0, 0), matrix=matrix)
    trial, samples = intent(), np.random.default_rng(5).standard_normal((2, joint.samples, 2))
    sent = result(trial).model_copy(
        update={"plan": joint, "reference": samples[0], "response": samples[1]}
    )
    begun.studies.intend(trial)
    end = TrialEnd(TrialStatus.MEASURED, result=sent, response=measured)
    begun.studies.ended(trial.goal_id, end, epoch=1)
    with open_repository(address) as other:
        (record,) = other.studies.trials("run-1")
        back = other.studies.result(trial.goal_id)
    assert record.plan == joint
    assert back.response.tobytes() == sent.response.tobytes()
    assert record.response is not None
    assert identical(record.response, measured)
    kept = record.response.matrix
    assert kept is not None
    assert kept.axes == matrix.axes
    assert kept.played_by.tolist() == [0, 1]
    assert kept.correlation.tobytes() == correlation.tobytes()
    for stored, row in zip(kept.rows, rows, strict=True):
        assert identical(stored, replace(row, degrees=row.degrees_of_freedom))


def test_samples_that_are_forgotten_leave_the_response_and_the_samples_of_other_runs(
    begun: Repository,
) -> None:
    begun.studies.begin(replace(STUDY, study_id="run-10"))
    other = replace(intent(), study_id="run-10", goal_id="run-10.1.target.1")
    for trial in (intent(), other):
        begun.studies.intend(trial)
        begun.studies.ended(trial.goal_id, measurement(trial), epoch=1)
    assert begun.studies.forget_samples("run-1") == 1
    assert begun.studies.forget_samples("run-1") == 0
    assert begun.studies.forget_samples("run-9") == 0
    with pytest.raises(UnknownRecordError, match="no samples"):
        begun.studies.result(intent().goal_id)
    assert begun.studies.response(intent().goal_id).robot == "target"
    assert begun.studies.result(other.goal_id).goal_id == other.goal_id


def test_a_trial_can_be_measured_though_its_acceptance_never_arrived(begun: Repository) -> None:
    begun.studies.intend(intent())
    begun.studies.ended(intent().goal_id, measurement(intent()), epoch=1)
    (record,) = begun.studies.trials("run-1")
    assert (record.status, record.boot_id, record.plan) == (TrialStatus.MEASURED, "boot-1", PLAN)


def test_an_unusable_test_keeps_its_samples_and_what_its_robot_plays_next(
    begun: Repository,
) -> None:
    begun.studies.intend(intent())
    clipped = TrialEnd(
        TrialStatus.FAILED,
        "clipped",
        LONGER,
        result=result(intent()),
        response=response(UNUSABLE),
    )
    begun.studies.ended(intent().goal_id, clipped, epoch=1)
    (record,) = begun.studies.trials("run-1")
    assert (record.status, record.reason, record.retry) == (TrialStatus.FAILED, "clipped", LONGER)
    assert not begun.studies.responses(FLEET, "target", "x")
    (kept,) = begun.studies.responses(FLEET, "target", "x", usable=False)
    assert kept.response.quality.reasons == (UNUSABLE,)
    assert len(begun.studies.result(intent().goal_id).response) == PLAN.samples


def test_a_motion_that_was_cut_short_keeps_the_samples_it_has(begun: Repository) -> None:
    begun.studies.intend(intent())
    stopped = TrialEnd(TrialStatus.FAILED, "stopped", result=result(intent(), Outcome.ABORTED))
    begun.studies.ended(intent().goal_id, stopped, epoch=1)
    kept = begun.studies.result(intent().goal_id)
    assert (kept.outcome, len(kept.response)) == (Outcome.ABORTED, 5)
    (record,) = begun.studies.trials("run-1")
    assert (record.response, record.retry, record.interrupted) == (None, None, False)


def test_a_trial_that_ended_with_its_orchestrator_says_so(begun: Repository) -> None:
    begun.studies.intend(intent("target"), intent("source"))
    aborted = result(intent("target"), Outcome.ABORTED)
    failed = TrialEnd(
        TrialStatus.FAILED, "its owner is gone", TEST, interrupted=True, result=aborted
    )
    begun.studies.ended(aborted.goal_id, failed, epoch=1)
    lost = TrialEnd(TrialStatus.LOST, "gone", TEST, interrupted=True)
    begun.studies.ended("run-1.1.source.1", lost, epoch=1)
    assert [trial.interrupted for trial in begun.studies.trials("run-1")] == [True, True]


def test_storing_the_same_again_changes_nothing(begun: Repository) -> None:
    trial = intent()
    for _ in range(2):
        begun.studies.intend(trial)
    for _ in range(2):
        begun.studies.accepted(accepted(trial), epoch=1)
    for _ in range(2):
        begun.studies.ended(trial.goal_id, measurement(trial), epoch=1)
    assert [t.status for t in begun.studies.intend(trial)] == [TrialStatus.MEASURED]
    assert [t.status for t in begun.studies.trials("run-1")] == [TrialStatus.MEASURED]


def test_the_first_end_of_a_trial_stays(begun: Repository) -> None:
    begun.studies.intend(intent())
    lost = TrialEnd(TrialStatus.LOST, "its agent died", TEST)
    begun.studies.ended(intent().goal_id, lost, epoch=1)
    with pytest.raises(TrialEndedError, match="ended as lost"):
        begun.studies.ended(intent().goal_id, measurement(intent()), epoch=1)
    with pytest.raises(TrialEndedError):
        begun.studies.accepted(accepted(intent()), epoch=1)
    (record,) = begun.studies.trials("run-1")
    assert (record.status, record.retry, record.response) == (TrialStatus.LOST, TEST, None)
    with pytest.raises(UnknownRecordError):
        begun.studies.result(intent().goal_id)


def test_a_goal_cannot_be_accepted_by_two_agent_processes(begun: Repository) -> None:
    begun.studies.intend(intent())
    begun.studies.accepted(accepted(intent(), "boot-1"), epoch=1)
    with pytest.raises(TrialEndedError, match="boot-2"):
        begun.studies.accepted(accepted(intent(), "boot-2"), epoch=1)


def test_a_goal_id_means_one_test(begun: Repository) -> None:
    begun.studies.intend(intent())
    with pytest.raises(RecordConflictError, match="a different test"):
        begun.studies.intend(replace(intent(), excitation=LONGER))
    with pytest.raises(RecordConflictError, match="under an id other than"):
        begun.studies.intend(replace(intent(), goal_id="another"))


def test_an_owner_of_the_past_cannot_write_about_a_trial(begun: Repository) -> None:
    trial = intent(epoch=1)
    begun.studies.intend(trial)
    begun.studies.intend(intent(epoch=2))
    with pytest.raises(StaleEpochError, match="epoch 2"):
        begun.studies.intend(trial)
    with pytest.raises(StaleEpochError):
        begun.studies.accepted(accepted(trial), epoch=1)
    with pytest.raises(StaleEpochError):
        begun.studies.ended(trial.goal_id, measurement(trial), epoch=1)
    with pytest.raises(StaleEpochError):
        begun.studies.ended(trial.goal_id, TrialEnd(TrialStatus.LOST, "silent"), epoch=1)
    (record,) = begun.studies.trials("run-1")
    assert record == TrialRecord(intent(epoch=2), TrialStatus.INTENDED)


def test_threads_store_the_trials_of_a_round_at_the_same_time(begun: Repository) -> None:
    trials = [intent(f"r{n}") for n in range(16)]
    together = threading.Barrier(4, timeout=PATIENCE_S)

    def store(worker: int) -> None:
        together.wait()
        for trial in trials[worker::4]:
            begun.studies.intend(trial)
            begun.studies.accepted(accepted(trial), epoch=1)

    with ThreadPoolExecutor(4) as pool:
        list(pool.map(store, range(4)))
    stored = begun.studies.trials("run-1")
    assert {trial.intent for trial in stored} == set(trials)
    assert {trial.status for trial in stored} == {TrialStatus.ACCEPTED}


@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(text=st.text())
def test_any_text_and_number_comes_back_as_it_was(begun: Repository, text: str) -> None:
    begun.studies.end("run-1", StudyStatus.FAILED, text)
    assert begun.studies.study("run-1").reason == text
