"""The documents that a run leaves behind and that other programs read."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from nufleet.orchestrator.runs.response_record import ResponseRecord
from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.orchestrator.study.verdict_document import TransferVerdict
from nufleet.shared.strict import NonNegative, Strict

Count = Annotated[int, Field(ge=0)]


class StoredResponses(Strict):
    """The tests of earlier studies that stood for tests of a source; ISO 8601 times, in UTC."""

    tests: Count
    measured_from: str
    measured_to: str
    studies: tuple[str, ...]


class RankResult(Strict):
    """What `nufleet rank --json` prints: the ranking, best first, and what it cost.

    With a `trajectory` the best source is the one expected to leave the smallest error on it,
    otherwise the closest. `verdicts` say by source whether transfer will help, `findings` what the
    tests revealed that weakens what is said here. The sources in `stored` did not fly: responses
    of earlier studies stood for them. `confidence`, `eliminated` and `stopped_because`
    are those of an algorithm that knows how sure it is.
    """

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    target: str
    band_rad_s: tuple[float, float]
    selected: str
    ranking: tuple[SourceEstimate, ...]
    iterations: Count
    robot_time_s: NonNegative
    run: str
    confidence: float | None = None
    eliminated: dict[str, str] | None = None
    stopped_because: str | None = None
    trajectory: str | None = None
    verdicts: Annotated[dict[str, TransferVerdict], Field(default_factory=dict)]
    findings: tuple[str, ...] = ()
    stored: dict[str, StoredResponses] | None = None

    def document(self) -> str:
        """Return the JSON that other programs read: what the algorithm does not say is left out."""
        return self.model_dump_json(by_alias=True, exclude_none=True)


class IterationRecord(Strict):
    """One iteration: what was asked, what each source's sample was, what was believed after it."""

    iteration: Count
    omega_rad_s: tuple[float, ...]
    sampled_psi: dict[str, float]
    ranking: tuple[SourceEstimate, ...]


class ClosedForm(Strict):
    """A source's true worst-case chordal distance, where both robots' models are known."""

    psi: float
    omega_rad_s: float


class RunRecord(Strict):
    """`results.json` in a run's folder."""

    result: RankResult
    axis: str
    seed: Count
    history: tuple[IterationRecord, ...]
    dropped: dict[str, str]
    closed_form: dict[str, ClosedForm]
    wall_time_s: NonNegative
    responses: Annotated[dict[str, tuple[ResponseRecord, ...]], Field(default_factory=dict)]
