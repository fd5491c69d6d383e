"""What a study says of its sources: their ranking, their curves, and what was measured."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge
from nufleet.orchestrator.study.comparison import Compared
from nufleet.orchestrator.study.interface import AxisEstimate, Curve, Responses, SourceEstimate
from nufleet.orchestrator.study.measured_distance import largest_measured
from nufleet.orchestrator.study.selection_belief import SelectionBelief
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

Known = Mapping[str, Sequence[FrequencyResponse]]


def sampled_psi(target: str, sources: Sequence[str], responses: Responses) -> dict[str, float]:
    """Return each source's largest measured ψ over the tones that it shared with the target now."""
    measured = {name: one.own_entries or {"": one} for name, one in responses.items()}
    psi: dict[str, float] = {}
    for source in (name for name in sources if name in measured and target in measured):
        for axis in measured[source].keys() & measured[target].keys():
            largest = largest_measured([measured[target][axis]], [measured[source][axis]])
            if largest is not None:
                psi[source] = max(largest[0], psi.get(source, 0.0))
    return psi


def curves_of(belief: SelectionBelief, known: Known) -> tuple[Curve, ...]:
    """Return the belief about each source's ψ_n(ω).

    Args:
        belief: Samples of all distances.
        known: All responses of each robot, by robot.
    """
    grid = belief.omega_rad_s
    curves = []
    for source, quantiles in zip(belief.sources, belief.psi_quantiles, strict=True):
        sampled = np.sort(np.concatenate([response.omega_rad_s for response in known[source]]))
        sampled = sampled[(sampled >= grid[0]) & (sampled <= grid[-1])]
        low, median, high = quantiles
        marks: FloatArray = np.interp(sampled, grid, median)
        curves.append(Curve(source, grid, median, low, high, sampled, marks))
    return tuple(curves)


def ranking_of(
    belief: SelectionBelief, target: str, leader: str, known: Known, unlooked: Collection[str] = ()
) -> tuple[SourceEstimate, ...]:
    """Return the estimates with the leader first and the others by rising typical loss.

    Args:
        belief: Samples of all distances.
        target: Name of the target.
        leader: Name of the selected source.
        known: All responses of each robot, by robot.
        unlooked: Robots whose distances may be larger by any amount, as tests left much unseen.
    """
    estimates = []
    for n, source in enumerate(belief.sources):
        low, median, high = belief.interval(source)
        if target in unlooked or source in unlooked:
            high = 1.0
        estimate = SourceEstimate(
            robot=source,
            psi=median,
            psi_low=low,
            psi_high=high,
            omega_rad_s=float(belief.omega_rad_s[np.argmax(belief.psi_quantiles[n, 1])]),
            tests=len(known[source]),
        )
        estimate = _measured(estimate, known[target], known[source])
        estimates.append((source != leader, float(belief.typical_loss[n]), estimate))
    return tuple(estimate for _, _, estimate in sorted(estimates, key=lambda e: e[:2]))


def _measured(
    estimate: SourceEstimate,
    target: Sequence[FrequencyResponse],
    source: Sequence[FrequencyResponse],
) -> SourceEstimate:
    psi, omega_rad_s = largest_measured(target, source) or (None, None)
    return replace(estimate, measured_psi=psi, measured_omega_rad_s=omega_rad_s)


def ranking_of_axes(
    compared: Compared,
    robots: Mapping[str, AxesKnowledge],
    target: str,
    leader: str,
    unlooked: Mapping[str, Collection[str]],
) -> tuple[SourceEstimate, ...]:
    """Return the estimates over all axes; of several axes, each with those on every one.

    Args:
        compared: Samples of all distances.
        robots: Knowledge of target and sources, by robot.
        target: Name of the target.
        leader: Name of the selected source.
        unlooked: Axes on which much of a robot is unseen, by robot, as `Looks.unlooked` says.
    """
    named = (target, *compared.belief.sources)

    def on(axis: str) -> tuple[SourceEstimate, ...]:
        known = {name: robots[name].axes[axis].responses for name in named}
        hidden = [name for name in named if axis in unlooked.get(name, ())]
        return ranking_of(compared.by_axis[axis], target, leader, known, hidden)

    if len(robots[target].axes) == 1:
        (axis,) = compared.by_axis
        tested = {name: robot.axes[axis].responses for name, robot in robots.items()}
        outrun = [_measured(e, tested[target], tested[e.robot]) for e in compared.estimates]
        return (*on(axis), *outrun)
    estimates = {axis: {one.robot: one for one in on(axis)} for axis in compared.by_axis}
    tests = {name: robots[name].responses for name in named}
    ranking = []
    hidden = [name for name in named if unlooked.get(name)]
    for together in ranking_of(compared.belief, target, leader, tests, hidden):
        axes = {axis: one[together.robot] for axis, one in estimates.items()}
        furthest = max(axes.values(), key=lambda one: one.measured_psi or 0.0)
        ranking.append(
            replace(
                together,
                measured_psi=furthest.measured_psi,
                measured_omega_rad_s=furthest.measured_omega_rad_s,
                axes={
                    axis: AxisEstimate(one.psi, one.psi_low, one.psi_high, one.omega_rad_s)
                    for axis, one in axes.items()
                },
            )
        )
    return tuple(ranking)
