"""Several tones in one excitation, on one axis or interleaved over several, with low peaks."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Tone
from nufleet.shared.robots.joint_limits import HEADROOM, joint_share
from nufleet.shared.robots.spec import AxisSpec

PHASES_DRAWN = 100
"""Number of random choices of the phases, of which the one with the lowest peaks is played."""

DERIVATIVES = (0, 1, 2)
"""Orders of the derivatives whose peaks count: position, speed and acceleration."""

RAMP_POINTS = 9
"""Number of points of a ramp, ends and middle included, at which motions are bounded."""

SAMPLES_PER_PERIOD = 8
"""Samples per period of the fastest tone among which peaks are looked for; more would find the same
phases."""

SAMPLES_MAX = 20_000
"""Largest number of such samples; in bands of many decades, they are at random times."""


def multitone(
    base_rad_s: float, harmonics: Sequence[tuple[int, ...]], weights: Sequence[FloatArray]
) -> tuple[tuple[Tone, ...], ...]:
    """Return tones at multiples of a base frequency, with random phases of low peaks.

    Args:
        base_rad_s: Base frequency; all sums repeat after 2π / base.
        harmonics: Increasing multiples of the base frequency, one per tone, for each axis.
        weights: Relative amplitudes, positive, of shape (tones,) for each axis.

    Returns:
        The tones of each axis.
    """
    return tuple(
        tuple(
            Tone(omega_rad_s=harmonic * base_rad_s, weight=float(weight), phase_rad=float(phase))
            for harmonic, weight, phase in zip(*axis, strict=True)
        )
        for axis in zip(harmonics, weights, random_phases(harmonics, weights), strict=True)
    )


def free_of_products(harmonics: Sequence[int]) -> tuple[int, ...]:
    """Return the multiples that are no harmonic or product of low order of any others.

    They are the odd ones that contain the factor 3 an even number of times. The sum and the
    difference of two odd numbers, and twice an odd one, are even; three times a number contains the
    factor once more. So whichever of them are played, a nonlinearity of second order moves no tone,
    and a third harmonic falls on none: what one axis distorts is not taken for the response of
    another.

    Args:
        harmonics: Multiples of a base frequency, in any order.
    """
    return tuple(h for h in harmonics if h % 2 and _factors_of_three(h) % 2 == 0)


def interleaved(harmonics: Sequence[int], axes: int) -> tuple[tuple[int, ...], ...]:
    """Deal multiples out to axes in turn, so that the tones of each spread over the whole band.

    Args:
        harmonics: Increasing multiples of a base frequency, at least one per axis.
        axes: Number of axes.
    """
    return tuple(tuple(harmonics[axis::axes]) for axis in range(axes))


def largest_amplitudes(
    played: Sequence[tuple[Tone, ...]], axes: Sequence[AxisSpec], base_rad_s: float, ramp_s: float
) -> tuple[float, ...]:
    """Return amplitudes at which a robot accepts these tones together with their ramps.

    Every axis keeps its own limits, and all together keep the ellipsoids of
    `nufleet.shared.robots.joint_limits`. Short ramps of slow tones are faster than these; at
    which phase of the tones they come is not asked.

    Args:
        played: Tones of a test, for each axis that plays.
        axes: These axes with their limits.
        base_rad_s: Base frequency, after a period of which the sums of the tones repeat.
        ramp_s: Duration of each ramp, a raised cosine, in s.
    """
    omega_max_rad_s = max(tone.omega_rad_s for tones in played for tone in tones)
    samples = 2 * SAMPLES_PER_PERIOD * (int(omega_max_rad_s / base_rad_s) + 1)
    times_s = np.linspace(0.0, 2 * np.pi / base_rad_s, samples)
    orders = np.zeros((len(DERIVATIVES), samples, len(axes)))
    for n, tones in enumerate(played):
        # One tone at a time: in bands of many decades, all at once would take gigabytes.
        for tone in tones:
            wave = tone.weight * np.exp(1j * (tone.omega_rad_s * times_s + tone.phase_rad))
            for order in DERIVATIVES:
                orders[order, :, n] += (wave * (1j * tone.omega_rad_s) ** order).imag
    orders /= np.max(np.abs(orders[0]), axis=0)
    peaks = [(np.abs(v).max(axis=0), np.abs(a).max(axis=0)) for v, a in _ramped(orders, ramp_s)]
    fastest, hardest = np.max(peaks, axis=0)
    amplitudes = np.array(
        [
            min(axis.amplitude_max, axis.velocity_max / v, axis.acceleration_max / a)
            for axis, v, a in zip(axes, fastest, hardest, strict=True)
        ]
    )
    share = min(
        joint_share(v * amplitudes, a * amplitudes, axes) for v, a in _ramped(orders, ramp_s)
    )
    return tuple((HEADROOM * share * amplitudes).tolist())


def _ramped(orders: FloatArray, ramp_s: float) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield velocities and accelerations between the ramps and at each of `RAMP_POINTS` of a ramp.

    The reference is e(t) s(t), where the derivatives of the envelope e vanish between the ramps.

    Args:
        orders: The sum of tones s and its derivatives, shape (3, samples, axes).
        ramp_s: Duration of each ramp in s.

    Yields:
        Velocity and acceleration at every phase of the tones, each of shape (samples, axes).
    """
    position, velocity, acceleration = orders
    yield velocity, acceleration
    rate_1_s = math.pi / ramp_s
    for turn in np.linspace(0.0, math.pi, RAMP_POINTS):
        envelope, slope = (1 - math.cos(turn)) / 2, rate_1_s * math.sin(turn) / 2
        bend = rate_1_s**2 * math.cos(turn) / 2
        yield (
            slope * position + envelope * velocity,
            bend * position + 2 * slope * velocity + envelope * acceleration,
        )


def random_phases(
    harmonics: Sequence[tuple[int, ...]], weights: Sequence[FloatArray]
) -> tuple[FloatArray, ...]:
    """Return random phases φ, the same ones whenever these tones are asked for.

    A nonlinear robot answers to tones of random phases as to any normally distributed motion of
    the same spectrum (Pintelon and Schoukens, System Identification, 2nd ed., 2012, chapter 3), but
    only on average over many random choices. A single one is the closer to that, and the larger the
    tones may be, the lower its peaks are, of position, speed and acceleration alike: phases of a
    low peak of the position alone drive actuators into their limits. So that of many random choices
    is returned whose largest crest factor is lowest. Where several axes play, the peaks are those
    of the length of their vector.

    Args:
        harmonics: Increasing multiples h of the base frequency, one per tone, for each axis, of
            their sums Σ w sin(h t + φ).
        weights: Relative amplitudes w, positive, of shape (tones,) for each axis.

    Returns:
        Phases in rad, of shape (tones,) for each axis.
    """
    rng = np.random.default_rng([harmonic for own in harmonics for harmonic in own])
    drawn = [rng.uniform(0.0, 2 * np.pi, (PHASES_DRAWN, len(own))) for own in harmonics]
    samples = SAMPLES_PER_PERIOD * max(own[-1] for own in harmonics)
    if samples <= SAMPLES_MAX:
        times = np.linspace(0.0, 2 * np.pi, samples, endpoint=False)
    else:
        times = rng.uniform(0.0, 2 * np.pi, SAMPLES_MAX)
    turning = [np.exp(1j * np.outer(own, times)) for own in harmonics]
    crests = []
    for order in DERIVATIVES:
        squared = np.zeros((PHASES_DRAWN, len(times)))
        for own, weight, phases, waves in zip(harmonics, weights, drawn, turning, strict=True):
            phasors = weight * (1j * np.array(own)) ** order * np.exp(1j * phases)
            squared += (phasors @ waves).imag ** 2
        crests.append(squared.max(axis=1) / squared.mean(axis=1))
    lowest = int(np.argmin(np.max(crests, axis=0)))
    return tuple(phases[lowest] for phases in drawn)


def _factors_of_three(number: int) -> int:
    return 0 if number % 3 else 1 + _factors_of_three(number // 3)
