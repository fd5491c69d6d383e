"""How long the parts of a frequency test are, known before it is asked for.

A segment lasts one period of the slowest tone, `segment_min_s`, or what it takes for all segments
together to hold `RESOLUTION_PERIODS` beats of the closest tones. Without `settle_s` the measuring
part begins `settling_time_s` after the ramp: a transient decays at the robot's own rate, whatever
the tone's frequency.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.robots.spec import RobotSpec

RAMP_MAX_S = 5.0
RAMP_MIN_PERIODS = 1 / 8
"""A ramp lasts one period of the tone where that is short. A slow tone is ramped over 5 s or an
eighth of its period: a whole one would cost minutes, and at worst this triples the peak velocity of
a motion that is slow anyway. Of several tones it is the period of their geometric mean: the fast
ones make the velocity, and what the slow ones excite decays while the robot settles."""

RESOLUTION_PERIODS = 2.0
"""Periods of the slowest beat between two tones that the measuring part has to hold. At one the
least squares can just tell them apart; at two its variance is that of each tone alone."""


@dataclass(frozen=True)
class Timing:
    """The parts of a test as they follow from the request and the robot, before sampling."""

    ramp_s: float
    settle_s: float
    segments: int
    segment_s: float

    @property
    def asked_s(self) -> float:
        """How long all parts take together; sampled they take up to a few samples longer."""
        return 2 * self.ramp_s + self.settle_s + self.segments * self.segment_s

    def sampled(self, sample_time_s: float) -> tuple[int, int, int]:
        """Return the samples of a ramp, of the settling part and of a segment."""
        return (
            math.ceil(self.ramp_s / sample_time_s),
            math.ceil(self.settle_s / sample_time_s),
            max(4, math.ceil(self.segment_s / sample_time_s)),
        )


def timing(excitation: Excitation, spec: RobotSpec) -> Timing:
    """Choose the lengths of all parts."""
    omegas = sorted(tone.omega_rad_s for tone in excitation.tones)
    period_s = 2 * math.pi / omegas[0]
    segment_s = max(period_s, excitation.segment_min_s)
    if len(omegas) > 1:
        beat_s = 2 * math.pi / float(np.min(np.diff(omegas)))
        segment_s = max(segment_s, RESOLUTION_PERIODS * beat_s / excitation.segments)
    middle_s = 2 * math.pi / math.exp(float(np.mean(np.log(omegas))))
    return Timing(
        ramp_s=min(middle_s, max(RAMP_MAX_S, RAMP_MIN_PERIODS * middle_s)),
        settle_s=spec.settling_time_s if excitation.settle_s is None else excitation.settle_s,
        segments=excitation.segments,
        segment_s=segment_s,
    )


def duration_s(excitation: Excitation, spec: RobotSpec) -> float:
    """Return how long the whole motion takes, whether or not the robot would accept it."""
    ramp, settle, segment = timing(excitation, spec).sampled(spec.sample_time_s)
    return (2 * ramp + settle + excitation.segments * segment) * spec.sample_time_s
