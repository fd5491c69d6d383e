"""What is drawn in full: in a large fleet, or of many tones, the rest would hide it."""

from __future__ import annotations

import numpy as np

from nufleet.orchestrator.viewer.events import IterationEvent
from nufleet.shared.distance.chordal import chordal_distance

LEADERS = 6


def leading_sources(event: IterationEvent) -> tuple[str, ...]:
    """The best of the ranking, best first."""
    return tuple(row.robot for row in event.ranking[:LEADERS])


def telling_tone(event: IterationEvent) -> int:
    """The index of the tone at which the leading sources are farthest from the target."""
    target = event.responses.get(event.target, ())
    farness = np.zeros(len(event.omega_rad_s))
    for source in leading_sources(event):
        z = event.responses.get(source, ())
        both = min(len(z), len(target), len(farness))
        farness[:both] += chordal_distance(np.array(z[:both]), np.array(target[:both]))
    return int(np.argmax(farness)) if len(farness) else 0


def responses_at(event: IterationEvent, tone: int) -> dict[str, complex]:
    """The response of each robot that has one at a tone."""
    return {robot: z[tone] for robot, z in event.responses.items() if len(z) > tone}
