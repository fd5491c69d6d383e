"""One run of every kind, as it lies in its folder."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from evaluated_flights import ERRORS, A, B, record, records, summed
from learned_things import experience
from run_records import NOON, a_record

from nufleet.orchestrator.evaluation.flight_documents import (
    DEMONSTRATION,
    TRACKING,
    TRAINING,
    DemoResult,
    HorizonRecord,
    TrackResult,
    TrainedExperience,
    TrainResult,
)
from nufleet.orchestrator.evaluation.pairs import PAIRS, compare_pairs
from nufleet.orchestrator.evaluation.results import EVALUATION, EvaluationRecord, StudyEstimates
from nufleet.orchestrator.runs.folder import RESULTS, RunFolder
from nufleet.shared.experience.file import decode_experience, digest
from nufleet.shared.strict import Strict


def ranking(run: Path) -> Strict:
    return a_record(run)


def demonstration(run: Path) -> Strict:
    flights = summed(records(ERRORS))
    return DemoResult(ranking=a_record(run).result, flights=flights, run=str(run))


def evaluation(run: Path) -> Strict:
    flights = records(ERRORS)
    estimates = StudyEstimates(seed=0, iterations=2, second={"near": 0.1}, last={"near": 0.1})
    return EvaluationRecord(
        result=summed(flights), studies=(estimates,), flights=tuple(flights), wall_time_s=3.0
    )


def pairs(run: Path) -> Strict:
    return compare_pairs([A, B], str(run))


def tracking(run: Path) -> Strict:
    return TrackResult(flights=(record("near", "clover", 0.05),), run=str(run))


def training(run: Path) -> Strict:
    payload = experience()
    trained = TrainedExperience(
        robot="source-1",
        sha256=digest(payload),
        training_time_s=4.2,
        horizon_trials=(HorizonRecord(horizon_samples=20, rms_error=None),),
        manifest=decode_experience(payload).manifest,
    )
    return TrainResult(experiences=(trained,), run=str(run))


ENDED: dict[str, tuple[Callable[[Path], Strict], str, str, str]] = {
    "rank": (ranking, RESULTS, "source-1 for target, ψ* 0.0700 (0.0680 to 0.0730)", "closed form"),
    "demo": (demonstration, DEMONSTRATION, "80 % less error", "effect of the transfer"),
    "evaluate": (evaluation, EVALUATION, "near for target; 80 % less error", "clover"),
    "pairs": (pairs, PAIRS, "best source selected for 1 of 2 targets", "pairs"),
    "track": (tracking, TRACKING, "target with near on 1 path: RMS error 50.0 mm", "clover"),
    "train": (training, TRAINING, "source-1 offers experience", "relative degree"),
}


def leave(root: Path, kind: str, *, ended: bool = True) -> Path:
    """Leave a run's folder, with what a run of that kind ends with, or without."""
    document, name, *_ = ENDED[kind]
    suffix = "" if kind == "rank" else f"-{kind}"
    with RunFolder(root, f"lab{suffix}", now=NOON) as folder:
        folder.write_configuration({"kind": kind, "fleet": "lab"})
        if ended:
            folder.write_document(name, document(folder.path))
    return folder.path
