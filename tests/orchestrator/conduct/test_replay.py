"""A study cut off after any store continues to the same trials and the same ranking."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace

import numpy as np
import pytest

from nufleet.orchestrator.conduct.replay import OpenTest, ResumeError, resume, tried_again
from nufleet.orchestrator.repository.records import (
    RobotRecord,
    StudyRecord,
    TrialEnd,
    TrialIntent,
    TrialRecord,
    TrialStatus,
)
from nufleet.orchestrator.repository.repository import Repository, open_repository
from nufleet.orchestrator.study.interface import Report, StudyPlan
from nufleet.orchestrator.study.paper_algorithm import PaperStudy
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.excitation import ExcitationPlan
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Finding, Quality
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.shared.wire.messages import GoalAccepted, GoalResult, Outcome
from nufleet.sims.double_integrator import DoubleIntegratorSettings, closed_loop

LOOPS = {
    name: closed_loop(DoubleIntegratorSettings(alpha=alpha, beta=beta))
    for name, (alpha, beta) in {
        "target": (0.85, 0.003),
        "source-1": (1.0, 0.003),
        "source-2": (0.97, 0.004),
        "source-3": (0.9, 0.001),
    }.items()
}
SPEC = RobotSpec(
    kind="puppet",
    axes=(AxisSpec(name="x", unit="m", amplitude_max=1.0, velocity_max=1.0, acceleration_max=9.0),),
    sample_time_s=0.01,
    omega_min_rad_s=0.05,
    omega_max_rad_s=20.0,
    duration_max_s=600.0,
    settling_time_s=1.0,
    simulated=True,
)
PLAN = StudyPlan("target", ("source-1", "source-2", "source-3"), (0.05, 10.0), 4, "x")
EPOCH = 1
UNUSABLE = {(1, "source-1", 1), (3, "source-3", 1), (3, "source-3", 2), (3, "source-3", 3)}
LOST = {(2, "target", 1), (4, "source-1", 1)}


def study(seed: int = 7) -> PaperStudy:
    return PaperStudy(PLAN, np.random.default_rng(seed))


def life_of(test: OpenTest) -> Iterator[TrialRecord]:
    """Every state of an attempt that is to be stored, from the one it has to its end.

    What a robot answers depends on the goal alone: asked again it has the same result.
    """
    where = (test.iteration, test.robot, test.attempt)
    intent = TrialIntent(
        test.goal_id, "run-1", test.iteration, test.robot, test.attempt, test.excitation, EPOCH
    )
    if test.record is None:
        yield TrialRecord(intent, TrialStatus.INTENDED)
    tones = test.excitation.tones
    plan = ExcitationPlan(
        axis="x",
        tones=tones,
        amplitude=0.1,
        sample_time_s=0.01,
        ramp_samples=1,
        settle_samples=0,
        segments=3,
        segment_samples=4,
    )
    accepted = TrialRecord(intent, TrialStatus.ACCEPTED, "boot-1", plan)
    if test.record is None or test.record.status is TrialStatus.INTENDED:
        yield accepted
    if where in LOST:
        yield replace(accepted, status=TrialStatus.LOST, reason="died", retry=test.excitation)
        return
    omega = np.array([tone.omega_rad_s for tone in tones])
    noise = np.random.default_rng(where[0] * 100 + where[2]).normal(0.0, 1e-3, 2)
    z = LOOPS[test.robot].frequency_response(omega) + complex(*noise)
    played = replace(accepted, outcome=Outcome.COMPLETED, robot_time_s=plan.duration_s)
    if where in UNUSABLE:
        quality = Quality(reasons=(Finding(code="clipped", text="the output is clipped"),))
        yield replace(
            played,
            status=TrialStatus.FAILED,
            reason="clipped",
            retry=None if test.attempt == 3 else test.excitation.model_copy(update={"segments": 8}),
            response=FrequencyResponse(omega, z, np.full(1, 1e-6), 3, quality),
        )
        return
    response = FrequencyResponse(omega, z, np.full(1, 1e-6), 3, Quality())
    yield replace(played, status=TrialStatus.MEASURED, response=response)


def as_next(test: OpenTest, end: TrialRecord) -> OpenTest | None:
    """The attempt that follows on one that ended; None when that one decided."""
    if end.retry is None:
        return None
    number = test.attempt + 1
    goal_id = f"run-1.{test.iteration}.{test.robot}.{number}"
    return OpenTest(goal_id, test.iteration, test.robot, number, end.retry, None)


@dataclass
class History:
    """Trials as they are stored, in memory, and what the study said on the way."""

    trials: dict[str, TrialRecord] = field(default_factory=dict)
    reports: list[Report] = field(default_factory=list)
    questions: list[tuple[float, ...]] = field(default_factory=list)

    def store(self, record: TrialRecord) -> None:
        self.trials[record.intent.goal_id] = record

    def go_on(self, after_store: Callable[[TrialRecord], None], seed: int = 7) -> None:
        """Resume from the trials there are and conduct the study to its end.

        The robots of a round take turns, so that many cuts fall where several tests are open.
        """
        self.reports, self.questions = [], []
        while True:
            at = resume("run-1", study(seed), list(self.trials.values()))
            self.reports = [told.report for told in at.told]
            self.questions = [told.question.omega_rad_s for told in at.told]
            if at.open is None:
                return
            running = [(test, life_of(test)) for test in at.open.tests]
            while running:
                test, life = running.pop(0)
                record = next(life)
                self.store(record)
                after_store(record)
                if not record.status.ended:
                    running.append((test, life))
                elif (following := as_next(test, record)) is not None:
                    running.append((following, life_of(following)))


def facts(trials: dict[str, TrialRecord]) -> dict[str, object]:
    """Everything of trials that can be compared, responses as bytes."""
    return {
        goal_id: (
            replace(trial, response=None),
            None if trial.response is None else trial.response.z.tobytes(),
        )
        for goal_id, trial in trials.items()
    }


def store_in(repository: Repository, record: TrialRecord) -> None:
    """Store a state of a trial as a dispatcher does."""
    goal_id, plan = record.intent.goal_id, record.plan
    if record.status is TrialStatus.INTENDED:
        repository.studies.intend(record.intent)
        return
    assert plan is not None
    samples = np.linspace(0.0, 1.0, plan.samples)
    result = GoalResult(
        goal_id=goal_id,
        boot_id="boot-1",
        outcome=Outcome.COMPLETED,
        reason="",
        plan=plan,
        reference=samples,
        response=samples,
    )
    if record.status is TrialStatus.ACCEPTED:
        accepted = GoalAccepted(goal_id=goal_id, boot_id="boot-1", plan=plan, wall_duration_s=0.0)
        repository.studies.accepted(accepted, epoch=EPOCH)
    else:
        end = TrialEnd(record.status, record.reason, record.retry)
        if record.status is not TrialStatus.LOST:
            end = replace(end, result=result, response=record.response)
        repository.studies.ended(goal_id, end, epoch=EPOCH)


@pytest.fixture(scope="module")
def undisturbed() -> History:
    history = History()
    history.go_on(lambda _: None)
    return history


@pytest.fixture(scope="module")
def cuts(tmp_path_factory: pytest.TempPathFactory) -> list[tuple[TrialRecord, ...]]:
    """What another process reads of the study after each of its stores."""
    path = str(tmp_path_factory.mktemp("runs") / "nufleet.sqlite")
    found: list[tuple[TrialRecord, ...]] = [()]
    with open_repository(path) as repository, open_repository(path) as reader:
        for robot in LOOPS:
            repository.robots.describe(RobotRecord("lab", robot, SPEC, "boot-1"))
        repository.studies.begin(StudyRecord("run-1", "lab", "paper", PLAN, 7))

        def keep(record: TrialRecord) -> None:
            store_in(repository, record)
            found.append(reader.studies.trials("run-1"))

        History().go_on(keep)
    return found


def test_an_undisturbed_study_meets_every_kind_of_trouble(undisturbed: History) -> None:
    ends = {t.status for t in undisturbed.trials.values()}
    assert ends == {TrialStatus.MEASURED, TrialStatus.FAILED, TrialStatus.LOST}
    assert undisturbed.reports[-1].dropped == {"source-3": "clipped"}
    assert undisturbed.reports[-1].iteration == PLAN.iterations
    assert undisturbed.reports[-1].selected == "source-2"


def test_cut_after_any_store_a_study_ends_with_the_same_trials_and_ranking(
    undisturbed: History, cuts: list[tuple[TrialRecord, ...]]
) -> None:
    assert len(cuts) > 50
    for trials in cuts:
        history = History({trial.intent.goal_id: trial for trial in trials})
        history.go_on(lambda _: None)
        assert facts(history.trials) == facts(undisturbed.trials)
        assert history.questions == undisturbed.questions
        assert [r.ranking for r in history.reports] == [r.ranking for r in undisturbed.reports]
        assert history.reports[-1].dropped == undisturbed.reports[-1].dropped


def test_what_was_sent_before_a_cut_is_sent_again_under_its_own_id(
    cuts: list[tuple[TrialRecord, ...]],
) -> None:
    for trials in cuts:
        at = resume("run-1", study(), trials)
        unfinished = {t.intent.goal_id: t for t in trials if not t.status.ended}
        tests = () if at.open is None else at.open.tests
        sent = {test.goal_id: test for test in tests if test.record is not None}
        assert set(sent) == set(unfinished)
        for goal_id, test in sent.items():
            assert test.record is unfinished[goal_id]
            assert test.excitation == unfinished[goal_id].intent.excitation
        new = {test.goal_id for test in tests if test.record is None}
        assert new.isdisjoint(t.intent.goal_id for t in trials)
        assert at.robot_time_s == sum(t.robot_time_s for t in trials)


def test_only_a_goal_that_was_accepted_is_known_to_be_taken(
    cuts: list[tuple[TrialRecord, ...]],
) -> None:
    seen = set()
    for trials in cuts:
        at = resume("run-1", study(), trials)
        for test in () if at.open is None else at.open.tests:
            status = None if test.record is None else test.record.status
            # An accepted goal is asked about but never sent again, whichever agent serves it.
            assert (test.accepted_by == "boot-1") is (status is TrialStatus.ACCEPTED)
            seen.add(status)
    assert seen == {None, TrialStatus.INTENDED, TrialStatus.ACCEPTED}


def changed(
    cuts: list[tuple[TrialRecord, ...]], goal_id: str, **changes: object
) -> list[TrialRecord]:
    """The whole study with one trial changed."""
    return [
        replace(t, **changes) if t.intent.goal_id == goal_id else t  # type: ignore[arg-type]
        for t in cuts[-1]
    ]


def test_another_seed_is_refused_with_what_differs(cuts: list[tuple[TrialRecord, ...]]) -> None:
    with pytest.raises(ResumeError, match=r"run-1\.1\.target\.1.*rad/s.*is stored"):
        resume("run-1", study(seed=8), cuts[-1])


def test_a_changed_response_is_refused_where_the_study_would_ask_something_else(
    cuts: list[tuple[TrialRecord, ...]],
) -> None:
    other = next(t.response for t in cuts[-1] if t.intent.goal_id == "run-1.1.source-2.1")
    assert other is not None
    trials = changed(cuts, "run-1.1.target.1", response=replace(other, z=other.z + 0.5))
    with pytest.raises(ResumeError, match=r"iteration|requests"):
        resume("run-1", study(), trials)


@pytest.mark.parametrize(
    ("goal_id", "changes", "problem"),
    [
        ("run-1.1.target.1", {"response": None}, "its response is not stored"),
        ("run-1.1.source-1.1", {"retry": None}, "tested again after it"),
        ("run-1.1.source-1.1", {"status": TrialStatus.ACCEPTED}, "has not ended"),
    ],
)
def test_attempts_that_cannot_follow_on_each_other_are_refused(
    cuts: list[tuple[TrialRecord, ...]],
    goal_id: str,
    changes: dict[str, object],
    problem: str,
) -> None:
    with pytest.raises(ResumeError, match=problem):
        resume("run-1", study(), changed(cuts, goal_id, **changes))


def test_a_missing_attempt_is_noticed(cuts: list[tuple[TrialRecord, ...]]) -> None:
    trials = [t for t in cuts[-1] if t.intent.goal_id != "run-1.1.source-1.1"]
    with pytest.raises(ResumeError, match=r"run-1\.1\.source-1\.1"):
        resume("run-1", study(), trials)


def test_trials_of_a_robot_that_the_study_did_not_ask_are_refused(
    cuts: list[tuple[TrialRecord, ...]],
) -> None:
    first = cuts[-1][0]
    alien = replace(first, intent=replace(first.intent, robot="alien"))
    with pytest.raises(ResumeError, match="alien in iteration 1"):
        resume("run-1", study(), [*cuts[-1], alien])


def test_a_study_that_could_not_go_on_cannot_go_on_either_when_resumed(
    cuts: list[tuple[TrialRecord, ...]],
) -> None:
    failed = {"status": TrialStatus.FAILED, "reason": "crashed", "retry": None, "response": None}
    with pytest.raises(StudyError, match="target target cannot be tested: crashed"):
        resume("run-1", study(), changed(cuts, "run-1.1.target.1", **failed))


def test_a_study_that_could_not_go_on_asks_again_for_what_failed_if_a_person_wants_it(
    cuts: list[tuple[TrialRecord, ...]],
) -> None:
    lost = {"status": TrialStatus.LOST, "reason": "gone", "retry": None, "response": None}
    trials = [t for t in changed(cuts, "run-1.1.target.1", **lost) if t.intent.iteration == 1]
    resumed = resume("run-1", study(), tried_again(trials))
    assert resumed.open is not None
    (again,) = [test for test in resumed.open.tests if test.robot == "target"]
    assert (again.goal_id, again.failures) == ("run-1.1.target.2", 0)
    told = resumed.open.answers.keys()
    assert all(robot in told or robot == "target" for robot in resumed.open.question.tests)


def test_trials_of_earlier_rounds_and_what_was_measured_are_not_asked_again(
    cuts: list[tuple[TrialRecord, ...]],
) -> None:
    assert tried_again(cuts[-1]) == cuts[-1]
