"""A transient at the frequency of a tone, which takes up most of it.

What the tone leaves of the decay is large at both ends of the record and small in the middle, so
that it does not stand out of the record read backwards. But turned back by the tone's phase, it
decays from window to window.
"""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.quality import f_quantile
from nufleet.shared.frequency_test.sinusoid_fit import exponentials

WINDOWS = 16
"""Number of windows, each of at least half a period of the tone. In a record with fewer half
periods of it, a decay is one of those that `hidden_transient` knows."""

DECAYS = np.geomspace(1.0, 16.0, 6)
DETUNED = np.pi * np.arange(-3, 4) / 2
"""Decay rates, and frequencies less the tone's, as multiples of 1 over the length of the record."""

SIGNIFICANCE = 1e-4
"""Probability that noise alone looks like a decay at any of the tones."""


def decaying_tone(
    left: FloatArray, omega_rad_s: FloatArray, step_s: float
) -> tuple[float, float] | None:
    """Return decay rate and frequency of what decays near one of the tones; None if nothing does.

    What changes at some moment, as with a payload that drops, is no decay: as many steps are tried.

    Args:
        left: Output less all that was fitted, shape (samples,).
        omega_rad_s: Frequencies of the tones, shape (tones,).
        step_s: Time between samples.
    """
    length = len(left) // WINDOWS
    tones = omega_rad_s[omega_rad_s * step_s * length >= np.pi]
    if not len(tones):
        return None
    used = length * WINDOWS
    turned = left[:used, None] * exponentials(-step_s * tones, used)
    values = turned.reshape(WINDOWS, length, -1).mean(axis=1)
    values -= values.mean(axis=0)
    energy = np.abs(_PROFILES.conj().T @ values) ** 2
    noise = np.maximum(np.sum(np.abs(values) ** 2, axis=0) - energy, 0.0) / (WINDOWS - 2)
    limit = f_quantile(SIGNIFICANCE / energy.size, WINDOWS - 2)
    best, tone = np.unravel_index(np.argmax(energy - limit * noise), energy.shape)
    if best >= DECAYS.size * DETUNED.size or energy[best, tone] <= limit * noise[best, tone]:
        return None
    decay, detuned = divmod(int(best), DETUNED.size)
    length_s = step_s * used
    omega = abs(float(tones[tone]) + float(DETUNED[detuned]) / length_s)
    return float(DECAYS[decay]) / length_s, omega


def _profiles() -> ComplexArray:
    """Return what decays, and then what steps, look like from window to window, without their mean
    and of energy 1, shape (WINDOWS, profiles)."""
    at = (np.arange(WINDOWS)[:, None] + 0.5) / WINDOWS
    rates = (1j * DETUNED - DECAYS[:, None]).ravel()
    steps = np.arange(WINDOWS)[:, None] >= np.arange(1, WINDOWS)
    profiles = np.concatenate([np.exp(at * rates), steps], axis=1)
    profiles -= profiles.mean(axis=0)
    return np.asarray(profiles / np.linalg.norm(profiles, axis=0))


_PROFILES = _profiles()
