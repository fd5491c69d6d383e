"""Whether a robot became another one in the middle of a test, and when.

A payload that drops or a battery that gives way changes the response at all tones at once. One fit
to the whole test then leaves a residual at every tone, which hides the change at each of them from
a look at that tone alone; a fit whose phasors may change at one moment explains nearly all of it.
"""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.quality import Finding
from nufleet.shared.frequency_test.sinusoid_fit import exponentials

MOMENTS = np.linspace(0.15, 0.85, 29)
"""Moments of the change that are tried, as shares of the measuring part."""

SLIGHT = 0.02
"""Share of the motion below which a change does no harm."""

UNEXPLAINED_RATIO = 1.5
"""Power of a residual, over that of white noise that differs as much from sample to sample, from
which there is something to explain."""

EXPLAINED_RATIO = 12.0
WHITE_RATIO = 1.25
"""Power of a residual, over what a change leaves of it, from which the change is believed; slow
noise rarely reaches half of it. Power of what is left, over that of white noise, below which the
change is believed, too, as it explains all there is to explain."""

SMOOTH_TERMS = 2
SMOOTH_EXPLAINS = 0.8
"""Number of powers of the frequency in a relative change of the response that is smooth, and the
share of what there is to explain that it must explain alone. Of a well damped robot's change it is
nearly all, of that of one with a resonance two thirds or more; of what is not linear, it is less,
mostly half or less."""


def changed_midway(
    residual: FloatArray, phasors: ComplexArray, omega_rad_s: FloatArray, step_s: float
) -> Finding | None:
    """Return the finding that the response changed at all tones at some moment.

    Args:
        residual: Output minus the fit, shape (samples,).
        phasors: Fitted phasors of the tones, shape (tones,), in the same unit.
        omega_rad_s: All fitted frequencies, the tones first, shape (F,).
        step_s: Time between samples.

    Returns:
        A finding with the code `changed`, or None.
    """
    samples, tones = len(residual), len(phasors)
    power = float(residual @ residual)
    white = float(np.mean(np.diff(residual, 2) ** 2)) / 6 if samples > 2 else 0.0
    columns = 2 * tones + 1
    if samples < 4 * columns or power <= UNEXPLAINED_RATIO * white * samples:
        return None
    turning = exponentials(step_s * omega_rad_s, samples)
    steady = np.stack([np.ones(samples), np.linspace(-1.0, 1.0, samples)], axis=1)
    basis = np.linalg.qr(np.concatenate([turning.real, turning.imag, steady], axis=1))[0]
    played, constant = turning[:, :tones], steady[:, :1]
    free = np.concatenate([played.real, played.imag, constant], axis=1)
    gained, first = _explained(residual, basis, free)
    left = power - gained
    if power <= EXPLAINED_RATIO * left and left > WHITE_RATIO * white * samples:
        return None
    relative = omega_rad_s[:tones, None] / float(omega_rad_s[:tones].max())
    alike = played @ (phasors[:, None] * relative ** np.arange(SMOOTH_TERMS))
    smooth = np.concatenate([alike.real, alike.imag, constant], axis=1)
    explained, _ = _explained(residual, basis, smooth)
    if explained <= SMOOTH_EXPLAINS * (power - white * samples):
        return None
    # A fit to the whole test meets a change half-way, or nearer to what lasts longer.
    moved = float(np.sum((played @ phasors).real ** 2))
    share = 2 * math.sqrt(gained / max(moved, np.finfo(float).tiny))
    if share <= SLIGHT:
        return None
    return Finding(
        code="changed",
        text=f"the robot changed about {first * step_s:.3g} s into the measuring part, by at least "
        f"{100 * share:.2g} % of its motion, as with a payload that drops or a battery that gives "
        "way: repeat the test",
        value=share,
    )


def _explained(residual: FloatArray, basis: FloatArray, columns: FloatArray) -> tuple[float, int]:
    """Return the most power that columns explain which begin at some moment, and that moment.

    Args:
        residual: What is to be explained, shape (samples,).
        basis: Orthonormal columns of the fit that left it, shape (samples, fitted).
        columns: Columns, of which the part before the moment is left out, shape (samples, n).

    Returns:
        Power, and the index of the first sample of the columns.
    """
    best, first = 0.0, 0
    for moment in (MOMENTS * len(residual)).astype(int).tolist():
        late = columns[moment:]
        along = basis[moment:].T @ late
        gram = late.T @ late - along.T @ along
        toward = late.T @ residual[moment:] - along.T @ (basis.T @ residual)
        power = float(toward @ np.linalg.lstsq(gram, toward, rcond=1e-6)[0])
        if power > best:
            best, first = power, moment
    return best, first
