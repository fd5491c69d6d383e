"""The largest chordal distance that tests of two robots measured, at tones that both played."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nufleet.shared.distance.chordal import chordal_distance, geodesic_radius
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import UNCERTAINTY_MAX_RAD


def largest_measured(
    one: Sequence[FrequencyResponse], other: Sequence[FrequencyResponse]
) -> tuple[float, float] | None:
    """Return the largest distance and its frequency in rad/s; None if no tone is shared.

    Tones at which noise leaves a response nearly unknown do not count.

    Args:
        one: Tests of one robot.
        other: Tests of the other robot.
    """
    found = [
        (float(psi), float(omega))
        for a in one
        for b in other
        for psi, omega in zip(*_shared(a, b), strict=True)
    ]
    return max(found, default=None)


def _shared(a: FrequencyResponse, b: FrequencyResponse) -> tuple[list[float], list[float]]:
    omega, i, j = np.intersect1d(a.omega_rad_s, b.omega_rad_s, return_indices=True)
    known = np.ones(len(omega), dtype=bool)
    for response, at in ((a, i), (b, j)):
        radius = geodesic_radius(response.z[at], np.sqrt(response.variance[at]))
        known &= radius <= UNCERTAINTY_MAX_RAD
    psi = chordal_distance(a.z[i[known]], b.z[j[known]])
    return psi.tolist(), omega[known].tolist()
