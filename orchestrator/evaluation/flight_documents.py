"""The documents that trainings and trackings leave behind and print."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from nufleet.orchestrator.evaluation.results import FlightRecord
from nufleet.shared.experience.manifest import ExperienceManifest
from nufleet.shared.strict import Digest, NonNegative, Strict

if TYPE_CHECKING:
    from nufleet.orchestrator.experience.train import Trained

TRAINING = "train.json"
TRACKING = "track.json"


class Document(Strict):
    """What a run came to; `run` is its folder."""

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    run: str

    def document(self) -> str:
        """Return the JSON that other programs read."""
        return self.model_dump_json(by_alias=True)


class HorizonRecord(Strict):
    """A horizon that was tried in flight; no error where it was not flown to the end."""

    horizon_samples: Annotated[int, Field(ge=1)]
    rms_error: NonNegative | None


class TrainedExperience(Strict):
    """An experience that its robot offers now."""

    robot: str
    sha256: Digest
    training_time_s: NonNegative
    horizon_trials: tuple[HorizonRecord, ...]
    manifest: ExperienceManifest


class TrainResult(Document):
    """What `nufleet train --json` prints."""

    experiences: tuple[TrainedExperience, ...]

    @staticmethod
    def of(trained: Iterable[Trained], run: str) -> TrainResult:
        """Return the document of what was trained."""
        return TrainResult(experiences=tuple(map(_trained, trained)), run=run)


class TrackResult(Document):
    """What `nufleet track --json` prints."""

    flights: tuple[FlightRecord, ...]


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
