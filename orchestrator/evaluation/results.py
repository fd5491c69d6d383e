"""The results of an evaluation, as documents that other programs read."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.strict import Document, NonNegative, Strict

EVALUATION = "evaluation.json"


Fraction = Annotated[float, Field(ge=0, le=1)]


class FlightRecord(Strict):
    """One flight along a drawing."""

    target: str
    """Name of the robot that flew."""
    inverse: str
    """Name of the source that gave the prior, `none` for a zero prior, `mixture` for one of all
    sources, `by-axis` for that of the closest source on each axis, `own` for the target's model of
    itself, or `baseline`."""
    drawing: str
    """Name of the drawing."""
    speed_m_s: NonNegative
    """Largest speed on the path, in the unit of the target's axes per second."""
    rms_m: NonNegative | None
    """RMS tracking error in the unit of the target's axes; None when the path was not finished."""
    taken_back: str | None
    """Why the guard withdrew the prior; None when it did not."""
    failure: str | None
    """Why the path was not finished; None when it was."""
    flown: bool = True
    """False if the target refused to begin, as it knew too little of itself for the path."""
    deadline_misses: Annotated[int, Field(ge=0)]
    """Number of references that took longer to choose than a sample lasts."""
    weights: dict[str, Fraction] | None = None
    """Mean weight of every source in a mixture over the flight, and of `none`; None without a
    mixture. The weights of every sample are in the flights' table."""
    own_flight_s: NonNegative | None = None
    """Duration of the motions that the target's model of itself rested on before the flight; that
    of its least known axis. None if unknown."""
    beyond_tests_s: NonNegative = 0.0
    """Duration of the target's rich flights before the flight, which its tests do not include."""
    predicted_rms_m: NonNegative | None = None
    """Error that the target expected, from its model of itself; None when it had none."""
    predicted_low_m: NonNegative | None = None
    """Error that it expected to exceed with a probability of 95 %."""
    predicted_high_m: NonNegative | None = None
    """Error that it expected to stay below with a probability of 95 %."""
    noise_rms_m: NonNegative | None = None
    """Error that the noise of the sensor alone would have left; None without samples."""
    findings: tuple[str, ...] = ()
    """What the flight showed of the target's model of itself: that the target has changed, say."""


class InverseResult(Strict):
    """The tracking errors with one inverse, over all drawings and speeds."""

    rms_m: NonNegative | None
    """Mean of the flights' RMS errors; None when a flight was not finished, or not flown."""
    reduction_percent: float | None
    """Percentage by which `rms_m` is below the baseline's mean error; None when the two cannot be
    compared because a flight of either was not finished."""
    worst_ratio: NonNegative | None = None
    """Largest ratio of a flight's error to the baseline's on the same path."""
    taken_back: Annotated[int, Field(ge=0)] = 0
    """Number of flights in which the guard withdrew the prior."""
    not_flown: Annotated[int, Field(ge=0)] = 0
    """Number of flights that the target refused to begin, as it knew too little of itself."""


class WayResult(InverseResult):
    """The tracking errors of one way to fly, after some flying of the target's own.

    The predictions are means over the flights, like the errors.
    """

    way: str
    """`baseline`, `none`, `own`, `mixture`, `by-axis`, or the name of a source."""
    own_flight_s: NonNegative
    """Duration of the target's own rich flights before, beyond its tests. Ways that do not depend
    on them are flown once, after the tests alone."""
    predicted_rms_m: NonNegative | None = None
    """Error that the target expected before the flights; None when it could not tell."""
    predicted_low_m: NonNegative | None = None
    """Error that it expected to exceed with a probability of 95 %."""
    predicted_high_m: NonNegative | None = None
    """Error that it expected to stay below with a probability of 95 %."""


class CurvePoint(Strict):
    """The choice among all ways after some flying of the target's own."""

    own_flight_s: NonNegative
    """Duration of the target's own rich flights before, beyond its tests."""
    known_s: NonNegative | None
    """Duration of all motions that its model of itself rested on, its tests included."""
    chosen_way: str | None
    """Way with the least predicted error; None when nothing was predicted."""
    regret_m: NonNegative | None
    """Error of the chosen way minus the least error of all ways; None when the chosen way was not
    flown to the end of every path."""


class IntervalCoverage(Strict):
    """How often the predictions held: intervals that should contain 90 % of the errors."""

    flights: Annotated[int, Field(ge=0)]
    """Number of flights that had an error and a prediction."""
    inside: Annotated[int, Field(ge=0)]
    """Number of those whose error lay in the interval."""


class SourceResult(InverseResult):
    """The tracking errors with a source's experience, and what the tests predicted for it."""

    robot: str
    """Name of the source."""
    psi: float
    """Estimate ψ̂*_n on the first axis; with repeated studies, its mean over them."""
    psi_std: NonNegative
    """Standard deviation of ψ̂*_n: over repeated studies, or as a single study estimates it."""
    predicted_rms_m: NonNegative | None = None
    """Predicted RMS error, from the tests: |1 − z_T/z_S| weighted by the spectra of the paths that
    were flown, added up over the axes with what one axis does to another."""
    ranked: SourceEstimate | None = None
    """Estimate over all axes, and on each of them, as `nufleet rank` makes it; None where one axis
    is compared."""

    @property
    def distance(self) -> float:
        """The estimate that sources are ordered by: over all axes, or `psi` where there is one."""
        return self.psi if self.ranked is None else self.ranked.psi


class ByAxisResult(InverseResult):
    """The tracking errors with the experience of the closest source on each axis."""

    sources: dict[str, str]
    """Name of the source of each axis, by axis."""
    predicted_rms_m: NonNegative | None = None
    """Predicted RMS error, as for a single source; None in older evaluations."""


class BaselineResult(Strict):
    """The tracking errors with the target's own controller alone."""

    rms_m: NonNegative | None
    """Mean of the flights' RMS errors; None when a flight was not finished."""
    predicted_rms_m: NonNegative | None = None
    """Predicted RMS error: |1 − z_T| weighted by the spectra of the paths that were flown."""


class EvaluationResult(Document):
    """What `nufleet evaluate --json` prints. Every `rms_m` is in `unit`."""

    target: str
    """Name of the robot that received the experiences."""
    architecture: Architecture
    """Architecture of the experiences that were compared."""
    unit: Literal["m", "rad"]
    """Unit of the target's axes."""
    guarded: bool
    """Whether the guard was active in the flights."""
    baseline: BaselineResult
    """Errors with the target's own controller alone."""
    no_prior: InverseResult
    """Errors of online learning that begins with a zero prior."""
    own: InverseResult | None = None
    """Errors with the target's model of itself; None when it was not flown."""
    mixture: InverseResult | None = None
    """Errors with a mixture of all sources' experiences; None when it was not flown."""
    by_axis: ByAxisResult | None = None
    """Errors with the experience of the closest source on each axis; None where no axis has a
    closer source than the selected one, beyond doubt."""
    sources: tuple[SourceResult, ...]
    """Errors with each source's experience, the selected one first: in the order of the ranking
    over all axes, or in ascending order of ψ̂* where one axis is compared."""
    selected: str
    """Name of the source that is selected."""
    predicted_axes: tuple[str, ...] = ()
    """Axes from whose tests errors were predicted; those that are left out were taken to respond
    like the first. Older evaluations, where none is named, knew the first axis of the target."""
    least_expected: str | None = None
    """Source with the least predicted error on these paths, or `by-axis`; None without
    predictions."""
    least_expected_regret_m: NonNegative | None = None
    """Its error minus the least error that any of them left; None where a flight was not
    finished."""
    kendall_tau: float | None
    """Rank correlation of ψ̂* with the sources' errors; None for fewer than two sources."""
    kendall_tau_trajectory: float | None = None
    """Rank correlation of the errors predicted for these paths with the sources' errors; None for
    fewer than two sources or without predictions."""
    ways: tuple[WayResult, ...] = ()
    """Errors of every way to fly, after the tests alone and, for ways that depend on it, after more
    of the target's own flying."""
    points: tuple[CurvePoint, ...] = ()
    """The way that the predictions choose after the tests alone, and after more flying."""
    chosen_way: str | None = None
    """Way with the least predicted error for the first flights, after the tests alone."""
    regret_m: NonNegative | None = None
    """Error of the chosen way in the first flights minus the least error of all ways."""
    noise_rms_m: NonNegative | None = None
    """Error that a flight without any error would show, by the noise of the sensor alone."""
    worse_than_baseline: Annotated[int, Field(ge=0)] = 0
    """Number of flights, with any way, that left more error than the baseline on the same path."""
    chosen_worse_than_baseline: Annotated[int, Field(ge=0)] = 0
    """Number of those among the first flights with the chosen way."""
    coverage: Annotated[dict[str, IntervalCoverage], Field(default_factory=dict)]
    """How often the predictions held, by way."""
    run: str
    """Path of the run's folder."""


class StudyEstimates(Strict):
    """ψ̂*_n of every source after the second and after the last iteration of one study."""

    seed: Annotated[int, Field(ge=0)]
    """Seed of the study."""
    iterations: Annotated[int, Field(ge=1)]
    """Number of iterations that the study took."""
    second: dict[str, float]
    """ψ̂*_n by source after the second iteration."""
    last: dict[str, float]
    """ψ̂*_n by source after the last iteration."""


class EvaluationRecord(Strict):
    """The content of `evaluation.json` in a run's folder."""

    result: EvaluationResult
    """Result of the evaluation, as printed."""
    studies: tuple[StudyEstimates, ...]
    """Estimates of each repeated study."""
    flights: tuple[FlightRecord, ...]
    """Flights in the order in which they were flown."""
    wall_time_s: NonNegative
    """Wall time of the whole evaluation, without the time between an interruption and its
    resumption."""
    complete: bool = True
    """False as long as flights are missing; `nufleet runs resume` flies them."""
