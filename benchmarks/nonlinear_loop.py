"""A second-order loop whose actuator has a dead zone or a limited rate, simulated in time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from nufleet.shared.arrays import FloatArray

SUBSTEPS = 4


@dataclass(frozen=True)
class NonlinearLoop:
    """ÿ = dead zone of (ω²(r − y) + ω² lead ṙ − 2ζω ẏ), whose rate of change is limited; r is late.

    Without a dead zone and with an infinite rate it is the second-order loop with lead and delay.
    """

    omega_rad_s: float
    damping: float
    lead_s: float
    delay_s: float
    dead_zone_m_s2: float
    rate_max_m_s3: float

    @property
    def slowest_decay_1_s(self) -> float:
        """The real part of the slowest pole of the loop without the nonlinearity."""
        return self.damping * self.omega_rad_s


def play(loop: NonlinearLoop, reference: FloatArray, sample_time_s: float) -> FloatArray:
    """Return the position at each sample of a reference, shape (samples,), from rest at 0."""
    times_s = np.arange(len(reference) * SUBSTEPS) * (sample_time_s / SUBSTEPS)
    played = np.arange(len(reference)) * sample_time_s
    late = np.interp(times_s - loop.delay_s, played, reference, left=0.0)
    output = _integrate(
        late,
        sample_time_s / SUBSTEPS,
        loop.omega_rad_s,
        loop.damping,
        loop.lead_s,
        loop.dead_zone_m_s2,
        min(loop.rate_max_m_s3, 1e12),
    )
    return np.asarray(output[::SUBSTEPS])


@njit(cache=True)
def _integrate(
    reference: FloatArray,
    step_s: float,
    omega: float,
    damping: float,
    lead_s: float,
    dead_zone: float,
    rate_max: float,
) -> FloatArray:
    position, speed, force, last = 0.0, 0.0, 0.0, 0.0
    output = np.empty(len(reference))
    for k in range(len(reference)):
        output[k] = position
        slope = (reference[k] - last) / step_s
        last = reference[k]
        wanted = omega**2 * (last - position + lead_s * slope) - 2 * damping * omega * speed
        if abs(wanted) <= dead_zone:
            wanted = 0.0
        else:
            wanted -= math.copysign(dead_zone, wanted)
        change = rate_max * step_s
        force += min(max(wanted - force, -change), change)
        position += step_s * speed + 0.5 * step_s**2 * force
        speed += step_s * force
    return output
