"""Chooses the tones of tests: a first test over the whole band, and candidates for closer ones."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.duration import duration_s
from nufleet.shared.frequency_test.excitation import AxisTones, Excitation, Tone
from nufleet.shared.frequency_test.multitone import free_of_products, interleaved, multitone
from nufleet.shared.robots.spec import RobotSpec

SEGMENTS = 3
"""Number of measuring segments, as few as possible, since each must be long enough to tell its
tones apart. The variance, which few segments measure poorly, is pooled over tones."""

SAMPLES_MIN = 256
"""Least number of measured samples of a first test, which tell the noise from the tones."""

LOW_SPACING = 1.15
"""Least ratio of neighbouring tones in a test that reaches down to the band's lower end."""

FIRST_TONES = 3
"""Number of tones per axis in the first test of several axes. Two tones are four numbers, which do
not tell the five parameters of a loop, so that further tests would be needed."""

PART_TONES = 4
"""Least number of tones at which another amplitude is compared with a first test."""

LOW_TONES = 1.5
"""Least number of tones per axis in a test of several axes that reaches down to the lower end."""

REPEATS = 7
"""Number of measuring times after which the tones of such a test repeat."""

LOWEST_TOGETHER = {1: (7,), 2: (7, 13), 3: (7, 11, 17)}
"""Harmonics of 2π / (REPEATS T) that are played at the lower end, by the number of axes that have
one there: the lowest lasts one period, and all are within a factor of 2.5. A beat or less apart,
they are told apart at the price of a larger variance, which tones as slow as these can afford: they
are the largest. Four would not be told apart any more."""

APART = 1.4
"""Least spacing of the other tones, in harmonics of 2π/T. From one on the price rises steeply."""

STEP = 2
"""Spacing of the tones, in harmonics of 2π/T, where T is the measuring time.

At a spacing of two beats, least squares separates the tones as if each were alone.
"""

WEIGHT_EXPONENT = -0.5
"""Exponent of ω in the tones' amplitudes, between equal amplitudes (0) and equal speeds (−1)."""

TONES_MAX = 64

ROUNDING = 1e-14
"""Share by which rounding moves a tone; a tone further off would take millions of smallest steps.
"""


@dataclass(frozen=True)
class ToneChoice:
    """The tones of a test: harmonics of 2π/T with the measuring time T, or of a fraction of it."""

    measure_s: float
    """Measuring time T in s."""
    harmonics: tuple[int, ...]
    """Numbers of the harmonics, rising."""
    axes: tuple[int, ...] = (0,)
    """Places of the axes that play, among those of the study, to which the tones are dealt in turn:
    the first plays the lowest tone."""
    repeats: int = 1
    """Number of measuring times after which the sum of the tones repeats."""
    share: float | None = None
    """Amplitude, as a share of the largest that the robot played; None takes that of the study."""

    @property
    def base_rad_s(self) -> float:
        """Frequency in rad/s of which the tones are harmonics."""
        return 2 * math.pi / (self.repeats * self.measure_s)

    def omegas_of(self, axis: int) -> FloatArray:
        """Return the frequencies of one axis's tones in rad/s, rising, shape (tones of the axis,).

        The array is empty if the axis does not play.
        """
        hand = dict(zip(self.axes, self._hands, strict=True)).get(axis, ())
        return np.asarray(np.array(hand) * self.base_rad_s)

    def named(self, axes: Sequence[str]) -> str:
        """Return the axes that play in words, from the names of the study's axes."""
        return " and ".join(axes[place] for place in self.axes)

    @property
    def _hands(self) -> tuple[tuple[int, ...], ...]:
        return interleaved(self.harmonics, len(self.axes))

    @property
    def omega_rad_s(self) -> FloatArray:
        """Frequencies of the tones in rad/s, rising, shape (tones,)."""
        return np.asarray(np.array(self.harmonics) * self.base_rad_s)

    def excitation(
        self, *axes: str, settle_s: float | None = None, amplitudes: Sequence[float] | None = None
    ) -> Excitation:
        """Return the excitation that plays these tones.

        Args:
            axes: Names of the study's axes.
            settle_s: Time before the measuring part; None leaves it to the robot.
            amplitudes: Peak of the reference of each axis that plays, in the order of `self.axes`
                and in the axis's unit; None leaves them to the robot.
        """
        weights = [(np.array(hand) * self.base_rad_s) ** WEIGHT_EXPONENT for hand in self._hands]
        tones = multitone(self.base_rad_s, self._hands, weights)
        peaks: Sequence[float | None] = amplitudes or [None] * len(tones)
        first, *also = (
            AxisTones(axis=axes[place], tones=own, amplitude=peak)
            for place, own, peak in zip(self.axes, tones, peaks, strict=True)
        )
        return Excitation(
            axis=first.axis,
            tones=first.tones,
            amplitude=first.amplitude,
            also=tuple(also),
            segments=SEGMENTS,
            segment_min_s=self._segment_min_s,
            settle_s=settle_s,
        )

    @property
    def _segment_min_s(self) -> float:
        # Tones of several axes may be resolved in less time than they are to be measured for.
        return self.measure_s / SEGMENTS if len(self.axes) > 1 else 0.0

    def duration_s(self, spec: RobotSpec, settle_s: float | None = None) -> float:
        """Return the duration of the test on a robot in s, which does not depend on the phases."""
        first, *also = (
            AxisTones(axis=f"axis-{place}", tones=tuple(Tone(omega_rad_s=omega) for omega in own))
            for place in self.axes
            if (own := self.omegas_of(place).tolist())
        )
        test = Excitation(
            axis=first.axis,
            tones=first.tones,
            also=tuple(also),
            segments=SEGMENTS,
            segment_min_s=self._segment_min_s,
            settle_s=settle_s,
        )
        return duration_s(test, spec)


def first_look(
    band_rad_s: tuple[float, float],
    spec: RobotSpec,
    periods: int,
    share_of_settling: float,
    axes: tuple[int, ...] = (0,),
    lowest_rad_s: float = math.inf,
    longest_s: float = math.inf,
) -> ToneChoice:
    """Return tones over the whole band, spaced as closely as the robot's resonances require.

    A resonance is as narrow as its transient is slow to decay, so a long settling time requires
    closely spaced tones, that is a long measuring time. A test of such a robot costs its settling
    time anyway. The measuring part therefore lasts a share of the settling time or a number of
    periods of the band's upper end, whichever is longer, and at least `SAMPLES_MIN` samples.
    Several axes share the tones: what resonances and samples require is lengthened by half for each
    further axis, the number of periods by half at most unless an axis would play fewer than
    `FIRST_TONES`. Where harmonics that are no products of others are too few for that, all odd ones
    are played, on which no product of second order falls.

    Args:
        band_rad_s: Lowest and highest frequency in rad/s.
        spec: Spec of the robot, with its settling time.
        periods: Least measuring time, in periods of the band's upper end.
        share_of_settling: Least measuring time, as a share of the settling time.
        axes: Places of the axes that play, among those of the study.
        lowest_rad_s: Frequency in rad/s that the axis, or the first of several, reaches down to.
        longest_s: Most that the settling time requires, in s.

    Returns:
        At most `TONES_MAX` tones per axis, for as long as the robot moves at most.

    Raises:
        InvalidInputError: The robot does not move for as long as several axes at once need.
    """
    high = band_rad_s[1]
    settling_s = min(share_of_settling * spec.settling_time_s, longest_s)
    wanted_s = max(settling_s, SAMPLES_MIN * spec.sample_time_s)
    wanted = math.ceil(wanted_s * high / (2 * math.pi))
    highest = max(periods, math.ceil(wanted * (len(axes) + 1) / 2))
    if len(axes) > 1:
        longer = max(math.ceil(1.5 * periods), _fewest_periods(band_rad_s, FIRST_TONES * len(axes)))
        highest = max(highest, longer)
    # Of more harmonics than that, every second one would be more than `TONES_MAX` per axis.
    most = STEP * TONES_MAX * len(axes)
    highest = min(highest, math.ceil(most / (1 - band_rad_s[0] / high)))
    highest = _odd(highest)
    periods_s = 2 * math.pi / high
    lengths_s = [count * periods_s for count in range(highest, 3, -2)]
    if 2 * math.pi / lowest_rad_s > highest * periods_s:
        # Robots refuse tones below their band, so that the lowest must not be rounded down.
        deepest_s = 2 * math.pi / (lowest_rad_s * (1 + 1e-9))
        if len(axes) == 1:
            # Tests of all lengths share the tone at the band's upper end, where ψ is measured.
            deepest_s = _odd(math.ceil(deepest_s / periods_s)) * periods_s
        lengths_s = [deepest_s, *lengths_s]
    for measure_s in lengths_s:
        choice = _between(band_rad_s, measure_s, 0, axes)
        if len(axes) > 1 and (choice is None or len(choice.harmonics) < FIRST_TONES * len(axes)):
            choice = _between(band_rad_s, measure_s, 0, axes, tuple)
        if (
            choice is not None
            and len(choice.harmonics) <= TONES_MAX * len(axes)
            and choice.duration_s(spec) <= spec.duration_max_s
        ):
            return choice
    if len(axes) > 1:
        raise InvalidInputError(
            f"a robot of kind {spec.kind} moves for at most {spec.duration_max_s:g} s, which is "
            f"too short for a test of {len(axes)} axes at once"
        )
    return _up_to(high, 3 * 2 * math.pi / high, (3,), axes)


def lowest_look(spec: RobotSpec, lowest_rad_s: float, first: ToneChoice) -> ToneChoice:
    """Return tones from one period of the lowest on, spaced in proportion, up to a first test's.

    Most tones belong to the first test as well, so that amplitudes are compared tone by tone.

    Args:
        spec: Spec of the robot, which may not allow a motion as long as that.
        lowest_rad_s: Frequency in rad/s that the lowest tone, whose period is the measuring time,
            must not be above.
        first: First test of the robot, of one axis, which is returned if it reaches as low.
    """
    if lowest_rad_s >= first.omega_rad_s[0]:
        return first
    # A part of the first test's base, whose harmonics are among those of its own.
    part = math.ceil(first.base_rad_s / lowest_rad_s)
    while part > 1:
        measure_s = part * first.measure_s
        shared = [part * harmonic for harmonic in first.harmonics]
        harmonics = (1, *_spaced(1, shared))
        choice = _up_to(float(first.omega_rad_s[-1]), measure_s, harmonics, first.axes)
        if choice.duration_s(spec) <= spec.duration_max_s:
            return choice
        part -= 1
    return first


def part_of(first: ToneChoice) -> ToneChoice:
    """Return the shortest test of `PART_TONES` tones that are among those of a first test.

    Args:
        first: First test, of one axis.
    """
    high_rad_s = float(first.omega_rad_s[-1])
    # Of odd harmonics, or even ones, every third, fifth … is as far apart for its shorter time.
    for part in range(first.harmonics[-1], 1, -1):
        harmonics = tuple(h // part for h in first.harmonics if h % part == 0)
        if part % 2 and len(harmonics) >= PART_TONES:
            return _up_to(high_rad_s, first.measure_s / part, harmonics, first.axes)
    return first


def _spaced(last: int, shared: Sequence[int]) -> Iterator[int]:
    """Yield harmonics above one, spaced in proportion: those that another test plays and, where
    the lowest of these is too close to one, some before the next."""

    def least(before: int) -> int:
        return max(before + STEP, math.ceil(LOW_SPACING * before))

    for following in shared:
        while last < shared[0] and following >= least(least(last)):
            last = least(last)
            yield last
        if following >= least(last):
            last = following
            yield last


def lowest_look_together(
    band_rad_s: tuple[float, float],
    spec: RobotSpec,
    lowest_rad_s: float,
    axes: tuple[int, ...],
    low: int,
) -> ToneChoice | None:
    """Return tones over the whole band, of which several axes play one at its lower end.

    Args:
        band_rad_s: Lowest and highest frequency in rad/s.
        spec: Spec of the robot.
        lowest_rad_s: Frequency in rad/s that these axes reach down to.
        axes: Places of the axes that play, among those of the study, those first that do.
        low: Number of axes that do, a key of `LOWEST_TOGETHER`.

    Returns:
        The test; None if the robot does not allow it, or the band is too narrow.
    """
    lowest, high = LOWEST_TOGETHER[low], band_rad_s[1]
    # With a tone or two on each axis, one disturbed tone would spoil the test.
    others = math.ceil(LOW_TONES * len(axes)) - low
    fewest_s = (lowest[-1] / REPEATS + (APART + STEP / REPEATS) * others) * 2 * math.pi / high
    measure_s = max(fewest_s, 2 * math.pi * lowest[-1] / (REPEATS * lowest_rad_s * (1 - 1e-9)))
    base = 2 * math.pi / (REPEATS * measure_s)
    if lowest[0] * base < band_rad_s[0]:
        return None
    harmonics = list(lowest)
    for harmonic in free_of_products(range(lowest[-1], math.floor(high / base) + 1)):
        if harmonic >= harmonics[-1] + APART * REPEATS:
            harmonics.append(harmonic)
    choice = ToneChoice(measure_s, tuple(harmonics), axes, REPEATS)
    return choice if choice.duration_s(spec) <= spec.duration_max_s else None


def closer_looks(
    band_rad_s: tuple[float, float],
    measure_s: float,
    lengths: Sequence[float],
    centres_rad_s: Sequence[float],
    window_tones: int,
    axes: tuple[int, ...] = (0,),
) -> list[ToneChoice]:
    """Return the candidates for a next test, without duplicates.

    For each length there are tests of the whole band, and one of `window_tones` harmonics per axis
    around each centre. Those of the whole band are two on one axis, on even and on odd harmonics;
    on several axes, one for each of them to play the lowest tone.

    Args:
        band_rad_s: Lowest and highest frequency in rad/s.
        measure_s: Measuring time of the first test in s.
        lengths: Measuring times of the candidates, as multiples of `measure_s`.
        centres_rad_s: Frequencies in rad/s to look at more closely.
        window_tones: Number of tones per axis around each centre.
        axes: Places of the axes that play, among those of the study.
    """
    low, high = band_rad_s
    found: dict[ToneChoice, None] = {}
    whole = [(0, turn) for turn in turns_of(axes)] if len(axes) > 1 else [(0, axes), (1, axes)]
    for length in lengths:
        total_s = length * measure_s
        base = 2 * math.pi / total_s
        for offset, turn in whole:
            choice = _between((low, high), total_s, offset, turn)
            if choice is not None and len(choice.harmonics) <= TONES_MAX * len(axes):
                found[choice] = None
        for centre in centres_rad_s:
            half = base * STEP * (window_tones * len(axes) - 1) / 2
            # A window that would reach beyond the band is moved inside it.
            middle = min(max(centre, low + half), high - half)
            choice = _between((max(low, middle - half), min(high, middle + half)), total_s, 0, axes)
            if choice is not None:
                found[choice] = None
    return list(found)


def turns_of(axes: tuple[int, ...]) -> list[tuple[int, ...]]:
    """Return the axes in each of the orders in which they can be dealt tones in turn."""
    return [axes[turn:] + axes[:turn] for turn in range(len(axes))]


def _odd(periods: int) -> int:
    """Return the least number that is odd, like the lowest harmonic, and not smaller."""
    return periods + 1 - periods % 2


def _fewest_periods(band_rad_s: tuple[float, float], tones: int) -> int:
    """Return how many periods of the band's upper end hold a number of odd harmonics."""
    low, high = band_rad_s
    highest = 1
    while len(range(highest, math.ceil(highest * low / high) - 1, -STEP)) < tones:
        highest += STEP
    return highest


def _between(
    window_rad_s: tuple[float, float],
    measure_s: float,
    offset: int,
    axes: tuple[int, ...],
    allowed: Callable[[Sequence[int]], tuple[int, ...]] = free_of_products,
) -> ToneChoice | None:
    """Return every second harmonic in a window, counted from the top; None if it has too few.

    Several axes share those that are `allowed`; a single axis may play all of them.
    """
    base = 2 * math.pi / measure_s
    top = math.floor(window_rad_s[1] / base * (1 + 1e-9)) - offset
    if len(axes) > 1:
        top -= 1 - top % 2
    lowest = max(1, math.ceil(window_rad_s[0] / base * (1 + 1e-9)))
    every = tuple(range(top, lowest - 1, -STEP)[::-1])
    harmonics = every if len(axes) == 1 else allowed(every)
    # Each segment holds a period of a single tone, which would last longer than asked for.
    if len(harmonics) < 2 and harmonics < (SEGMENTS,):
        return None
    # An axis that plays a single tone of several says little of its response over the window.
    if len(axes) > 1 and len(harmonics) < 2 * len(axes):
        return None
    return _up_to(window_rad_s[1], measure_s, harmonics, axes)


def _up_to(
    high_rad_s: float, measure_s: float, harmonics: tuple[int, ...], axes: tuple[int, ...]
) -> ToneChoice:
    """Return the choice whose highest tone is not above `high_rad_s`, where robots refuse tests.

    Rounding may put a tone at the band's edge just outside the band; the measuring time is then
    lengthened by the smallest possible steps until the tone is inside.
    """
    choice = ToneChoice(measure_s, harmonics, axes)
    excess = float(choice.omega_rad_s[-1]) / high_rad_s
    if excess > 1.0 + ROUNDING:
        choice = replace(choice, measure_s=measure_s * excess)
    while choice.omega_rad_s[-1] > high_rad_s:
        choice = replace(choice, measure_s=math.nextafter(choice.measure_s, math.inf))
    return choice
