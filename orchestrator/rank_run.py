"""One `nufleet rank` from the request to the stored result, on a fleet that is already reached."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np

from orchestrator.adaptive_selection import AdaptiveStudy
from orchestrator.desired_motion import Drawing, desired_motion
from orchestrator.dispatcher import Dispatcher, Measured, TestOutcome
from orchestrator.experience_selection import PaperStudy
from orchestrator.fleet import Fleet
from orchestrator.preflight import check_band, check_names, check_plan, chosen_axis
from orchestrator.ranking import Conclusion, RankingObserver, conduct
from orchestrator.report import write_plots, write_report
from orchestrator.response_record import ResponseRecord
from orchestrator.results import (
    ClosedForm,
    IterationRecord,
    RankResult,
    RunRecord,
)
from orchestrator.run_folder import RunFolder
from orchestrator.study import Curve, Question, Report, Study, StudyPlan
from orchestrator.transfer_verdicts import Judgement, by_predicted_error, judge_transfers
from shared.arrays import FloatArray
from shared.chordal import chordal_distance, worst_case_chordal_distance
from shared.messages import Description

Algorithm = Literal["paper", "adaptive"]


@dataclass(frozen=True)
class RankRequest:
    """What to rank; None leaves the choice to what the fleet says of itself."""

    target: str
    sources: tuple[str, ...] | None
    band_rad_s: tuple[float, float] | None
    iterations: int
    seed: int
    axis: str | None
    drawing: Drawing | None = None


@dataclass(frozen=True)
class ReadyStudy:
    """A study that passed every check, and the robots' own descriptions."""

    plan: StudyPlan
    descriptions: Mapping[str, Description]
    closed_form: Mapping[str, ClosedForm]


def prepare(fleet: Fleet, request: RankRequest, there: tuple[str, ...]) -> ReadyStudy:
    """Check a request against the fleet before anything moves.

    Args:
        fleet: the fleet, reached.
        request: what to rank.
        there: the robots that are there.

    Raises:
        InvalidInputError: what is asked cannot be done with these robots.
        NoReplyError: a robot does not answer.
    """
    if request.band_rad_s is not None:
        check_band(request.band_rad_s)
    sources = request.sources
    if sources is None:
        sources = tuple(robot for robot in there if robot != request.target)
    check_names(request.target, sources, there)
    robots = (request.target, *sources)
    with ThreadPoolExecutor(min(32, len(robots)), thread_name_prefix="describe") as pool:
        descriptions = dict(zip(robots, pool.map(fleet.describe, robots), strict=True))
    axis = chosen_axis(request.axis, descriptions[request.target])
    at_target = descriptions[request.target].spec
    plan = StudyPlan(
        target=request.target,
        sources=sources,
        band_rad_s=request.band_rad_s or _common_band(descriptions.values()),
        iterations=request.iterations,
        axis=axis,
        motion=None
        if request.drawing is None
        else desired_motion(request.drawing, at_target, axis),
    )
    check_plan(plan, descriptions)
    return ReadyStudy(plan, descriptions, _closed_form(plan, descriptions))


def new_study(algorithm: Algorithm, ready: ReadyStudy, rng: np.random.Generator) -> Study:
    """Return a study that begins: the paper's Algorithm 1, or the adaptive one."""
    if algorithm == "paper":
        return PaperStudy(ready.plan, rng)
    specs = {robot: description.spec for robot, description in ready.descriptions.items()}
    return AdaptiveStudy(ready.plan, specs, rng)


def run_study(
    fleet: Fleet,
    ready: ReadyStudy,
    *,
    seed: int,
    algorithm: Algorithm,
    folder: RunFolder,
    observers: Sequence[RankingObserver],
) -> RunRecord:
    """Run a prepared study, with everything it learns kept in the folder."""
    began_s = time.monotonic()
    recorder = _Recorder(folder)
    everyone = _Together([recorder, *observers])
    dispatcher = Dispatcher(fleet, on_attempt_failed=everyone.attempt_failed)
    folder.write_configuration({**_configuration(ready, seed), "algorithm": algorithm})
    study = new_study(algorithm, ready, np.random.default_rng(seed))
    conclusion = conduct(study, folder.path.name.lower(), dispatcher, everyone)
    specs = {robot: description.spec for robot, description in ready.descriptions.items()}
    judgement = judge_transfers(
        ready.plan, conclusion.ranking, specs, conclusion.responses, np.random.default_rng(seed)
    )
    record = RunRecord(
        result=_result(ready.plan, conclusion, judgement, folder),
        axis=ready.plan.axis,
        seed=seed,
        history=tuple(recorder.history),
        dropped=dict(conclusion.dropped),
        closed_form=dict(ready.closed_form),
        wall_time_s=time.monotonic() - began_s,
        responses={
            robot: tuple(map(ResponseRecord.of, tests))
            for robot, tests in conclusion.responses.items()
        },
    )
    folder.write_record(record)
    write_plots(folder.path, record, recorder.curves, _true_psi(ready, recorder.curves))
    write_report(folder.path, record)
    return record


def _common_band(descriptions: Any) -> tuple[float, float]:
    specs = [description.spec for description in descriptions]
    return max(s.omega_min_rad_s for s in specs), min(s.omega_max_rad_s for s in specs)


def _closed_form(plan: StudyPlan, descriptions: Mapping[str, Description]) -> dict[str, ClosedForm]:
    """Return the true distances of the sources whose model, like the target's, is known."""
    at_target = descriptions[plan.target].spec.axis(plan.axis).model
    known: dict[str, ClosedForm] = {}
    for source in plan.sources:
        model = descriptions[source].spec.axis(plan.axis).model
        if at_target is not None and model is not None:
            psi, omega = worst_case_chordal_distance(at_target, model, plan.band_rad_s)
            known[source] = ClosedForm(psi=psi, omega_rad_s=omega)
    return known


def _true_psi(ready: ReadyStudy, curves: tuple[Curve, ...]) -> dict[str, FloatArray]:
    """Return ψ_n(ω) on each curve's grid, for the sources whose closed form is known."""
    axis = ready.plan.axis
    at_target = ready.descriptions[ready.plan.target].spec.axis(axis).model
    true_psi: dict[str, FloatArray] = {}
    for curve in curves:
        model = ready.descriptions[curve.source].spec.axis(axis).model
        if at_target is not None and model is not None:
            omega = curve.omega_rad_s
            true_psi[curve.source] = chordal_distance(
                at_target.frequency_response(omega), model.frequency_response(omega)
            )
    return true_psi


def _configuration(ready: ReadyStudy, seed: int) -> dict[str, Any]:
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
    ranking = conclusion.ranking
    if plan.motion is not None and conclusion.confidence is None:
        # The paper's algorithm knows of no trajectory.
        ranking = by_predicted_error(ranking, judgement.verdicts)
    return RankResult(
        target=plan.target,
        band_rad_s=plan.band_rad_s,
        selected=ranking[0].robot,
        ranking=ranking,
        iterations=conclusion.iterations,
        robot_time_s=conclusion.robot_time_s,
        run=str(folder.path),
        confidence=conclusion.confidence,
        eliminated=dict(conclusion.eliminated) if conclusion.confidence is not None else None,
        stopped_because=conclusion.stopped_because,
        trajectory=None if plan.motion is None else plan.motion.name,
        verdicts=dict(judgement.verdicts),
        findings=tuple(dict.fromkeys([*conclusion.findings, *judgement.findings])),
    )


class _Recorder:
    """Keeps what each round gave in the run's folder and for its record."""

    def __init__(self, folder: RunFolder) -> None:
        self._folder = folder
        self.history: list[IterationRecord] = []
        self.curves: tuple[Curve, ...] = ()

    def asked(self, question: Question) -> None:
        """Nothing is known yet."""

    def attempt_failed(self, robot: str, attempt: int, reason: str) -> None:
        """What failed for good is in the report that follows."""

    def told(self, question: Question, outcomes: Mapping[str, TestOutcome], report: Report) -> None:
        """Store samples and beliefs."""
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
    """Several observers as one."""

    def __init__(self, observers: Sequence[RankingObserver]) -> None:
        self._observers = observers

    def asked(self, question: Question) -> None:
        """Tell all."""
        for observer in self._observers:
            observer.asked(question)

    def attempt_failed(self, robot: str, attempt: int, reason: str) -> None:
        """Tell all."""
        for observer in self._observers:
            observer.attempt_failed(robot, attempt, reason)

    def told(self, question: Question, outcomes: Mapping[str, TestOutcome], report: Report) -> None:
        """Tell all."""
        for observer in self._observers:
            observer.told(question, outcomes, report)
