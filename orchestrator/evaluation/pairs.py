"""Every robot as target and all others as its sources: how well ψ predicts in general."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from nufleet.orchestrator.evaluation.results import EvaluationResult
from nufleet.orchestrator.evaluation.summaries import (
    kendall_tau,
    mean_kendall_tau,
    pooled_kendall_tau,
)
from nufleet.orchestrator.evaluation.values import TransferPair
from nufleet.shared.strict import NonNegative, Strict

PAIRS = "pairs.json"


class Pair(Strict):
    """One ordered pair. `ratio` is the error with the source's experience over the baseline's.

    It is None where a path was not flown to its end; `predicted_ratio` is what the tests let expect
    of it on these paths. `harmful` says that the target did worse than with its baseline on at
    least one path.
    """

    target: str
    source: str
    psi: float
    rms_m: NonNegative | None
    ratio: NonNegative | None
    predicted_ratio: NonNegative | None = None
    harmful: bool
    taken_back: Annotated[int, Field(ge=0)]


class Regret(Strict):
    """How much worse than the best source, as a share of the baseline's error, over the targets.

    `random` is the mean over all sources. Targets that did not finish with their baseline are left
    out: there is nothing to compare with.
    """

    selected: NonNegative
    random: NonNegative


class PairsResult(Strict):
    """What `nufleet evaluate --all-pairs --json` prints.

    `kendall_tau` is the mean over the targets of the rank correlation of ψ with the error;
    `kendall_tau_pooled` that over all pairs of ψ with the ratio to the baseline's error. The two
    of `trajectory` are the same of the errors predicted for the paths flown. `regret` is None where
    no target can be compared. `best_selected` counts the targets whose selected source left the
    smallest error.
    """

    schema_version: Annotated[Literal[1], Field(alias="schema")] = 1
    pairs: tuple[Pair, ...]
    targets: tuple[EvaluationResult, ...]
    kendall_tau: float | None
    kendall_tau_pooled: float | None
    kendall_tau_trajectory: float | None = None
    kendall_tau_trajectory_pooled: float | None = None
    regret: Regret | None
    best_selected: Annotated[int, Field(ge=0)]
    harmful: Annotated[int, Field(ge=0)]
    run: str

    def document(self) -> str:
        """Return the JSON that other programs read."""
        return self.model_dump_json(by_alias=True)


def compare_pairs(targets: Sequence[EvaluationResult], run: str) -> PairsResult:
    """Compare what was predicted for all targets with what they flew."""
    pairs = tuple(pair for target in targets for pair in _pairs(target))
    transfers = transfer_pairs(pairs)
    predicted = [p.predicted_ratio for p in pairs if p.predicted_ratio is not None]
    on_paths = [t.kendall_tau_trajectory for t in targets if t.kendall_tau_trajectory is not None]
    regrets = [_regrets(t, base) for t in targets if (base := t.baseline.rms_m)]
    return PairsResult(
        pairs=pairs,
        targets=tuple(targets),
        kendall_tau=mean_kendall_tau(transfers),
        kendall_tau_pooled=pooled_kendall_tau(transfers),
        kendall_tau_trajectory=float(np.mean(on_paths)) if on_paths else None,
        kendall_tau_trajectory_pooled=kendall_tau(predicted, [pair.ratio for pair in transfers])
        if len(predicted) == len(pairs)
        else None,
        regret=Regret(
            selected=float(np.mean([selected for selected, _ in regrets])),
            random=float(np.mean([random for _, random in regrets])),
        )
        if regrets
        else None,
        best_selected=sum(_best_was_selected(target) for target in targets),
        harmful=sum(pair.harmful for pair in pairs),
        run=run,
    )


def transfer_pairs(pairs: Sequence[Pair]) -> tuple[TransferPair, ...]:
    """Return predictions and errors of pairs; one that was not finished is the worst of all."""
    return tuple(
        TransferPair(
            pair.target, pair.source, pair.psi, math.inf if pair.ratio is None else pair.ratio
        )
        for pair in pairs
    )


def _pairs(target: EvaluationResult) -> list[Pair]:
    base, expected = target.baseline.rms_m, target.baseline.predicted_rms_m
    return [
        Pair(
            target=target.target,
            source=source.robot,
            psi=source.psi,
            rms_m=source.rms_m,
            ratio=None if source.rms_m is None or not base else source.rms_m / base,
            predicted_ratio=None
            if source.predicted_rms_m is None or not expected
            else source.predicted_rms_m / expected,
            harmful=source.worst_ratio is None or source.worst_ratio > 1.0,
            taken_back=source.taken_back,
        )
        for source in target.sources
    ]


def _regrets(target: EvaluationResult, base: float) -> tuple[float, float]:
    """Return the regret of the source selected and the mean regret of all, over the baseline's.

    A path that was not finished counts as twice the baseline's error, or the worst that was flown
    if that is more.
    """
    finished = [s.rms_m for s in target.sources if s.rms_m is not None]
    unfinished = max([2 * base, *finished])
    errors = [unfinished if s.rms_m is None else s.rms_m for s in target.sources]
    best = min(errors)
    return (errors[0] - best) / base, (float(np.mean(errors)) - best) / base


def _best_was_selected(target: EvaluationResult) -> bool:
    """Whether the source that is closest by ψ, which comes first, left the smallest error."""
    errors = [math.inf if s.rms_m is None else s.rms_m for s in target.sources]
    return math.isfinite(errors[0]) and errors[0] == min(errors)
