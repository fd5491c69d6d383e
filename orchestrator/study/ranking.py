"""What a study says of its sources: their ranking, their curves, and what was measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from nufleet.orchestrator.study.interface import Curve, Responses, SourceEstimate
from nufleet.orchestrator.study.measured_distance import largest_measured
from nufleet.orchestrator.study.selection_belief import INTERVAL, SelectionBelief
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

Known = Mapping[str, Sequence[FrequencyResponse]]


def sampled_psi(target: str, sources: Sequence[str], responses: Responses) -> dict[str, float]:
    """Return each source's largest measured ψ over the tones that it shared with the target now."""
    at_target = [responses[target]] if target in responses else []
    found = {
        source: largest_measured(at_target, [responses[source]])
        for source in sources
        if source in responses
    }
    return {source: largest[0] for source, largest in found.items() if largest is not None}


def curves_of(belief: SelectionBelief, known: Known) -> tuple[Curve, ...]:
    """Return the belief about each source's ψ_n(ω).

    Args:
        belief: Samples of all distances.
        known: All responses of each robot, by robot.
    """
    grid = belief.omega_rad_s
    curves = []
    for source, psi in zip(belief.sources, belief.psi, strict=True):
        sampled = np.sort(np.concatenate([response.omega_rad_s for response in known[source]]))
        sampled = sampled[(sampled >= grid[0]) & (sampled <= grid[-1])]
        low, median, high = np.quantile(psi, INTERVAL, axis=0)
        marks: FloatArray = np.interp(sampled, grid, median)
        curves.append(Curve(source, grid, median, low, high, sampled, marks))
    return tuple(curves)


def ranking_of(
    belief: SelectionBelief, target: str, leader: str, known: Known
) -> tuple[SourceEstimate, ...]:
    """Return the estimates with the leader first and the others by rising typical loss.

    Args:
        belief: Samples of all distances.
        target: Name of the target.
        leader: Name of the selected source.
        known: All responses of each robot, by robot.
    """
    estimates = []
    for n, source in enumerate(belief.sources):
        low, median, high = belief.interval(source)
        psi, omega = largest_measured(known[target], known[source]) or (None, None)
        estimate = SourceEstimate(
            robot=source,
            psi=median,
            psi_low=low,
            psi_high=high,
            omega_rad_s=float(belief.omega_rad_s[np.argmax(np.median(belief.psi[n], axis=0))]),
            tests=len(known[source]),
            measured_psi=psi,
            measured_omega_rad_s=omega,
        )
        estimates.append((source != leader, float(belief.typical_loss[n]), estimate))
    return tuple(estimate for _, _, estimate in sorted(estimates, key=lambda e: e[:2]))
