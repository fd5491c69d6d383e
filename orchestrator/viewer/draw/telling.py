"""Selects the tone at which responses are compared in the views that show one tone."""

from __future__ import annotations

import numpy as np

from nufleet.orchestrator.viewer.events import Answers
from nufleet.shared.distance.chordal import chordal_distance


def telling_tone(answers: Answers) -> int:
    """Return the index of the tone at which the leading sources are farthest from the target.

    The distance is the sum of the chordal distances ψ(z_S, z_T) over the leading sources.
    """
    target = answers.responses.get(answers.target, ())
    farness = np.zeros(len(answers.omega_rad_s))
    for source in answers.leaders:
        z = answers.responses.get(source, ())
        both = min(len(z), len(target), len(farness))
        farness[:both] += chordal_distance(np.array(z[:both]), np.array(target[:both]))
    return int(np.argmax(farness)) if len(farness) else 0


def responses_at(answers: Answers, tone: int) -> dict[str, complex]:
    """Return the response z(ω) at the tone with the given index, by robot that has one."""
    return {robot: z[tone] for robot, z in answers.responses.items() if len(z) > tone}
