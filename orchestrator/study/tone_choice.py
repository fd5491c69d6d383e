"""Which tones a test may play: a first look over the band, and candidates for a closer one."""

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
"""As few as possible: a segment lasts a period of the slowest tone, so that more of them cost time
at low frequency; the variance they measure poorly is pooled over tones."""

STEP = 2
"""Tones are harmonics of 2π/T of the measuring time T this far apart: two beats, so that least
squares separates them as if each were alone."""

WEIGHT_EXPONENT = -0.5
"""Amplitudes fall with ω by this power, between equal amplitudes and equal speeds."""

TONES_MAX = 64


@dataclass(frozen=True)
class ToneChoice:
    """Harmonics of 2π/T within a window, T being the measuring time."""

    measure_s: float
    harmonics: tuple[int, ...]

    @property
    def omega_rad_s(self) -> FloatArray:
        """The tones' frequencies, rising."""
        return np.asarray(np.array(self.harmonics) * (2 * math.pi / self.measure_s))

    def excitation(self, axis: str) -> Excitation:
        """Return the request for this test."""
        weights = np.asarray(self.omega_rad_s**WEIGHT_EXPONENT)
        tones = multitone(2 * math.pi / self.measure_s, self.harmonics, weights)
        return Excitation(axis=axis, tones=tones, segments=SEGMENTS)

    def duration_s(self, spec: RobotSpec) -> float:
        """Return how long the test takes on a robot; phases do not matter for that."""
        tones = tuple(Tone(omega_rad_s=omega) for omega in self.omega_rad_s.tolist())
        return duration_s(Excitation(axis="any", tones=tones, segments=SEGMENTS), spec)


def first_look(
    band_rad_s: tuple[float, float], spec: RobotSpec, periods: int, share_of_settling: float
) -> ToneChoice:
    """Return tones over the whole band, as close as the robot's resonances can be narrow.

    A transient that takes long to settle belongs to a resonance as narrow as its decay is slow, and
    a test of such a robot costs its settling time anyway: so the measuring part lasts a share of
    it, or so many periods of the band's upper end, whichever is longer.
    """
    high = band_rad_s[1]
    wanted = share_of_settling * spec.settling_time_s * high / (2 * math.pi)
    highest = max(periods, math.ceil(wanted))
    highest += 1 - highest % 2  # odd, as the lowest is: three periods make three segments
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
    """Return candidates for a next test, without doubles.

    For each length, a multiple of `measure_s`: the whole band, on both combs of harmonics, and the
    `window_tones` harmonics around each centre.
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
            middle = min(max(centre, low + half), high - half)
            choice = _between((max(low, middle - half), min(high, middle + half)), total_s, 0)
            if choice is not None:
                found[choice] = None
    return list(found)


def _between(window_rad_s: tuple[float, float], measure_s: float, offset: int) -> ToneChoice | None:
    """Return every second harmonic in a window, from the top; none if there is none."""
    base = 2 * math.pi / measure_s
    top = math.floor(window_rad_s[1] / base * (1 + 1e-9)) - offset
    lowest = max(SEGMENTS, math.ceil(window_rad_s[0] / base * (1 + 1e-9)))
    harmonics = tuple(range(top, lowest - 1, -STEP))[::-1]
    return _up_to(window_rad_s[1], measure_s, harmonics) if harmonics else None


def _up_to(high_rad_s: float, measure_s: float, harmonics: tuple[int, ...]) -> ToneChoice:
    """Return the choice with its highest tone not above `high_rad_s`, where robots refuse.

    Rounding may put a tone that belongs on the band's edge just outside of it.
    """
    choice = ToneChoice(measure_s, harmonics)
    while choice.omega_rad_s[-1] > high_rad_s:
        choice = ToneChoice(math.nextafter(choice.measure_s, math.inf), harmonics)
    return choice
