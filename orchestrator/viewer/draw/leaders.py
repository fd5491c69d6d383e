"""Selects the sources and the tone that are drawn in full, so that the rest do not hide them."""

from __future__ import annotations

import numpy as np

from nufleet.orchestrator.viewer.events import IterationEvent
from nufleet.shared.distance.chordal import chordal_distance

LEADERS = 6
"""Number of sources that are drawn in full."""


def leading_sources(event: IterationEvent) -> tuple[str, ...]:
    """Return the names of the best sources of the ranking, best first."""
    return tuple(row.robot for row in event.ranking[:LEADERS])


def telling_tone(event: IterationEvent) -> int:
    """Return the index of the tone at which the leading sources are farthest from the target.

    The distance is the sum of the chordal distances ψ(z_S, z_T) over the leading sources.
    """
    target = event.responses.get(event.target, ())
    farness = np.zeros(len(event.omega_rad_s))
    for source in leading_sources(event):
        z = event.responses.get(source, ())
        both = min(len(z), len(target), len(farness))
        farness[:both] += chordal_distance(np.array(z[:both]), np.array(target[:both]))
    return int(np.argmax(farness)) if len(farness) else 0


def responses_at(event: IterationEvent, tone: int) -> dict[str, complex]:
    """Return the response z(ω) at the tone with the given index, by robot that has one."""
    return {robot: z[tone] for robot, z in event.responses.items() if len(z) > tone}
