"""The studies of an evaluation: repetitions of Algorithm 1 (Fig. 4), and one ranking."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.conductor import Conclusion, conduct
from nufleet.orchestrator.conduct.dispatcher import Dispatcher
from nufleet.orchestrator.conduct.rank_run import ReadyStudy
from nufleet.orchestrator.conduct.recipe import make_study
from nufleet.orchestrator.evaluation.comparison import Psi
from nufleet.orchestrator.evaluation.results import StudyEstimates
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.repository.errors import UnknownRecordError
from nufleet.orchestrator.repository.records import StudyRecord, StudyStatus
from nufleet.orchestrator.study.interface import Question, Report
from nufleet.orchestrator.study.outcomes import TestOutcome
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

_RANK = "rank"


@dataclass(frozen=True)
class RepeatedStudies:
    """The estimates of each study, and all responses that the studies measured."""

    estimates: tuple[StudyEstimates, ...]
    """Estimates of each study, in the order of the seeds."""
    responses: Mapping[str, Sequence[FrequencyResponse]]
    """Frequency responses that any of the studies measured, by robot."""


def repeat_study(
    fleet: Fleet,
    ready: ReadyStudy,
    seeds: Sequence[int],
    run_id: str,
    archive: Archive,
    *,
    on_study: Callable[[StudyEstimates], None] = lambda estimates: None,
) -> RepeatedStudies:
    """Rank the sources once for every seed.

    Each study is stored under the id `{run_id}.{target}.s{seed}`. One that is stored already is
    replayed as far as it came, and continues from there.

    Args:
        fleet: Client of the fleet, already connected.
        ready: Study to repeat, prepared and checked.
        seeds: Seeds of the studies, one study for each.
        run_id: Prefix of the studies' ids.
        archive: Repository that stores the studies, with the leases on the robots.
        on_study: Callback that receives the estimates of each study as soon as it is complete.

    Returns:
        Estimates of all studies, and all responses that they measured.

    Raises:
        StudyError: A study cannot continue, because the target or every source is gone.
    """
    studies = []
    responses: dict[str, list[FrequencyResponse]] = {}
    for seed in seeds:
        recorder = _Recorder()
        conclusion = _conducted(fleet, ready, seed, f"s{seed}", "paper", run_id, archive, recorder)
        for robot, measured in conclusion.responses.items():
            responses.setdefault(robot, []).extend(measured)
        beliefs = recorder.beliefs
        estimates = StudyEstimates(
            seed=seed,
            iterations=len(beliefs),
            second=beliefs[min(1, len(beliefs) - 1)],
            last=beliefs[-1],
        )
        studies.append(estimates)
        on_study(estimates)
    return RepeatedStudies(tuple(studies), responses)


def rank_once(
    fleet: Fleet, ready: ReadyStudy, seed: int, run_id: str, archive: Archive
) -> Conclusion:
    """Rank the sources as `nufleet rank` does, with the adaptive algorithm.

    The study is stored under the id `{run_id}.{target}.rank`, and replayed like those of
    `repeat_study`.

    Args:
        fleet: Client of the fleet, already connected.
        ready: Study to conduct, prepared and checked.
        seed: Seed of the study.
        run_id: Prefix of the study's id.
        archive: Repository that stores the study, with the leases on the robots.

    Raises:
        StudyError: The study cannot continue, because the target or every source is gone.
    """
    return _conducted(fleet, ready, seed, _RANK, "adaptive", run_id, archive, _Recorder())


def has_begun(target: str, run_id: str, archive: Archive) -> bool:
    """Return whether `rank_once` has begun for a target of a run."""
    return _stored(_study_id(run_id, target, _RANK), archive) is not None


def _study_id(run_id: str, target: str, suffix: str) -> str:
    return f"{run_id}.{target}.{suffix}"


def _stored(study_id: str, archive: Archive) -> StudyRecord | None:
    try:
        return archive.repository.studies.study(study_id)
    except UnknownRecordError:
        return None


def _conducted(
    fleet: Fleet,
    ready: ReadyStudy,
    seed: int,
    suffix: str,
    algorithm: str,
    run_id: str,
    archive: Archive,
    recorder: _Recorder,
) -> Conclusion:
    specs = {robot: description.spec for robot, description in ready.descriptions.items()}
    study_id = _study_id(run_id, ready.plan.target, suffix)
    begun = _stored(study_id, archive)
    if begun is None:
        begun = archive.begin(study_id, algorithm, ready.plan, seed, ready.descriptions)
    if begun.status is StudyStatus.FAILED:
        begun = archive.try_again(begun)
    if begun.status is StudyStatus.FAILED:
        raise StudyError(f"{begun.reason}; evaluate again")
    log = archive.log(begun.study_id)
    dispatcher = Dispatcher(fleet, log, specs, on_attempt_failed=recorder.attempt_failed)
    kept = archive.repository.studies
    with archive.conducting(begun.study_id, dispatcher.interrupt):
        conclusion = conduct(make_study(begun, kept), log, dispatcher, recorder)
    if begun.status is StudyStatus.OPEN:
        kept.end(begun.study_id, StudyStatus.COMPLETE, f"selected {conclusion.report.selected}")
    return conclusion


def psi_of(studies: Sequence[StudyEstimates]) -> dict[str, Psi]:
    """Return each source's mean and standard deviation over the studies' last iterations.

    Args:
        studies: Estimates of repeated studies of one target, at least one.

    Returns:
        Mean and standard deviation of ψ̂*_n by source. A source that any study lost is left out.
    """
    last = [study.last for study in studies]
    sources = [source for source in last[0] if all(source in study for study in last)]
    return {
        source: Psi(
            mean=float(np.mean([study[source] for study in last])),
            std=float(np.std([study[source] for study in last])),
        )
        for source in sources
    }


class _Recorder:
    """An observer that keeps the estimates after each round of one study."""

    def __init__(self) -> None:
        self.beliefs: list[dict[str, float]] = []

    def asked(self, question: Question) -> None:
        """Ignore a question: it has no estimates yet."""

    def attempt_failed(self, robot: str, attempt: int, reason: str) -> None:
        """Ignore a failed attempt: a robot that failed for good is named in the next report."""

    def told(self, question: Question, outcomes: Mapping[str, TestOutcome], report: Report) -> None:
        """Keep the estimates of the round."""
        self.beliefs.append({estimate.robot: estimate.psi for estimate in report.ranking})
