"""Several tones in one excitation, on one axis or interleaved over several, with a low crest."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Tone
from nufleet.shared.robots.joint_limits import joint_share
from nufleet.shared.robots.spec import AxisSpec

CLIPPING_ROUNDS = 60
"""Number of clipping iterations in the search for phases."""

RAMPED = 0.6
"""Share of the limits that tones may take, so that ramps, which add to them, find room."""

SAMPLES_PER_PERIOD = 8
"""Samples per period of the fastest tone during the search; more would find the same phases."""


def multitone(
    base_rad_s: float, harmonics: Sequence[tuple[int, ...]], weights: Sequence[FloatArray]
) -> tuple[tuple[Tone, ...], ...]:
    """Return tones at multiples of a base frequency, with phases that keep their peak low.

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
        for axis in zip(harmonics, weights, low_crest_phases(harmonics, weights), strict=True)
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
    played: Sequence[tuple[Tone, ...]], axes: Sequence[AxisSpec], base_rad_s: float
) -> tuple[float, ...]:
    """Return amplitudes at which a robot accepts these tones together with any ramp.

    Every axis keeps its own limits, and all together keep the ellipsoids of
    `nufleet.shared.robots.joint_limits`.

    Args:
        played: Tones of a test, for each axis that plays.
        axes: These axes with their limits.
        base_rad_s: Base frequency, after a period of which the sums of the tones repeat.
    """
    omega_max_rad_s = max(tone.omega_rad_s for tones in played for tone in tones)
    samples = 2 * SAMPLES_PER_PERIOD * (int(omega_max_rad_s / base_rad_s) + 1)
    times_s = np.linspace(0.0, 2 * np.pi / base_rad_s, samples)
    amplitudes, velocities, accelerations = [], [], []
    for tones, axis in zip(played, axes, strict=True):
        own_rad_s = np.array([tone.omega_rad_s for tone in tones])
        phases = np.array([tone.phase_rad for tone in tones])
        phasors = np.array([tone.weight for tone in tones]) * np.exp(1j * phases)
        waves = np.exp(1j * np.outer(times_s, own_rad_s))
        position, velocity, acceleration = (
            (waves @ (phasors * (1j * own_rad_s) ** order)).imag for order in range(3)
        )
        peak, *peaks = (float(np.max(np.abs(one))) for one in (position, velocity, acceleration))
        amplitude = RAMPED * min(
            axis.amplitude_max,
            axis.velocity_max * peak / peaks[0],
            axis.acceleration_max * peak / peaks[1],
        )
        amplitudes.append(amplitude)
        velocities.append(velocity * (amplitude / peak))
        accelerations.append(acceleration * (amplitude / peak))
    share = joint_share(np.array(velocities).T / RAMPED, np.array(accelerations).T / RAMPED, axes)
    return tuple(share * amplitude for amplitude in amplitudes)


def low_crest_phases(
    harmonics: Sequence[tuple[int, ...]], weights: Sequence[FloatArray]
) -> tuple[FloatArray, ...]:
    """Return phases φ that make the largest length of the vector of all axes' sums small.

    Each axis has its own sum Σ w sin(h t + φ); the length of a vector of one is its magnitude.

    The search starts from Schroeder's phases (IEEE Trans. Inf. Theory 16, 1970) and iterates the
    method of Van der Ouderaa, Schoukens and Renneboog (IEEE Trans. Instrum. Meas. 37, 1988): clip
    the signal, then give the tones the phases of the clipped signal. For several axes, the vector
    is shortened in its own direction. The best phases of all iterations are returned.

    Args:
        harmonics: Increasing multiples h of the base frequency, one per tone, for each axis.
        weights: Relative amplitudes w, positive, of shape (tones,) for each axis.

    Returns:
        Phases in rad, of shape (tones,) for each axis.
    """
    if all(len(own) == 1 for own in harmonics):
        return tuple(np.zeros(1) for _ in harmonics)
    orders = [np.array(own) for own in harmonics]
    samples = SAMPLES_PER_PERIOD * max(int(own[-1]) for own in orders)
    phases = [schroeder_phases(own) for own in weights]
    best, best_crest = phases, np.inf
    for round_ in range(CLIPPING_ROUNDS):
        signals = np.empty((len(orders), samples))
        for signal, order, weight, phase in zip(signals, orders, weights, phases, strict=True):
            spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
            # w sin(h t + φ) has the one-sided spectrum −j/2 w e^{jφ}, times the signal's length.
            spectrum[order] = -0.5j * samples * weight * np.exp(1j * phase)
            signal[:] = np.fft.irfft(spectrum, samples)
        length = np.sqrt(np.sum(signals**2, axis=0))
        peak = float(np.max(length))
        if peak < best_crest:
            best, best_crest = phases, peak
        # Clip less and less: hard clipping moves the phases far, soft clipping lets them settle.
        level = peak * (0.8 + 0.19 * round_ / CLIPPING_ROUNDS)
        bounds = level * (np.abs(signals) / np.where(length > 0, length, 1.0))
        clipped = np.fft.rfft(np.clip(signals, -bounds, bounds))
        phases = [
            np.angle(one[order]) + np.pi / 2 for one, order in zip(clipped, orders, strict=True)
        ]
    return tuple(best)


def schroeder_phases(weights: FloatArray) -> FloatArray:
    """Return Schroeder's phases φ_k = −2π Σ_{l<k} (k − l) p_l, p_l being tone l's share of power.

    Args:
        weights: Relative amplitudes, shape (tones,).

    Returns:
        Phases in rad, shape (tones,).
    """
    power = weights**2 / np.sum(weights**2)
    return np.asarray(-2 * np.pi * np.concatenate([[0.0], np.cumsum(np.cumsum(power))[:-1]]))


def _factors_of_three(number: int) -> int:
    return 0 if number % 3 else 1 + _factors_of_three(number // 3)
