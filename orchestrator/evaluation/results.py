"""What an evaluation measured: the documents that other programs read."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from nufleet.shared.experience.layout import Architecture
from nufleet.shared.strict import NonNegative, Strict


class FlightRecord(Strict):
    """One flight along a drawing. `rms_m` is None where the path was not flown to its end.

    `inverse` is a source's name, `none` for a zero prior, or `baseline`.
    """

    target: str
    inverse: str
    drawing: str
    speed_m_s: NonNegative
    rms_m: NonNegative | None
    taken_back: str | None
    failure: str | None
    deadline_misses: Annotated[int, Field(ge=0)]


class InverseResult(Strict):
    """What one inverse did over all drawings and speeds.

    `rms_m` is the mean of the flights' RMS errors, None when one was not finished, and
    `reduction_percent` compares it with the baseline's. `worst_ratio` is the largest ratio of a
    flight's error to the baseline's on the same path.
    """

    rms_m: NonNegative | None
    reduction_percent: float | None
    worst_ratio: NonNegative | None = None
    taken_back: Annotated[int, Field(ge=0)] = 0


class SourceResult(InverseResult):
    """The same for a source's experience, beside what the tests predicted.

    `predicted_rms_m` is |1 − z_T/z_S| weighted by the spectra of the paths flown, from the same
    tests as ψ.
    """

    robot: str
    psi: float
    psi_std: NonNegative
    predicted_rms_m: NonNegative | None = None


class BaselineResult(Strict):
    """What the target's own controller does alone; predicted is |1 − z_T|."""

    rms_m: NonNegative | None
    predicted_rms_m: NonNegative | None = None


class EvaluationResult(Strict):
    """What `nufleet evaluate --json` prints; sources are in the order of ψ, smallest first.

    Every `rms_m` is in `unit`. `kendall_tau` is the rank correlation of ψ with the sources' errors,
    `kendall_tau_trajectory` that of the errors predicted for these paths; None for fewer than two.
    """

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    target: str
    architecture: Architecture
    unit: Literal["m", "rad"]
    guarded: bool
    baseline: BaselineResult
    no_prior: InverseResult
    sources: tuple[SourceResult, ...]
    selected: str
    kendall_tau: float | None
    kendall_tau_trajectory: float | None = None
    run: str

    def document(self) -> str:
        """Return the JSON that other programs read."""
        return self.model_dump_json(by_alias=True)


class StudyEstimates(Strict):
    """ψ̂*_n of every source after the second and after the last iteration of one study."""

    seed: Annotated[int, Field(ge=0)]
    iterations: Annotated[int, Field(ge=1)]
    second: dict[str, float]
    last: dict[str, float]


class EvaluationRecord(Strict):
    """`evaluation.json` in a run's folder."""

    result: EvaluationResult
    studies: tuple[StudyEstimates, ...]
    flights: tuple[FlightRecord, ...]
    wall_time_s: NonNegative
