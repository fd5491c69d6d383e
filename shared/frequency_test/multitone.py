"""Several tones in one excitation: harmonics with phases for a low crest factor."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Tone
from nufleet.shared.robots.spec import AxisSpec

CLIPPING_ROUNDS = 60
"""Number of clipping iterations in the search for phases."""

RAMPED = 0.6
"""Share of the limits that tones may take, so that ramps, which add to them, find room."""

SAMPLES_PER_PERIOD = 8
"""Samples per period of the fastest tone during the search; more would find the same phases."""


def multitone(
    base_rad_s: float, harmonics: tuple[int, ...], weights: FloatArray
) -> tuple[Tone, ...]:
    """Return tones at multiples of a base frequency, with phases that keep their sum's peak low.

    Args:
        base_rad_s: Base frequency; the sum repeats after 2π / base.
        harmonics: Increasing multiples of the base frequency, one per tone.
        weights: Relative amplitudes, positive, shape (tones,).
    """
    phases = low_crest_phases(harmonics, weights)
    return tuple(
        Tone(omega_rad_s=harmonic * base_rad_s, weight=float(weight), phase_rad=float(phase))
        for harmonic, weight, phase in zip(harmonics, weights, phases, strict=True)
    )


def largest_amplitude(tones: tuple[Tone, ...], axis: AxisSpec) -> float:
    """Return an amplitude at which a robot accepts these tones with any ramp.

    Args:
        tones: Tones of a test.
        axis: Axis with its limits.
    """
    omega = np.array([tone.omega_rad_s for tone in tones])
    phases = np.array([tone.phase_rad for tone in tones])
    phasors = np.array([tone.weight for tone in tones]) * np.exp(1j * phases)
    # The sum of harmonics repeats after a period of their base, at most half of their spacing.
    base = min([float(omega.min()), *(np.diff(np.sort(omega)) / 2).tolist()])
    samples = 2 * SAMPLES_PER_PERIOD * (int(omega.max() / base) + 1)
    times_s = np.linspace(0.0, 2 * np.pi / base, samples)
    waves = np.exp(1j * np.outer(times_s, omega))
    peak, velocity, acceleration = (
        float(np.max(np.abs((waves @ (phasors * (1j * omega) ** order)).imag)))
        for order in range(3)
    )
    return RAMPED * min(
        axis.amplitude_max,
        axis.velocity_max * peak / velocity,
        axis.acceleration_max * peak / acceleration,
    )


def low_crest_phases(harmonics: tuple[int, ...], weights: FloatArray) -> FloatArray:
    """Return phases φ of Σ w sin(h t + φ) that make its largest value small.

    The search starts from Schroeder's phases (IEEE Trans. Inf. Theory 16, 1970) and iterates the
    method of Van der Ouderaa, Schoukens and Renneboog (IEEE Trans. Instrum. Meas. 37, 1988): clip
    the signal, then give the tones the phases of the clipped signal. The best phases of all
    iterations are returned.

    Args:
        harmonics: Increasing multiples h of the base frequency, one per tone.
        weights: Relative amplitudes w, positive, shape (tones,).

    Returns:
        Phases in rad, shape (tones,).
    """
    if len(harmonics) == 1:
        return np.zeros(1)
    orders = np.array(harmonics)
    samples = SAMPLES_PER_PERIOD * int(orders[-1])
    phases = schroeder_phases(weights)
    best, best_crest = phases, np.inf
    for round_ in range(CLIPPING_ROUNDS):
        spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
        # w sin(h t + φ) has the one-sided spectrum −j/2 w e^{jφ}, times the length of the signal.
        spectrum[orders] = -0.5j * samples * weights * np.exp(1j * phases)
        signal = np.fft.irfft(spectrum, samples)
        peak = float(np.max(np.abs(signal)))
        if peak < best_crest:
            best, best_crest = phases, peak
        # Clip less and less: hard clipping moves the phases far, soft clipping lets them settle.
        level = peak * (0.8 + 0.19 * round_ / CLIPPING_ROUNDS)
        clipped = np.fft.rfft(np.clip(signal, -level, level))
        phases = np.angle(clipped[orders]) + np.pi / 2
    return best


def schroeder_phases(weights: FloatArray) -> FloatArray:
    """Return Schroeder's phases φ_k = −2π Σ_{l<k} (k − l) p_l, p_l being tone l's share of power.

    Args:
        weights: Relative amplitudes, shape (tones,).

    Returns:
        Phases in rad, shape (tones,).
    """
    power = weights**2 / np.sum(weights**2)
    return np.asarray(-2 * np.pi * np.concatenate([[0.0], np.cumsum(np.cumsum(power))[:-1]]))
