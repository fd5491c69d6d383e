"""The catalogue of earlier runs of every kind, with a one-line summary of each."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from typing import Any, Generic, TypeVar

from nufleet.orchestrator.evaluation.flight_documents import (
    DEMONSTRATION,
    TRACKING,
    TRAINING,
    DemoResult,
    TrackResult,
    TrainResult,
)
from nufleet.orchestrator.evaluation.pairs import PAIRS, PairsResult
from nufleet.orchestrator.evaluation.results import EVALUATION, EvaluationRecord, EvaluationResult
from nufleet.orchestrator.runs.folder import (
    CONFIGURATION,
    RESULTS,
    list_runs,
    read_configuration,
    read_document,
    read_record,
    subject_of,
)
from nufleet.orchestrator.runs.rank_result import RankResult, RunRecord
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.strict import Strict

D = TypeVar("D", bound=Strict)


@dataclass(frozen=True)
class Kind(Generic[D]):
    """A kind of run and its results."""

    document: str
    """Name of the file that a run of this kind writes at its end."""
    type: type[D]
    """Model of that file's content."""
    headline: Callable[[D], str]
    """Function that summarises the content in one line."""

    def read(self, folder: Path) -> D | None:
        """Return the results of a run; None if it did not end.

        Raises:
            InvalidInputError: The file cannot be read or is malformed.
        """
        found = read_document(folder / self.document, self.type)
        # An evaluation leaves its results after each point, long before it ends.
        return None if isinstance(found, EvaluationRecord) and not found.complete else found


@dataclass(frozen=True)
class Run:
    """One run, as its folder describes it."""

    folder: Path
    """Folder of the run."""
    kind: str
    """Kind of the run, a key of `KINDS`."""
    fleet: str
    """Name of the fleet."""
    began: datetime | None
    """Time at which the run began, in UTC; None if the folder's name does not hold it."""
    result: Strict | None
    """Results; None for a run that has not ended or was interrupted."""

    @property
    def ranking(self) -> RankResult | None:
        """The ranking that it made; None if it made none."""
        match self.result:
            case RunRecord() as record:
                return record.result
            case DemoResult() as demo:
                return demo.ranking
        return None

    @property
    def headline(self) -> str:
        """Summary of the results in one line."""
        if self.result is None:
            return ""
        said: str = KINDS[self.kind].headline(self.result)
        return said


@dataclass(frozen=True)
class Damaged:
    """A run whose folder cannot be read, and the reason."""

    folder: Path
    """Folder of the run."""
    reason: str
    """Reason why it cannot be read."""


def read_run(folder: Path) -> Run:
    """Return the run in a folder.

    Raises:
        InvalidInputError: Its files are not those that a run of this version writes.
    """
    configuration = read_configuration(folder)
    kind, fleet, began = subject_of(folder, configuration)
    if kind not in KINDS:
        raise InvalidInputError(
            f"{folder / CONFIGURATION}: a run of kind {kind!r}; expected {', '.join(KINDS)}. Was "
            "it written by a newer version of nufleet?"
        )
    return Run(folder, kind, fleet, began, KINDS[kind].read(folder))


def read_runs(root: Path) -> list[Run | Damaged]:
    """Return all runs, oldest first, with a `Damaged` entry in place of each unreadable one."""
    found: list[Run | Damaged] = []
    for folder in list_runs(root):
        try:
            found.append(read_run(folder))
        except InvalidInputError as error:
            found.append(Damaged(folder, str(error)))
    return found


def latest_ranking(root: Path, fleet: str, target: str) -> tuple[Path, RunRecord] | None:
    """Return the newest completed ranking for a target and its folder; None if there is none.

    Args:
        root: Folder of all runs.
        fleet: Name of the fleet; robots of another fleet may have the same names.
        target: Name of the target.

    Raises:
        InvalidInputError: A newer run, which may be that ranking, cannot be read.
    """
    for folder in reversed(list_runs(root)):
        if (folder / RESULTS).exists() and read_configuration(folder).get("fleet") == fleet:
            record = read_record(folder)
            if record.result.target == target:
                return folder, record
    return None


def _ranked(result: RankResult) -> str:
    return f"{result.selected} for {result.target}, ψ* {result.ranking[0].stated}"


def _demonstrated(result: DemoResult) -> str:
    return f"{_ranked(result.ranking)}; {_reduction(result.flights)}"


def _evaluated(result: EvaluationResult) -> str:
    return f"{result.selected} for {result.target}; {_reduction(result)}"


def _reduction(result: EvaluationResult) -> str:
    first = next(source for source in result.sources if source.robot == result.selected)
    if first.reduction_percent is None:
        return "not all paths were flown to the end with it"
    return f"{first.reduction_percent:.0f} % less error than the baseline"


def _paired(result: PairsResult) -> str:
    tau = "–" if result.kendall_tau is None else f"{result.kendall_tau:.2f}"
    return (
        f"best source selected for {result.best_selected} of {len(result.targets)} targets, "
        f"τ {tau} over {len(result.pairs)} pairs"
    )


def _tracked(result: TrackResult) -> str:
    flights = result.flights
    errors = [flight.rms_m for flight in flights if flight.rms_m is not None]
    paths = "1 path" if len(flights) == 1 else f"{len(flights)} paths"
    who = f"{flights[0].target} with {flights[0].inverse} on {paths}" if flights else "no path"
    if len(errors) < len(flights):
        return f"{who}: {len(flights) - len(errors)} not finished"
    return f"{who}: RMS error {1000 * sum(errors) / len(errors):.1f} mm" if errors else who


def _trained(result: TrainResult) -> str:
    robots = dict.fromkeys(one.robot for one in result.experiences)
    return f"{', '.join(robots)} {'offers' if len(robots) == 1 else 'offer'} experience"


KINDS: dict[str, Kind[Any]] = {
    "rank": Kind[RunRecord](RESULTS, RunRecord, lambda record: _ranked(record.result)),
    "demo": Kind[DemoResult](DEMONSTRATION, DemoResult, _demonstrated),
    "train": Kind[TrainResult](TRAINING, TrainResult, _trained),
    "track": Kind[TrackResult](TRACKING, TrackResult, _tracked),
    "evaluate": Kind[EvaluationRecord](
        EVALUATION, EvaluationRecord, lambda record: _evaluated(record.result)
    ),
    "pairs": Kind[PairsResult](PAIRS, PairsResult, _paired),
}
"""All kinds of runs, by the `kind` in a run's configuration."""
