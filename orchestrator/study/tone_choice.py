"""Chooses the tones of tests: a first test over the whole band, and candidates for closer ones."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.duration import duration_s
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.multitone import multitone
from nufleet.shared.robots.spec import RobotSpec

SEGMENTS = 3
"""Number of measuring segments, as few as possible.

A segment lasts at least one period of the slowest tone, so more segments would cost time at low
frequency. The variance, which few segments measure poorly, is pooled over tones.
"""

STEP = 2
"""Spacing of the tones, in harmonics of 2π/T, where T is the measuring time.

At a spacing of two beats, least squares separates the tones as if each were alone.
"""

WEIGHT_EXPONENT = -0.5
"""Exponent of ω in the tones' amplitudes, between equal amplitudes (0) and equal speeds (−1)."""

TONES_MAX = 64


@dataclass(frozen=True)
class ToneChoice:
    """The tones of a test: harmonics of 2π/T, where T is the measuring time."""

    measure_s: float
    """Measuring time T in s."""
    harmonics: tuple[int, ...]
    """Numbers of the harmonics, rising."""

    @property
    def omega_rad_s(self) -> FloatArray:
        """Frequencies of the tones in rad/s, rising, shape (tones,)."""
        return np.asarray(np.array(self.harmonics) * (2 * math.pi / self.measure_s))

    def excitation(self, axis: str) -> Excitation:
        """Return the excitation that plays these tones on an axis."""
        weights = np.asarray(self.omega_rad_s**WEIGHT_EXPONENT)
        tones = multitone(2 * math.pi / self.measure_s, self.harmonics, weights)
        return Excitation(axis=axis, tones=tones, segments=SEGMENTS)

    def duration_s(self, spec: RobotSpec) -> float:
        """Return the duration of the test on a robot in s, which does not depend on the phases."""
        tones = tuple(Tone(omega_rad_s=omega) for omega in self.omega_rad_s.tolist())
        return duration_s(Excitation(axis="any", tones=tones, segments=SEGMENTS), spec)


def first_look(
    band_rad_s: tuple[float, float], spec: RobotSpec, periods: int, share_of_settling: float
) -> ToneChoice:
    """Return tones over the whole band, spaced as closely as the robot's resonances require.

    A resonance is as narrow as its transient is slow to decay, so a long settling time requires
    closely spaced tones, that is a long measuring time. A test of such a robot costs its settling
    time anyway. The measuring part therefore lasts a share of the settling time or a number of
    periods of the band's upper end, whichever is longer.

    Args:
        band_rad_s: Lowest and highest frequency in rad/s.
        spec: Spec of the robot, with its settling time.
        periods: Least measuring time, in periods of the band's upper end.
        share_of_settling: Least measuring time, as a share of the settling time.

    Returns:
        At most `TONES_MAX` tones.
    """
    high = band_rad_s[1]
    wanted = share_of_settling * spec.settling_time_s * high / (2 * math.pi)
    highest = max(periods, math.ceil(wanted))
    highest += 1 - highest % 2  # odd like the lowest, 3: each of the 3 segments holds one period
    while highest > 3:
        choice = _between(band_rad_s, highest * 2 * math.pi / high, 0)
        if choice is not None and len(choice.harmonics) <= TONES_MAX:
            return choice
        highest -= 2
    return _up_to(high, 3 * 2 * math.pi / high, (3,))


def closer_looks(
    band_rad_s: tuple[float, float],
    measure_s: float,
    lengths: Sequence[float],
    centres_rad_s: Sequence[float],
    window_tones: int,
) -> list[ToneChoice]:
    """Return the candidates for a next test, without duplicates.

    For each length there are tests of the whole band, on even and on odd harmonics, and one of
    `window_tones` harmonics around each centre.

    Args:
        band_rad_s: Lowest and highest frequency in rad/s.
        measure_s: Measuring time of the first test in s.
        lengths: Measuring times of the candidates, as multiples of `measure_s`.
        centres_rad_s: Frequencies in rad/s to look at more closely.
        window_tones: Number of tones around each centre.
    """
    low, high = band_rad_s
    found: dict[ToneChoice, None] = {}
    for length in lengths:
        total_s = length * measure_s
        base = 2 * math.pi / total_s
        for offset in (0, 1):
            choice = _between((low, high), total_s, offset)
            if choice is not None and len(choice.harmonics) <= TONES_MAX:
                found[choice] = None
        for centre in centres_rad_s:
            half = base * STEP * (window_tones - 1) / 2
            # A window that would reach beyond the band is moved inside it.
            middle = min(max(centre, low + half), high - half)
            choice = _between((max(low, middle - half), min(high, middle + half)), total_s, 0)
            if choice is not None:
                found[choice] = None
    return list(found)


def _between(window_rad_s: tuple[float, float], measure_s: float, offset: int) -> ToneChoice | None:
    """Return every second harmonic in a window, counted from the top; None if it has none."""
    base = 2 * math.pi / measure_s
    top = math.floor(window_rad_s[1] / base * (1 + 1e-9)) - offset
    lowest = max(SEGMENTS, math.ceil(window_rad_s[0] / base * (1 + 1e-9)))
    harmonics = tuple(range(top, lowest - 1, -STEP))[::-1]
    return _up_to(window_rad_s[1], measure_s, harmonics) if harmonics else None


def _up_to(high_rad_s: float, measure_s: float, harmonics: tuple[int, ...]) -> ToneChoice:
    """Return the choice whose highest tone is not above `high_rad_s`, where robots refuse tests.

    Rounding may put a tone at the band's edge just outside the band; the measuring time is then
    lengthened by the smallest possible steps until the tone is inside.
    """
    choice = ToneChoice(measure_s, harmonics)
    while choice.omega_rad_s[-1] > high_rad_s:
        choice = ToneChoice(math.nextafter(choice.measure_s, math.inf), harmonics)
    return choice
