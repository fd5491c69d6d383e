"""The documents that `nufleet train`, `track` and `demo` print and leave in a run's folder."""

from __future__ import annotations

import json
import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated

from pydantic import Field

from nufleet.orchestrator.evaluation.results import EvaluationResult, FlightRecord
from nufleet.orchestrator.runs.rank_result import RankResult
from nufleet.shared.experience.manifest import ExperienceManifest
from nufleet.shared.strict import Digest, Document, NonNegative, Strict

if TYPE_CHECKING:
    from nufleet.orchestrator.experience.train import Trained

TRAINING = "train.json"
TRACKING = "track.json"
DEMONSTRATION = "demo.json"


class RunDocument(Document):
    """The result of a run, as printed and as stored in its folder."""

    run: str
    """Path of the run's folder."""


class HorizonRecord(Strict):
    """A candidate horizon that was tried in flight."""

    horizon_samples: Annotated[int, Field(ge=1)]
    """Length of the horizon, in samples of the robot."""
    rms_error: NonNegative | None
    """RMS tracking error in the unit of the robot's axes; None when the path was not finished."""


class TrainedExperience(Strict):
    """An experience that its robot now offers to others."""

    robot: str
    """Name of the robot that learned it."""
    sha256: Digest
    """Hash of the experience's file."""
    training_time_s: NonNegative
    """Wall time that training and installing took."""
    horizon_trials: tuple[HorizonRecord, ...]
    """Candidate horizons, shortest first."""
    manifest: ExperienceManifest
    """Description of the experience, as stored in its file."""


class TrainResult(RunDocument):
    """What `nufleet train` prints and leaves in its run's folder."""

    experiences: tuple[TrainedExperience, ...]
    """Experiences that were trained, in the order of robots and architectures."""

    @staticmethod
    def of(trained: Iterable[Trained], run: str) -> TrainResult:
        """Return the document for trained experiences and the path of their run's folder."""
        return TrainResult(experiences=tuple(map(_trained, trained)), run=run)


class TrackResult(RunDocument):
    """What `nufleet track` prints and leaves in its run's folder."""

    flights: tuple[FlightRecord, ...]
    """Flights in the order in which they were flown."""


class DemoResult(RunDocument):
    """What `nufleet demo --json` prints: the ranking, and the flights in every way."""

    ranking: RankResult
    """Ranking of all sources by frequency tests, as `nufleet rank --json` prints it."""
    flights: EvaluationResult
    """Tracking errors with the closest and the furthest source, as `nufleet evaluate --json`."""
    flown: tuple[FlightRecord, ...] = ()
    """All flights that these errors come from, in the order in which they were flown."""
    unguarded: FlightRecord | None = None
    """Flight with the furthest source's experience and without the guard, if the guard took that
    experience back."""

    def document(self) -> str:
        """Return this result as JSON, made up of the documents of `rank` and `evaluate`."""
        unguarded = self.unguarded
        parts = {
            "ranking": json.loads(self.ranking.document()),
            "flights": json.loads(self.flights.document()),
            "flown": [json.loads(flight.model_dump_json()) for flight in self.flown],
            "unguarded": None if unguarded is None else json.loads(unguarded.model_dump_json()),
        }
        return json.dumps({"schema": self.schema_version, **parts, "run": self.run})


def _trained(one: Trained) -> TrainedExperience:
    return TrainedExperience(
        robot=one.lesson.robot,
        sha256=one.sha256,
        training_time_s=one.training_time_s,
        horizon_trials=tuple(
            HorizonRecord(
                horizon_samples=trial.horizon_samples,
                rms_error=trial.rms_error if math.isfinite(trial.rms_error) else None,
            )
            for trial in one.lesson.choice.trials
        ),
        manifest=one.experience.manifest,
    )
