"""How long a frequency test takes on a robot, known before it is asked for.

A segment lasts one period of the slowest tone, `segment_min_s`, or what it takes for all segments
together to hold `RESOLUTION_PERIODS` beats of the closest tones; a ramp lasts one period of the
slowest tone where that is short. A robot agent plans by the same rule, which a test holds.
"""

from __future__ import annotations

import math

import numpy as np

from shared.excitation import Excitation
from shared.robot_spec import RobotSpec

RAMP_MAX_S = 5.0
RAMP_MIN_PERIODS = 1 / 8
RESOLUTION_PERIODS = 2.0


def duration_s(excitation: Excitation, spec: RobotSpec) -> float:
    """Return how long the whole motion takes, whether or not the robot would accept it."""
    omegas = sorted(tone.omega_rad_s for tone in excitation.tones)
    period_s = 2 * math.pi / omegas[0]
    segment_s = max(period_s, excitation.segment_min_s)
    if len(omegas) > 1:
        beat_s = 2 * math.pi / float(np.min(np.diff(omegas)))
        segment_s = max(segment_s, RESOLUTION_PERIODS * beat_s / excitation.segments)
    settle_s = spec.settling_time_s if excitation.settle_s is None else excitation.settle_s
    ramp_s = min(period_s, max(RAMP_MAX_S, RAMP_MIN_PERIODS * period_s))
    samples = (
        2 * math.ceil(ramp_s / spec.sample_time_s)
        + math.ceil(settle_s / spec.sample_time_s)
        + excitation.segments * max(4, math.ceil(segment_s / spec.sample_time_s))
    )
    return samples * spec.sample_time_s
