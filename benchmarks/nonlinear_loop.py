"""A second-order loop whose actuator or sensor is not linear, simulated in time."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit

from nufleet.shared.arrays import FloatArray

SUBSTEPS = 4


@dataclass(frozen=True)
class NonlinearLoop:
    """ÿ = force − friction, with the force asked for, ω²(r − y − hardening y³) + ω² lead ṙ − 2ζω ẏ.

    The force has a dead zone, a largest value and a largest rate of change; what is measured is y
    with backlash. r is late. Without any of that it is the second-order loop with lead and delay.
    """

    omega_rad_s: float
    damping: float
    lead_s: float
    delay_s: float
    dead_zone_m_s2: float = 0.0
    rate_max_m_s3: float = math.inf
    force_max_m_s2: float = math.inf
    friction_m_s2: float = 0.0
    backlash_m: float = 0.0
    hardening_1_m2: float = 0.0

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
        min(loop.force_max_m_s2, 1e12),
        loop.friction_m_s2,
        loop.hardening_1_m2,
    )[::SUBSTEPS]
    return _with_backlash(output, loop.backlash_m / 2) if loop.backlash_m else output


@njit(cache=True)
def _with_backlash(moved: FloatArray, half: float) -> FloatArray:
    output = np.empty(len(moved))
    at = 0.0
    for k in range(len(moved)):
        at = min(max(at, moved[k] - half), moved[k] + half)
        output[k] = at
    return output


@njit(cache=True)
def _integrate(
    reference: FloatArray,
    step_s: float,
    omega: float,
    damping: float,
    lead_s: float,
    dead_zone: float,
    rate_max: float,
    force_max: float,
    friction: float,
    hardening: float,
) -> FloatArray:
    position, speed, force, last = 0.0, 0.0, 0.0, 0.0
    output = np.empty(len(reference))
    for k in range(len(reference)):
        output[k] = position
        slope = (reference[k] - last) / step_s
        last = reference[k]
        away = last - position - hardening * position**3
        wanted = omega**2 * (away + lead_s * slope) - 2 * damping * omega * speed
        if abs(wanted) <= dead_zone:
            wanted = 0.0
        else:
            wanted -= math.copysign(dead_zone, wanted)
        wanted = min(max(wanted, -force_max), force_max)
        change = rate_max * step_s
        force += min(max(wanted - force, -change), change)
        # Coulomb friction takes away what moves, and at most brings to rest.
        pushed = speed + step_s * force
        moving = math.copysign(max(abs(pushed) - step_s * friction, 0.0), pushed)
        position += 0.5 * step_s * (speed + moving)
        speed = moving
    return output
