"""The robot time of an oracle that knows all responses and only has to prove which one is closest.

Each rival plays, together with the target, the one tone that proves in the shortest time under the
known noise that it is not closer than the closest source by more than a difference that matters;
the closest source plays the one at which it is furthest away. The oracle waits for nothing to
settle. No method that has to find these tones can be as quick.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtri

from benchmarks.selection_fleets import Fleet, TestedRobot
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.frequency_test.duration import RAMP_MAX_S, RAMP_MIN_PERIODS
from nufleet.shared.robots.joint_limits import HEADROOM

PERIODS = 3
"""Number of periods of a measured tone, one for each segment."""


def oracle_time_s(fleet: Fleet, settings: AdaptiveSettings | None = None) -> float:
    """Return the robot-seconds of the oracle.

    The target plays the tones of all sources at once, for as long as the longest takes.

    Args:
        fleet: Fleet with its true responses.
        settings: Accepted probability of a wrong selection, and the difference that does not
            matter; None takes the defaults.
    """
    settings = settings or AdaptiveSettings()
    psi = {name: chordal_distance(fleet.z["target"], fleet.z[name]) for name in fleet.sources}
    closest = min(fleet.sources, key=lambda source: float(psi[source].max()))
    distance = float(psi[closest].max())
    deviations = -float(ndtri(settings.delta / len(fleet.sources)))
    times: dict[str, float] = {}
    nearest = math.inf
    for name, robot in fleet.sources.items():
        if name != closest:
            margin = psi[name] - distance + settings.epsilon
            nearest = min(nearest, float(margin.max()))
            times[name] = float(_time_s(fleet, robot, fleet.z[name], margin / deviations).min())
    # A rival's margin counts from the distance of the closest source, which is measured, too.
    at = int(np.argmax(psi[closest]))
    sure = np.full(len(fleet.omega_rad_s), min(nearest, 1.0) / deviations)
    times[closest] = float(_time_s(fleet, fleet.sources[closest], fleet.z[closest], sure)[at])
    return sum(times.values()) + max(times.values())


def _time_s(fleet: Fleet, robot: TestedRobot, z: ComplexArray, deviation: FloatArray) -> FloatArray:
    """Return how long a tone of each frequency takes until the distance is known that well, in s.

    N samples of a tone of amplitude A in noise of standard deviation σ give ẑ with a variance of
    4σ²/(NA²), of which half lies along the distance; on the sphere it is divided by (1 + |z|²)².
    """
    omega, axis = fleet.omega_rad_s, robot.spec.axes[0]
    limits = axis.amplitude_max, axis.velocity_max / omega, axis.acceleration_max / omega**2
    amplitude = HEADROOM * np.minimum(np.minimum(limits[0], limits[1]), limits[2])
    both = sum(1 / (1 + np.abs(one) ** 2) ** 2 for one in (fleet.z["target"], z))
    with np.errstate(divide="ignore"):
        samples = np.where(
            deviation > 0, 2 * (robot.noise_m / (amplitude * deviation)) ** 2 * both, math.inf
        )
    period_s = 2 * math.pi / omega
    ramp_s = np.minimum(period_s, np.maximum(RAMP_MAX_S, RAMP_MIN_PERIODS * period_s))
    measured_s = np.maximum(PERIODS * period_s, samples * robot.spec.sample_time_s)
    return np.asarray(2 * ramp_s + measured_s)
