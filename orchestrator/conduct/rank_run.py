"""Runs one `nufleet rank` on a fleet that is already reached, from request to stored result."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Collection, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from functools import partial
from operator import call
from typing import Any

import numpy as np

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.conductor import Conclusion, RankingObserver, conduct
from nufleet.orchestrator.conduct.desired_motion import (
    TimedPath,
    amplitude_of,
    axes_along,
    desired_motion,
    leg_of,
)
from nufleet.orchestrator.conduct.dispatcher import Dispatcher
from nufleet.orchestrator.conduct.preflight import (
    ALL_AXES,
    axes_left_out,
    check_names,
    check_plan,
    check_robots,
    chosen_axes,
)
from nufleet.orchestrator.conduct.recipe import AWAY, make_study, recipe_of
from nufleet.orchestrator.conduct.reuse import stored_responses
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.repository.records import StudyRecord, StudyStatus
from nufleet.orchestrator.runs.folder import RunFolder
from nufleet.orchestrator.runs.rank_result import ClosedForm, IterationRecord, RankResult, RunRecord
from nufleet.orchestrator.runs.report import write_plots, write_report
from nufleet.orchestrator.runs.response_record import ResponseRecord
from nufleet.orchestrator.study.interface import Curve, Question, Report, StudyPlan
from nufleet.orchestrator.study.outcomes import Measured, TestOutcome
from nufleet.orchestrator.study.transfer_verdicts import (
    Judgement,
    by_predicted_error,
    judge_transfers,
)
from nufleet.shared.arrays import FloatArray
from nufleet.shared.distance.chordal import chordal_distance, worst_case_chordal_distance
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Description


@dataclass(frozen=True)
class RankRequest:
    """A ranking as it was requested; None leaves the choice to the robots' own descriptions."""

    target: str
    """Name of the robot that is to receive an experience."""
    sources: tuple[str, ...] | None
    """Names of the candidate sources; None takes every other robot of the fleet."""
    band_rad_s: tuple[float, float] | None
    """Lowest and highest frequency in rad/s; None takes the band common to all robots."""
    iterations: int
    """Maximum number of rounds of tests."""
    seed: int
    """Seed of the study's random generator."""
    axes: tuple[str, ...] | None
    """Names of the axes to test, `all` for all that can be compared; None takes the first axis of
    the target."""
    drawing: TimedPath | None = None
    """Trajectory to rank for; None ranks by distance over the whole band."""
    precision: float | None = None
    """Width of the selected source's 95 % interval at which the study may end; None for no
    limit."""
    amplitude: float | None = None
    """Amplitude of the task in the unit of the axis; None for what each robot chooses."""

    def sources_among(self, there: tuple[str, ...]) -> tuple[str, ...]:
        """Return the sources that were requested, or all these robots but the target."""
        if self.sources is not None:
            return self.sources
        return tuple(robot for robot in there if robot != self.target)


@dataclass(frozen=True)
class ReadyStudy:
    """A study that passed every check, ready to begin or to continue."""

    plan: StudyPlan
    """The study's plan, with every choice made."""
    descriptions: Mapping[str, Description]
    """Descriptions of the target and of every source, by robot."""
    closed_form: Mapping[str, ClosedForm]
    """True worst-case distances, for the sources whose model and the target's are both known."""


def prepare(
    fleet: Fleet,
    request: RankRequest,
    there: tuple[str, ...],
    known: Mapping[str, RobotSpec] | None = None,
) -> ReadyStudy:
    """Check a request against the fleet before anything moves.

    Args:
        fleet: Client of the fleet, already connected.
        request: The ranking that was requested.
        there: Names of the robots that are alive now.
        known: Last known specs, by robot, of sources that may take part without being alive,
            because stored responses can stand for tests of them.

    Returns:
        The checked plan, with the descriptions of all its robots.

    Raises:
        InvalidInputError: These robots cannot do what is requested.
        NoReplyError: A robot does not answer.
    """
    sources = request.sources_among(there)
    away = {robot: spec for robot, spec in (known or {}).items() if robot not in there}
    check_names(request.target, sources, (*there, *away))
    check_robots((request.target,), there)
    descriptions = fleet.describe_all(
        tuple(robot for robot in (request.target, *sources) if robot not in away)
    )
    for robot, spec in away.items():
        if robot in sources:
            descriptions[robot] = Description(robot=robot, boot_id=AWAY, spec=spec)
    at_target = descriptions[request.target].spec
    axes = chosen_axes(request.axes, descriptions[request.target], descriptions.values())
    motion = None
    if request.drawing is not None:
        if request.axes == (ALL_AXES,):
            axes = axes_along(request.drawing, at_target, axes)
        motion = desired_motion(request.drawing, at_target, axes)
    amplitude = request.amplitude
    if amplitude is None and motion is not None:
        amplitude = amplitude_of(motion)
    plan = StudyPlan(
        target=request.target,
        sources=sources,
        band_rad_s=request.band_rad_s or _common_band(descriptions.values()),
        iterations=request.iterations,
        axis=axes[0],
        motion=motion,
        precision=request.precision,
        amplitude=amplitude,
        also=axes[1:],
    )
    check_plan(plan, descriptions)
    if request.drawing is not None and at_target.tracking is not None:
        # A ranking for a path that `nufleet track` would refuse is of no use.
        leg_of(request.drawing, descriptions[request.target])
    return ReadyStudy(plan, descriptions, _closed_form(plan, descriptions))


def prepare_again(fleet: Fleet, study: StudyRecord, gone: Collection[str]) -> ReadyStudy:
    """Check that a study can resume: its robots answer, and their specs have not changed.

    Args:
        fleet: Client of the fleet, already connected.
        study: The stored study.
        gone: Names of the robots that the study no longer tests.

    Returns:
        The stored plan, with the descriptions of all its robots.

    Raises:
        InvalidInputError: A robot's spec has changed since the study began.
        NoReplyError: A robot does not answer.
    """
    specs = recipe_of(study).specs
    needed = tuple(robot for robot in specs if robot not in gone)
    descriptions = fleet.describe_all(needed)
    for robot in needed:
        if descriptions[robot].spec != specs[robot]:
            raise InvalidInputError(
                f"robot {robot} has changed since study {study.study_id} began; start a new study"
            )
    for robot in gone:
        descriptions[robot] = Description(robot=robot, boot_id="gone", spec=specs[robot])
    return ReadyStudy(study.plan, descriptions, _closed_form(study.plan, descriptions))


def run_study(
    fleet: Fleet,
    ready: ReadyStudy,
    study: StudyRecord,
    archive: Archive,
    *,
    folder: RunFolder,
    observers: Sequence[RankingObserver],
    draws: bool = True,
    foresee: Callable[[RankResult], RankResult] = lambda result: result,
    draw: Callable[[Callable[[], None]], object] = call,
) -> RunRecord:
    """Run a stored study from its current state to its end, and keep its results in the folder.

    Args:
        fleet: Client of the fleet, already connected.
        ready: The study's plan and robots, as checked by `prepare` or `prepare_again`.
        study: The stored study; its trials decide where it continues.
        archive: Repository and leases under which the robots are commanded.
        folder: Run folder that receives samples, results, plots and the report.
        observers: Objects that are notified of every round, replayed rounds included.
        draws: Whether plots are drawn.
        foresee: Function that adds to the result, before it is stored, what the target expects of
            each way to fly.
        draw: Function that has the plots drawn, by what it is given, now or later.

    Returns:
        The record that was also written to the folder.

    Raises:
        StudyError: The study cannot continue, because the target or every source is gone.
        ResumeError: The stored trials do not belong to this study.
        LeaseLostError: Another orchestrator has taken over a robot; all robots are at rest.
        RepositoryError: Something could not be stored; all robots are at rest.
    """
    began_s = time.monotonic()
    recorder = _Recorder(folder)
    everyone = _Together([recorder, *observers])
    log = archive.log(study.study_id)
    specs = {robot: description.spec for robot, description in ready.descriptions.items()}
    dispatcher = Dispatcher(fleet, log, specs, on_attempt_failed=everyone.attempt_failed)
    seed, studies = study.seed, archive.repository.studies
    with archive.conducting(study.study_id, dispatcher.interrupt):
        conclusion = conduct(make_study(study, studies), log, dispatcher, everyone)
    report = conclusion.report
    judgement = judge_transfers(
        ready.plan, report.ranking, specs, conclusion.responses, np.random.default_rng(seed)
    )
    left_out = axes_left_out(ready.plan, ready.descriptions)
    result = _result(ready.plan, conclusion, judgement, folder)
    result = result.model_copy(
        update={
            "stored": stored_responses(studies, recipe_of(study).stored) or None,
            "findings": (*left_out, *result.findings),
        }
    )
    record = RunRecord(
        result=result,
        axis=" ".join(ready.plan.axes),
        seed=seed,
        history=tuple(recorder.history),
        dropped=dict(report.dropped),
        closed_form=dict(ready.closed_form),
        wall_time_s=time.monotonic() - began_s,
        responses={
            robot: tuple(
                ResponseRecord.of(own)
                for test in tests
                for own in (test.own_entries.values() or (test,))
            )
            for robot, tests in conclusion.responses.items()
        },
    )
    # The ranking is safe before the target is asked what follows from it.
    folder.write_record(record)
    record = record.model_copy(update={"result": foresee(result)})
    folder.write_record(record)
    if draws:
        curves = recorder.curves
        draw(lambda: write_plots(folder.path, record, curves, _true_psi(ready, curves)))
    write_report(folder.path, record, draws=draws)
    why = report.stopped_because or f"selected {record.result.selected}"
    studies.end(study.study_id, StudyStatus.COMPLETE, why, json.loads(record.result.document()))
    return record


def _common_band(descriptions: Any) -> tuple[float, float]:
    specs = [description.spec for description in descriptions]
    return max(s.omega_min_rad_s for s in specs), min(s.omega_max_rad_s for s in specs)


def _closed_form(plan: StudyPlan, descriptions: Mapping[str, Description]) -> dict[str, ClosedForm]:
    """Return max ψ_n(ω) over the band for the sources whose model, like the target's, is known."""
    at_target = descriptions[plan.target].spec.axis(plan.axis).model
    # Robots state no model of what their axes do to each other.
    if at_target is None or plan.also:
        return {}
    stated = {one: descriptions[one].spec.axis(plan.axis).model for one in plan.sources}
    models = {source: model for source, model in stated.items() if model is not None}
    farthest = partial(worst_case_chordal_distance, at_target, omega_band_rad_s=plan.band_rad_s)
    # Most of this is linear algebra of NumPy, which leaves the interpreter to other threads.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        found = zip(models, pool.map(farthest, models.values()), strict=True)
        return {source: ClosedForm(psi=psi, omega_rad_s=omega) for source, (psi, omega) in found}


def _true_psi(ready: ReadyStudy, curves: tuple[Curve, ...]) -> dict[str, FloatArray]:
    """Return the true ψ_n(ω) by source, for known models; each has its curve's shape (grid,)."""
    axis = ready.plan.axis
    at_target = ready.descriptions[ready.plan.target].spec.axis(axis).model
    true_psi: dict[str, FloatArray] = {}
    for curve in curves:
        model = ready.descriptions[curve.source].spec.axis(axis).model
        if at_target is not None and model is not None and not ready.plan.also:
            omega = curve.omega_rad_s
            true_psi[curve.source] = chordal_distance(
                at_target.frequency_response(omega), model.frequency_response(omega)
            )
    return true_psi


def configuration(ready: ReadyStudy, seed: int) -> dict[str, Any]:
    """Return the complete configuration of a study, as it is written to the run folder."""
    return {
        "kind": "rank",
        "plan": asdict(ready.plan),
        "seed": seed,
        "robots": {
            robot: description.model_dump(mode="json")
            for robot, description in ready.descriptions.items()
        },
    }


def _result(
    plan: StudyPlan, conclusion: Conclusion, judgement: Judgement, folder: RunFolder
) -> RankResult:
    report = conclusion.report
    ranking = report.ranking
    if plan.motion is not None:
        # The paper's algorithm ignores the trajectory, so its selection does not lead the ranking
        # here. The adaptive algorithm, the one with a confidence, has already selected for it.
        selected = None if report.confidence is None else report.selected
        ranking = by_predicted_error(ranking, judgement.verdicts, first=selected)
    return RankResult(
        target=plan.target,
        band_rad_s=plan.band_rad_s,
        selected=ranking[0].robot,
        ranking=ranking,
        iterations=report.iteration,
        robot_time_s=conclusion.robot_time_s,
        run=str(folder.path),
        confidence=report.confidence,
        eliminated=dict(report.eliminated) if report.confidence is not None else None,
        stopped_because=report.stopped_because,
        trajectory=None if plan.motion is None else plan.motion.name,
        verdicts=dict(judgement.verdicts),
        findings=tuple(dict.fromkeys([*report.findings, *judgement.findings])),
    )


class _Recorder:
    """Writes each round's samples to the run folder and collects the history for its record."""

    def __init__(self, folder: RunFolder) -> None:
        self._folder = folder
        self.history: list[IterationRecord] = []
        self.curves: tuple[Curve, ...] = ()

    def asked(self, question: Question) -> None:
        """Do nothing: a round that only begins has no results yet."""

    def attempt_failed(self, robot: str, attempt: int, reason: str) -> None:
        """Do nothing: the report at the end of the round holds every final failure."""

    def told(self, question: Question, outcomes: Mapping[str, TestOutcome], report: Report) -> None:
        """Write the samples, and keep the curves and estimates of the round."""
        for outcome in outcomes.values():
            if isinstance(outcome, Measured):
                self._folder.write_samples(question.iteration, outcome)
        self.curves = report.curves
        self.history.append(
            IterationRecord(
                iteration=question.iteration,
                omega_rad_s=question.omega_rad_s,
                sampled_psi=dict(report.sampled_psi),
                ranking=report.ranking,
            )
        )


class _Together:
    """Forwards every notification to several observers, in order."""

    def __init__(self, observers: Sequence[RankingObserver]) -> None:
        self._observers = observers

    def asked(self, question: Question) -> None:
        """Forward the beginning of a round."""
        for observer in self._observers:
            observer.asked(question)

    def attempt_failed(self, robot: str, attempt: int, reason: str) -> None:
        """Forward a failed attempt."""
        for observer in self._observers:
            observer.attempt_failed(robot, attempt, reason)

    def told(self, question: Question, outcomes: Mapping[str, TestOutcome], report: Report) -> None:
        """Forward the end of a round."""
        for observer in self._observers:
            observer.told(question, outcomes, report)
