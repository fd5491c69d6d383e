"""The documents of a ranking that other programs read."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BeforeValidator, Field

from nufleet.orchestrator.flights.ways import WayRecord
from nufleet.orchestrator.runs.response_record import ResponseRecord
from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.orchestrator.study.verdict_document import TransferVerdict
from nufleet.shared.strict import Document, NonNegative, Strict

Count = Annotated[int, Field(ge=0)]


def _with_intervals(ranking: object) -> object:
    """Return the estimates of a document, which earlier versions wrote as a mean ± a deviation."""
    if not isinstance(ranking, list):
        return ranking
    return tuple(_with_interval(one) for one in ranking)


def _with_interval(estimate: object) -> object:
    if not isinstance(estimate, dict) or "psi_std" not in estimate:
        return estimate
    psi, psi_std = estimate["psi"], estimate["psi_std"]
    kept = {name: value for name, value in estimate.items() if name != "psi_std"}
    low, high = max(psi - 1.96 * psi_std, 0.0), min(psi + 1.96 * psi_std, 1.0)
    return {**kept, "psi_low": low, "psi_high": high}


Ranking = Annotated[tuple[SourceEstimate, ...], BeforeValidator(_with_intervals)]
"""Estimates of sources, best first."""


class StoredResponses(Strict):
    """The stored tests and flights that replaced the first test of a source."""

    tests: Count
    """Number of stored tests."""
    flights: Count = 0
    """Number of stored flights and imported logs."""
    measured_from: str
    """Time of the oldest measurement, in ISO 8601 and UTC."""
    measured_to: str
    """Time of the newest measurement, in ISO 8601 and UTC."""
    studies: tuple[str, ...]
    """Ids of the studies, runs and logs that they come from."""

    @property
    def counted(self) -> str:
        """Their numbers in words."""
        counts = ((self.tests, "test"), (self.flights, "flight"))
        return " and ".join(f"{n} stored {what}{'s' * (n > 1)}" for n, what in counts if n)

    @property
    def reservation(self) -> str:
        """What flights alone do not tell, in words; empty where there are tests."""
        if self.tests:
            return ""
        return (
            "; until a test of it confirms them, its ψ* ± σ holds for motions like these, and "
            "claims nothing about others"
        )


class RankResult(Document):
    """The document that `nufleet rank --json` prints: the ranking and its cost.

    With a `trajectory` the best source is the one that is expected to leave the smallest error on
    it, otherwise the closest one. Only an algorithm that estimates its own confidence sets
    `confidence`, `eliminated` and `stopped_because`.
    """

    target: str
    """Name of the target."""
    band_rad_s: tuple[float, float]
    """Lowest and highest frequency of the band in rad/s."""
    selected: str
    """Name of the selected source, the first of the ranking."""
    ranking: Ranking
    """Estimates of all remaining sources, best first."""
    iterations: Count
    """Number of rounds of tests."""
    robot_time_s: NonNegative
    """Time that all robots together have moved for the study, in s."""
    run: str
    """Path of the run's folder."""
    confidence: float | None = None
    """Probability that the selection is right."""
    eliminated: dict[str, str] | None = None
    """Reason for each source that cannot win, by source."""
    stopped_because: str | None = None
    """Reason why the study ended."""
    trajectory: str | None = None
    """Name of the trajectory that the ranking is made for, if any."""
    verdicts: Annotated[dict[str, TransferVerdict], Field(default_factory=dict)]
    """Verdict whether transfer will help, by source."""
    findings: tuple[str, ...] = ()
    """Observations during the tests that weaken the statements of this document."""
    stored: dict[str, StoredResponses] | None = None
    """Stored responses that replaced first tests, by source."""
    ways_path: str | None = None
    """Path that the target was asked about, in words; None if it could not tell."""
    ways_unit: Literal["m", "rad"] | None = None
    """Unit of the errors on it, that of the axes of the target."""
    ways: tuple[WayRecord, ...] = ()
    """Ways of flying it, with the error that the target expects of each."""
    chosen_way: str | None = None
    """Name of the one with the least expected error among those that can be flown now."""

    def document(self) -> str:
        """Return the JSON that other programs read, without fields the algorithm does not set."""
        return self.model_dump_json(by_alias=True, exclude_none=True)


class IterationRecord(Strict):
    """One round of tests and the ranking after it."""

    iteration: Count
    """Number of the round, from 1."""
    omega_rad_s: tuple[float, ...]
    """All frequencies that were played, in rad/s."""
    sampled_psi: dict[str, float]
    """Largest chordal distance measured in the round, by source."""
    ranking: Ranking
    """Estimates after the round, best first."""


class ClosedForm(Strict):
    """A source's true worst-case chordal distance, where both robots' models are known."""

    psi: float
    """Largest ψ_n(ω) over the band."""
    omega_rad_s: float
    """Frequency of the largest distance in rad/s."""


class RunRecord(Strict):
    """The document `results.json` in a run's folder."""

    result: RankResult
    """Document that the run printed."""
    axis: str
    """Name of the axis that was tested, or of the axes, separated by spaces."""
    seed: Count
    """Seed of the study's random generator."""
    history: tuple[IterationRecord, ...]
    """All rounds, in order."""
    dropped: dict[str, str]
    """Reason for each source that the study lost, by source."""
    closed_form: dict[str, ClosedForm]
    """True distance, by source, where the models of both robots are known."""
    wall_time_s: NonNegative
    """Wall time of the run in s; of a resumed run, since it was resumed."""
    responses: Annotated[dict[str, tuple[ResponseRecord, ...]], Field(default_factory=dict)]
    """All responses known of each robot, by robot."""
