"""A ranking whose axes disagree on the closest source."""

from __future__ import annotations

from nufleet.orchestrator.study.interface import AxisEstimate, SourceEstimate


def estimate(robot: str, spread: float = 0.01, **psi: float) -> SourceEstimate:
    worst = max(psi.values())
    axes = {
        axis: AxisEstimate(value, value - spread, value + spread, 1.0)
        for axis, value in psi.items()
    }
    return SourceEstimate(robot, worst, worst - spread, worst + spread, 1.0, 1, axes=axes)


RANKING = (
    estimate("even", x=0.13, y=0.13),
    estimate("like-x", x=0.02, y=0.28),
    estimate("like-y", x=0.31, y=0.03),
)
