"""Tests for nonlinearity at a test's amplitude, by harmonics and by powers of the signals."""

from __future__ import annotations

import math
from enum import StrEnum

import numpy as np
from scipy.special import fdtri

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.quality import SILENCE, Finding, f_quantile
from nufleet.shared.frequency_test.sinusoid_fit import SinusoidFit, exponentials, fit_sinusoids

HARMONIC_SIGNIFICANCE = 1e-3
HARMONIC_SCATTER_SIGNIFICANCE = 1e-2
"""Probabilities that noise alone passes for a harmonic: in the test against white noise, and in the
test against the scatter between segments."""

POWERS_EXPLAIN_MIN = 0.1
"""Least fraction of the residual's power in held-out segments that powers of the signals must
predict to count as distortion."""

INTERMODULATION_SIGNIFICANCE = 1e-4
BEYOND = 2.0
LINES_MIN = 3
HALF_LINE = 0.25
"""Probability that noise passes for what odd nonlinearities do; the multiple of the highest tone up
to which that is sought, and the least number of lines; a quarter of the lines' spacing."""

DISTORTION_REPORTED = 0.01
"""Ratio of the nonlinear to the linear part of the output from which distortion is reported."""


def nonlinear(distortion: float) -> Finding | None:
    """Return the finding for a ratio of the nonlinear to the linear part; None if negligible."""
    if distortion <= DISTORTION_REPORTED:
        return None
    return Finding(
        code="nonlinear",
        text=f"the response is not linear at this amplitude: {100 * distortion:.2g} % of it is "
        "distortion; repeat at half the amplitude",
        value=distortion,
    )


class Nonlinearity(StrEnum):
    """What makes a robot nonlinear, in words."""

    SATURATION = "an actuator that saturates or is slow to change"
    DEAD_ZONE = "a dead zone"
    BACKLASH = "backlash"
    FRICTION = "friction"
    HARDENING = "a spring that hardens"


def nonlinearity_of(larger: ComplexArray, smaller: ComplexArray) -> Nonlinearity | None:
    """Return which nonlinearity changes a response like this; None if that cannot be told.

    What saturates holds back large motions, mostly fast ones: they are smaller and later. What
    sticks, is slack or dead holds back small ones, as far as it acts: friction takes off amplitude
    at all frequencies, backlash delays, and a dead zone weakens the loop, so that fast motions are
    smaller and slow ones hardly overshoot. A spring that hardens holds back large slow motions.

    Args:
        larger: Response at the larger of two amplitudes, at rising frequencies, shape (tones,).
        smaller: Response at the smaller one, shape (tones,).
    """
    if len(larger) < 2:
        return None
    middle = (len(larger) + 1) // 2
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = np.log(smaller / larger)
    ratio = np.where(np.isfinite(ratio), ratio, 0.0)
    slow, fast = ratio[:middle].mean(), ratio[middle:].mean()
    if fast.real > 0 and fast.imag > 0:
        return Nonlinearity.SATURATION
    if 0 < slow.real < -fast.real:
        return Nonlinearity.DEAD_ZONE
    if slow.real < 0 and fast.real < 0:
        later = -float(ratio.imag.mean()) > -float(ratio.real.mean())
        return Nonlinearity.BACKLASH if later else Nonlinearity.FRICTION
    return Nonlinearity.HARDENING if slow.real > 0 else None


def harmonic_distortion(fit: SinusoidFit, tones: int, residual: FloatArray) -> float:
    """Return the amplitude of all significant harmonics, relative to that of all tones.

    A harmonic is significant if |Y_h|² > (4σ²/N) ln(1/α), which white noise exceeds with
    probability α, and if it also exceeds the scatter between segments, since noise need not be
    white.

    Args:
        fit: Fit of the output; the first `tones` frequencies are tones, the others harmonics.
        tones: Number of tones.
        residual: Output minus the fit, shape (samples,).

    Returns:
        Ratio of the root sums of squares, without unit.
    """
    power = np.abs(fit.phasors) ** 2
    linear_power = float(np.sum(power[:tones]))
    if linear_power <= SILENCE**2:
        return 0.0
    # Bonferroni: the significance is shared out among all harmonics tested.
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
    """Return the part of the residual that squares and cubes of the signals predict.

    With several tones most of the distortion lies between the harmonics, at sums and differences of
    the tones, where it looks like noise. It is caused by powers of the signals, so the test is
    whether these explain the residual (Ramsey's RESET test, J. R. Stat. Soc. B 31, 1969). They
    count only if powers fitted to all other segments predict each segment's residual, which hardly
    ever happens with noise of any colour.

    Args:
        residual: Output minus the fit, shape (samples,).
        signals: Fitted tones of the output, then those of the reference, each of shape (samples,).
        omega_rad_s: Frequencies of the tones, shape (tones,).
        sample_time_s: Time between samples.
        segments: Number of segments of equal length.

    Returns:
        Root mean square of the predicted part, relative to that of the output's fitted tones.
    """
    scales = [float(np.std(signal)) for signal in signals]
    if min(scales) <= SILENCE or not residual.any():
        return 0.0
    powers = [
        (signal / scale) ** exponent
        for signal, scale in zip(signals, scales, strict=True)
        for exponent in (2, 3)
    ]
    # The residual is orthogonal to tones, offset and drift; so must be what is to explain it.
    fits = fit_sinusoids(powers, omega_rad_s, sample_time_s, segments)
    unexplained = [power - fit.fitted for power, fit in zip(powers, fits, strict=True)]
    columns = np.stack(unexplained, axis=-1).reshape(segments, -1, len(powers))
    left = residual.reshape(segments, -1)
    gram = np.einsum("pni,pnj->pij", columns, columns)
    moments = np.einsum("pni,pn->pi", columns, left)
    error = 0.0
    for p in range(segments):
        others = gram.sum(axis=0) - gram[p], moments.sum(axis=0) - moments[p]
        # The cut-off drops powers that hardly differ; those of output and reference may coincide.
        weights = np.linalg.lstsq(*others, rcond=1e-6)[0]
        error += float(np.sum((left[p] - columns[p] @ weights) ** 2))
    total = float(np.sum(left**2))
    predicted = total - error
    if predicted <= POWERS_EXPLAIN_MIN * total:
        return 0.0
    return math.sqrt(predicted / len(residual)) / scales[0]


def intermodulation(fit: SinusoidFit, tones: int, residual: FloatArray, step_s: float) -> float:
    """Return what odd nonlinearities add to each tone, relative to the tones, from other lines.

    Sums and differences of three harmonics of one parity have that parity, too, so that what is
    odd in a robot (friction, backlash, saturation) falls on the tones themselves, where no single
    test tells it from a linear response, and on the lines of the same parity beyond them (Schoukens
    and Pintelon, System Identification, 2012, section 4.3). Lines of the other parity show how much
    of that is noise.

    Args:
        fit: Fit of the output; the first `tones` frequencies are tones, the others harmonics.
        tones: Number of tones.
        residual: Output minus the fit, shape (samples,).
        step_s: Time between samples.

    Returns:
        Root mean square of what falls on a line, relative to that of a tone; 0 where noise explains
        it or where the tones are not every second harmonic of a common base.
    """
    omega = np.sort(fit.omega_rad_s[:tones])
    if tones < LINES_MIN:
        return 0.0
    base = float(omega[-1] - omega[0]) / (2 * (tones - 1))
    harmonics = np.round(omega / base).astype(int)
    if np.any(np.diff(harmonics) != 2) or np.max(np.abs(omega - base * harmonics)) > 1e-3 * base:
        return 0.0
    top = min(int(BEYOND * harmonics[-1]), int(0.8 * np.pi / (step_s * base)))
    beyond = np.arange(harmonics[-1] + 1, top + 1)
    turning = exponentials(step_s * base * beyond, len(residual))
    power = np.abs(2 / len(residual) * (residual @ turning)) ** 2
    # Harmonics that were fitted are not in the residual any more.
    for place, phasor in zip(fit.omega_rad_s[tones:] / base, fit.phasors[tones:], strict=True):
        power[np.abs(beyond - place) < HALF_LINE] = np.abs(phasor) ** 2
    alike = (beyond - harmonics[-1]) % 2 == 0
    count = min(int(alike.sum()), int((~alike).sum()))
    if count < LINES_MIN:
        return 0.0
    here, noise = float(np.mean(power[alike])), float(np.mean(power[~alike]))
    if here <= noise * float(fdtri(2 * count, 2 * count, 1 - INTERMODULATION_SIGNIFICANCE)):
        return 0.0
    return math.sqrt((here - noise) / float(np.mean(np.abs(fit.phasors[:tones]) ** 2)))
