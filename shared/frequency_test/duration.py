"""The durations of the parts of a frequency test, known before the test is requested.

The tones of all axes of a test count alike, since the output of every axis may contain them all.
The segments of several tones together hold one period of the slowest of them,
`RESOLUTION_PERIODS` beats of the two closest on one axis, and `ACROSS_PERIODS` of the two closest
on any; a segment of a single tone holds a period of its own.
No segment is shorter than `segment_min_s`.
Without `settle_s` the measuring part begins `settling_time_s` after the ramp: a transient decays at
the robot's own rate, which does not depend on the frequency of the tone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.robots.spec import RobotSpec

RAMP_MAX_S = 5.0
RAMP_MIN_PERIODS = 1 / 8
"""Bounds on the ramp of a slow tone. A ramp lasts one period of the tone if that is short. A slow
tone is ramped over 5 s or an eighth of its period, whichever is longer: a whole period would cost
minutes, and at worst the shorter ramp triples the peak velocity of a motion that is slow anyway.
For several tones the period of their geometric mean frequency is used: the fast tones determine the
velocity, and the transient that the slow ones excite decays while the robot settles."""

RESOLUTION_PERIODS = 2.0
"""Periods of the slowest beat between two tones of an axis that the measuring part must hold. With
one period, least squares can just separate the tones; with two, the variance equals that of each
tone alone."""

ACROSS_PERIODS = 0.5
"""The same for tones of different axes. Two or three tones as close as this are told apart as long
as the others are further away; how much that widens their variances is part of these."""


@dataclass(frozen=True)
class Timing:
    """Durations of the parts of a test, from the request and the robot, before sampling."""

    ramp_s: float
    """Duration of each of the two ramps, at the beginning and at the end."""
    settle_s: float
    """Duration of settling, between the first ramp and the measuring part."""
    segments: int
    """Number of segments of the measuring part."""
    segment_s: float
    """Duration of one segment."""

    @property
    def asked_s(self) -> float:
        """Duration of all parts together; rounded to whole samples they take slightly longer."""
        return 2 * self.ramp_s + self.settle_s + self.segments * self.segment_s

    def sampled(self, sample_time_s: float) -> tuple[int, int, int]:
        """Return the number of samples of a ramp, of the settling part and of a segment.

        Each part is rounded up; a segment has at least four samples.
        """
        return (
            math.ceil(self.ramp_s / sample_time_s),
            math.ceil(self.settle_s / sample_time_s),
            max(4, math.ceil(self.segment_s / sample_time_s)),
        )


def timing(excitation: Excitation, spec: RobotSpec) -> Timing:
    """Choose the durations of all parts of a test.

    Args:
        excitation: Request for the test.
        spec: Description of the robot that will perform it.
    """
    omegas = excitation.omega_rad_s
    period_s = 2 * math.pi / omegas[0]
    measure_s = excitation.segments * period_s
    if len(omegas) > 1:
        own = [sorted(tone.omega_rad_s for tone in one.tones) for one in excitation.played]
        closest = min((b - a for each in own for a, b in pairwise(each)), default=math.inf)
        across = min(b - a for a, b in pairwise(omegas))
        resolved_s = max(RESOLUTION_PERIODS / closest, ACROSS_PERIODS / across) * 2 * math.pi
        measure_s = max(period_s, resolved_s)
    # The period of the geometric mean of all frequencies, see RAMP_MIN_PERIODS.
    middle_s = 2 * math.pi / math.exp(float(np.mean(np.log(omegas))))
    return Timing(
        ramp_s=min(middle_s, max(RAMP_MAX_S, RAMP_MIN_PERIODS * middle_s)),
        settle_s=spec.settling_time_s if excitation.settle_s is None else excitation.settle_s,
        segments=excitation.segments,
        segment_s=max(measure_s / excitation.segments, excitation.segment_min_s),
    )


def duration_s(excitation: Excitation, spec: RobotSpec) -> float:
    """Return the duration of the whole motion, whether or not the robot would accept it.

    Args:
        excitation: Request for the test.
        spec: Description of the robot that would perform it.

    Returns:
        Duration in seconds on the robot's clock, a whole number of samples.
    """
    ramp, settle, segment = timing(excitation, spec).sampled(spec.sample_time_s)
    return (2 * ramp + settle + excitation.segments * segment) * spec.sample_time_s
