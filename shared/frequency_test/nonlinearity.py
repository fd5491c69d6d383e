"""Whether a response is linear at a test's amplitude: harmonics, and powers of the signals."""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.quality import SILENCE, Finding, f_quantile
from nufleet.shared.frequency_test.sinusoid_fit import SinusoidFit, fit_sinusoids

HARMONIC_SIGNIFICANCE = 1e-3
HARMONIC_SCATTER_SIGNIFICANCE = 1e-2
"""Chances that noise alone makes a harmonic: against white noise, against scatter of segments."""

POWERS_EXPLAIN_MIN = 0.1
"""Powers of the signals have to predict this share of the residual of segments held out."""

DISTORTION_REPORTED = 0.01
DISTORTION_MAX = 0.2
"""What is not linear relative to the tones: reported above the first, failed above the second,
where one complex number does not describe the response any more."""


def nonlinear(distortion: float) -> Finding | None:
    """Return the finding for a ratio of what is not linear to what is."""
    if distortion <= DISTORTION_REPORTED:
        return None
    return Finding(
        code="distorted" if distortion > DISTORTION_MAX else "nonlinear",
        text=f"the response is not linear at this amplitude: {100 * distortion:.2g} % of it is "
        "distortion; repeat at half the amplitude",
    )


def harmonic_distortion(fit: SinusoidFit, tones: int, residual: FloatArray) -> float:
    """Return the amplitude of all harmonics that stand out of the noise, relative to all tones.

    A harmonic stands out when |Y_h|² > (4σ²/N) ln(1/α), and when it exceeds the scatter between
    segments too, since noise need not be white.

    Args:
        fit: the fit of the output; tones first, then harmonics.
        tones: how many of its frequencies are tones.
        residual: what the fit leaves over, shape (samples,).
    """
    power = np.abs(fit.phasors) ** 2
    linear_power = float(np.sum(power[:tones]))
    if linear_power <= SILENCE**2:
        return 0.0
    many = max(1, len(power) - tones)
    white = 4 * np.var(residual) / len(residual)
    over_white = power > white * math.log(many / HARMONIC_SIGNIFICANCE)
    significance = HARMONIC_SCATTER_SIGNIFICANCE / many
    over_scatter = power > fit.variance * f_quantile(significance, fit.scatter_degrees / 2)
    harmonic_power = float(np.sum(np.where(over_white & over_scatter, power, 0.0)[tones:]))
    return math.sqrt(harmonic_power / linear_power)


def power_distortion(
    residual: FloatArray,
    signals: tuple[FloatArray, ...],
    omega_rad_s: FloatArray,
    sample_time_s: float,
    segments: int,
) -> float:
    """Return how much of the residual squares and cubes of the signals predict, over the tones.

    With several tones most of a distortion lies between the harmonics, at sums and differences of
    the tones, where it looks like noise. What makes it is a power of a signal (Ramsey's RESET test,
    J. R. Stat. Soc. B 31, 1969); it counts when powers fitted to all other segments predict each
    segment's residual, which noise of any colour hardly allows.

    Args:
        residual: what the fit of the output leaves over, shape (samples,).
        signals: the fitted tones of the output first, then of the reference, the same shape.
        omega_rad_s: the tones.
        sample_time_s: time between samples.
        segments: number of segments of equal length.
    """
    scales = [float(np.std(signal)) for signal in signals]
    if min(scales) <= SILENCE or not residual.any():
        return 0.0
    powers = [
        (signal / scale) ** exponent
        for signal, scale in zip(signals, scales, strict=True)
        for exponent in (2, 3)
    ]
    fits = fit_sinusoids(powers, omega_rad_s, sample_time_s, segments)
    unexplained = [power - fit.fitted for power, fit in zip(powers, fits, strict=True)]
    columns = np.stack(unexplained, axis=-1).reshape(segments, -1, len(powers))
    left = residual.reshape(segments, -1)
    gram = np.einsum("pni,pnj->pij", columns, columns)
    moments = np.einsum("pni,pn->pi", columns, left)
    error = 0.0
    for p in range(segments):
        others = gram.sum(axis=0) - gram[p], moments.sum(axis=0) - moments[p]
        # The cut-off drops powers that hardly differ, as the output's and the reference's may.
        weights = np.linalg.lstsq(*others, rcond=1e-6)[0]
        error += float(np.sum((left[p] - columns[p] @ weights) ** 2))
    total = float(np.sum(left**2))
    predicted = total - error
    if predicted <= POWERS_EXPLAIN_MIN * total:
        return 0.0
    return math.sqrt(predicted / len(residual)) / scales[0]
