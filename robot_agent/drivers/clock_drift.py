"""Estimates how two clocks drift apart, from the delays of messages between them."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray


def drift(sent_s: FloatArray, delays_s: FloatArray, *, drift_max: float) -> float:
    """Return the rate, in s per s, at which delays grow.

    No message arrives before it was sent. The rate is the slope of the line below all delays that
    is closest to them in the mean, which continues the edge of their lower convex hull at the mean
    time (Moon, Skelly and Towsley, "Estimation and removal of clock skew from network delay
    measurements", INFOCOM 1999).

    Args:
        sent_s: Time stamps, shape (messages,), increasing; at least two.
        delays_s: Times of arrival minus time stamps, shape (messages,).
        drift_max: Largest magnitude of the rate; a greater one is cut to it.
    """
    along_s = sent_s - sent_s.mean()
    hull: list[int] = []
    for k in range(len(along_s)):
        while len(hull) > 1 and _not_below(along_s, delays_s, hull[-2], hull[-1], k):
            hull.pop()
        hull.append(k)
    right = int(np.clip(np.searchsorted(along_s[hull], 0.0), 1, len(hull) - 1))
    before, after = hull[right - 1], hull[right]
    rate = (delays_s[after] - delays_s[before]) / (along_s[after] - along_s[before])
    return float(np.clip(rate, -drift_max, drift_max))


def _not_below(x: FloatArray, y: FloatArray, first: int, middle: int, last: int) -> bool:
    """Return whether the middle point lies on or above the line between the others."""
    rise = (y[last] - y[first]) * (x[middle] - x[first])
    return bool((y[middle] - y[first]) * (x[last] - x[first]) >= rise)
