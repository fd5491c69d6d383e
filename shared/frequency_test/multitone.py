"""Several tones in one excitation: harmonics with phases for a low crest factor."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Tone

CLIPPING_ROUNDS = 60
SAMPLES_PER_PERIOD = 8
"""Of the fastest tone, while phases are searched; more would find the same phases."""


def multitone(
    base_rad_s: float, harmonics: tuple[int, ...], weights: FloatArray
) -> tuple[Tone, ...]:
    """Return tones at multiples of a base frequency whose sum stays low everywhere.

    Args:
        base_rad_s: base frequency; the sum repeats after 2π / base.
        harmonics: rising multiples of it.
        weights: relative amplitudes, shape (tones,), positive.
    """
    phases = low_crest_phases(harmonics, weights)
    return tuple(
        Tone(omega_rad_s=harmonic * base_rad_s, weight=float(weight), phase_rad=float(phase))
        for harmonic, weight, phase in zip(harmonics, weights, phases, strict=True)
    )


def low_crest_phases(harmonics: tuple[int, ...], weights: FloatArray) -> FloatArray:
    """Return phases φ of Σ w sin(h t + φ) that make its largest value small.

    Starts from Schroeder's phases (IEEE Trans. Inf. Theory 16, 1970) and repeats what Van der
    Ouderaa, Schoukens and Renneboog do (IEEE Trans. Instrum. Meas. 37, 1988): clip the signal, keep
    the phases of what is left. The best phases met on the way are returned.
    """
    if len(harmonics) == 1:
        return np.zeros(1)
    orders = np.array(harmonics)
    samples = SAMPLES_PER_PERIOD * int(orders[-1])
    phases = schroeder_phases(weights)
    best, best_crest = phases, np.inf
    for round_ in range(CLIPPING_ROUNDS):
        spectrum = np.zeros(samples // 2 + 1, dtype=np.complex128)
        spectrum[orders] = -0.5j * samples * weights * np.exp(1j * phases)
        signal = np.fft.irfft(spectrum, samples)
        peak = float(np.max(np.abs(signal)))
        if peak < best_crest:
            best, best_crest = phases, peak
        # Clipping less and less: a hard clip moves far, a soft one settles.
        level = peak * (0.8 + 0.19 * round_ / CLIPPING_ROUNDS)
        clipped = np.fft.rfft(np.clip(signal, -level, level))
        phases = np.angle(clipped[orders]) + np.pi / 2
    return best


def schroeder_phases(weights: FloatArray) -> FloatArray:
    """Return φ_k = −2π Σ_{l<k} (k − l) p_l with p the tones' shares of the power."""
    power = weights**2 / np.sum(weights**2)
    return np.asarray(-2 * np.pi * np.concatenate([[0.0], np.cumsum(np.cumsum(power))[:-1]]))


def crest_factor(signal: FloatArray) -> float:
    """Return the largest magnitude over the root mean square."""
    return float(np.max(np.abs(signal)) / np.sqrt(np.mean(signal**2)))
