"""The reference that puts a loop's output on a path known ahead, from a belief about its error."""

from __future__ import annotations

import numpy as np
from numpy.fft import irfft, rfft, rfftfreq

from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.error_belief import MODEL_ERROR, ErrorBelief
from nufleet.shared.models.unexplained import fast_length

_PADDING = 2.0  # settling times of rest before and after the path


def inverted(belief: ErrorBelief, desired: FloatArray) -> FloatArray:
    """Return the reference with the smallest expected squared error along a path.

    With the mean z̄(ω) of the loop's response and its variance v(ω), the expected squared error
    |1 − z̄ R|² + v |R|² of the filter R is smallest for R = z̄* / (|z̄|² + v), a Wiener filter. It
    looks ahead and back along the whole path, and asks for nothing that is not known.

    Args:
        belief: Belief about the axis.
        desired: Path, shape (samples,), in the axis's unit, from rest to rest.

    Returns:
        The reference, shape (samples,), in the axis's unit.
    """
    step_s, samples = belief.basis.sample_time_s, len(desired)
    rest = max(1, int(np.ceil(_PADDING * belief.basis.settling_time_s / step_s)))
    total = fast_length(samples + 3 * rest)
    # From the path's end back to its start, slowly, so that the period of the transform has no
    # jump.
    back = np.linspace(0.0, np.pi, total - samples - 2 * rest)
    way = desired[-1] + (desired[0] - desired[-1]) * (0.5 - 0.5 * np.cos(back))
    before, after = np.full(rest, desired[0]), np.full(rest, desired[-1])
    periodic = np.concatenate([before, desired, after, way])
    omega_rad_s = np.asarray(2 * np.pi * rfftfreq(total, step_s), dtype=np.float64)
    z, variance = belief.response(omega_rad_s)
    wrong = max(MODEL_ERROR, belief.open(float(np.std(desired))))
    variance = variance + (wrong * np.abs(1 - z)) ** 2
    filtered = rfft(periodic) * np.conj(z) / (np.abs(z) ** 2 + variance)
    return np.asarray(irfft(filtered, total)[rest : rest + samples])
