"""Results of evaluating every robot as the target of all others: how well ψ predicts in general."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field

from nufleet.orchestrator.evaluation.results import EvaluationResult, IntervalCoverage
from nufleet.orchestrator.evaluation.summaries import (
    kendall_tau,
    mean_kendall_tau,
    pooled_kendall_tau,
)
from nufleet.orchestrator.evaluation.values import TransferPair
from nufleet.shared.strict import Document, NonNegative, Strict

PAIRS = "pairs.json"


class Pair(Strict):
    """The prediction and the outcome for one ordered pair of robots."""

    target: str
    """Name of the robot that received the experience."""
    source: str
    """Name of the robot that the experience came from."""
    psi: float
    """Estimate ψ̂* of the worst-case chordal distance."""
    rms_m: NonNegative | None
    """Mean RMS error with the source's experience, in the unit of the target's axes; None when a
    path was not finished."""
    ratio: NonNegative | None
    """`rms_m` over the mean error with the target's baseline; None when a path was not finished."""
    predicted_ratio: NonNegative | None = None
    """The ratio that the tests predict for these paths."""
    harmful: bool
    """Whether the target did worse than with its baseline on at least one path."""
    taken_back: Annotated[int, Field(ge=0)]
    """Number of flights in which the guard withdrew the prior."""


class Regret(Strict):
    """The mean excess of an error over the best source's, as a fraction of the baseline's error.

    The mean is over the targets. Targets that did not finish with their baseline are left out,
    since there is nothing to compare with.
    """

    selected: NonNegative
    """Regret of flying with the selected source."""
    random: NonNegative
    """Regret of flying with a source chosen at random: the mean over all sources."""


class ChosenWays(Strict):
    """The first flights of all targets, each in the way with the least predicted error."""

    ways: dict[str, str]
    """Way that was chosen, by target."""
    regret: NonNegative | None
    """Mean excess of its error over the least error of all ways, as a fraction of the baseline's;
    None when no target can be compared."""
    regret_max: NonNegative | None
    """Largest of these over the targets."""
    worse_than_baseline: Annotated[int, Field(ge=0)]
    """Number of flights with the chosen way that left more error than the baseline."""


class PairsResult(Document):
    """What `nufleet evaluate --all-pairs --json` prints."""

    pairs: tuple[Pair, ...]
    """All ordered pairs, target by target."""
    targets: tuple[EvaluationResult, ...]
    """Evaluation of each target."""
    kendall_tau: float | None
    """Rank correlation of ψ̂* with the error, averaged over the targets."""
    kendall_tau_pooled: float | None
    """Rank correlation of ψ̂* with the ratio to the baseline's error, over all pairs together."""
    kendall_tau_trajectory: float | None = None
    """Rank correlation of the errors predicted for the paths with those flown, averaged over the
    targets."""
    kendall_tau_trajectory_pooled: float | None = None
    """Rank correlation of the predicted with the measured ratio to the baseline's error, over all
    pairs together."""
    regret: Regret | None
    """Cost of the selection; None when no target can be compared."""
    best_selected: Annotated[int, Field(ge=0)]
    """Number of targets whose selected source left the smallest error."""
    harmful: Annotated[int, Field(ge=0)]
    """Number of pairs in which the target did worse than its baseline on at least one path."""
    chosen: ChosenWays | None = None
    """What flying in the way with the least predicted error cost; None without predictions."""
    worse_than_baseline: Annotated[int, Field(ge=0)] = 0
    """Number of flights, with any way, that left more error than the baseline on the same path."""
    coverage: IntervalCoverage = IntervalCoverage(flights=0, inside=0)
    """How often the predicted intervals contained the error, over all flights."""
    run: str
    """Path of the run's folder."""


def compare_pairs(targets: Sequence[EvaluationResult], run: str) -> PairsResult:
    """Compare the predictions for all targets with the errors that they flew with.

    Args:
        targets: Evaluation of each robot as the target of the others.
        run: Path of the run's folder.
    """
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
        chosen=_chosen(targets),
        worse_than_baseline=sum(target.worse_than_baseline for target in targets),
        coverage=IntervalCoverage(
            flights=sum(each.flights for t in targets for each in t.coverage.values()),
            inside=sum(each.inside for t in targets for each in t.coverage.values()),
        ),
        run=run,
    )


def transfer_pairs(pairs: Sequence[Pair]) -> tuple[TransferPair, ...]:
    """Return pairs as plain values; an unfinished one gets an infinite ratio, the worst of all."""
    return tuple(
        TransferPair(
            pair.target, pair.source, pair.psi, math.inf if pair.ratio is None else pair.ratio
        )
        for pair in pairs
    )


def _chosen(targets: Sequence[EvaluationResult]) -> ChosenWays | None:
    ways = {t.target: t.chosen_way for t in targets if t.chosen_way is not None}
    if not ways:
        return None
    regrets = [
        t.regret_m / t.baseline.rms_m
        for t in targets
        if t.regret_m is not None and t.baseline.rms_m
    ]
    return ChosenWays(
        ways=ways,
        regret=float(np.mean(regrets)) if regrets else None,
        regret_max=max(regrets, default=None),
        worse_than_baseline=sum(t.chosen_worse_than_baseline for t in targets),
    )


def _pairs(target: EvaluationResult) -> list[Pair]:
    base, expected = target.baseline.rms_m, target.baseline.predicted_rms_m
    return [
        Pair(
            target=target.target,
            source=source.robot,
            psi=source.distance,
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
    """Return the regret of the selected source and the mean regret of all, over `base`.

    A source with an unfinished path counts with twice the baseline's error `base`, or with the
    largest error of the others if that is larger.
    """
    finished = [s.rms_m for s in target.sources if s.rms_m is not None]
    unfinished = max([2 * base, *finished])  # a finite penalty keeps the mean over targets finite
    errors = [unfinished if s.rms_m is None else s.rms_m for s in target.sources]
    best = min(errors)
    return (errors[0] - best) / base, (float(np.mean(errors)) - best) / base


def _best_was_selected(target: EvaluationResult) -> bool:
    """Return whether the first source, the closest by ψ̂*, left the smallest error."""
    errors = [math.inf if s.rms_m is None else s.rms_m for s in target.sources]
    return math.isfinite(errors[0]) and errors[0] == min(errors)
