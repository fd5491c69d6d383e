"""The transient that a test leaves: what still rings after the ramp, and how slowly it decays.

After the ramp the reference consists of tones alone, so that whatever else the output does is noise
or the decay of what the ramp excited, Σ Re c e^{(−σ + jν)t}. Its slowest σ is measured for nothing,
and with σ and ν known the transient is a few more columns of the least squares that estimate the
tones. Noise does not decay: a transient has to stand out of the same record read backwards.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import uniform_filter1d
from scipy.optimize import minimize

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.quality import Finding

RATIO_MIN = 30.0
"""Power of a transient over that of the noise at its frequency from which it is believed. Noise
exceeds it with a probability of about 1e-3 in all places of a record together."""

PARTS_MAX = 4
"""Largest number of decaying oscillations that are fitted to a transient."""

DECAYS = 8
"""Number of decay rates at which a transient is sought, between that of the whole record and that
of the fastest tone."""

NEIGHBOURS = 17
"""Number of frequencies, around a transient's, whose noise it is compared with."""

PHASE_PER_BLOCK = 0.4
"""Phase in rad by which the fastest tone may turn within a block of samples that are averaged."""

NEGLIGIBLE = 1e-5
"""Fraction of the output below which a transient does not matter."""

DECAYS_UNTIL_SETTLED = 3.0
"""Number of time constants of the slowest part in a settling time, which leave 5 % of it."""

DECAYS_GONE = 7.0
"""Number of time constants after which a transient is gone."""


@dataclass(frozen=True)
class RingDown:
    """The decaying oscillations that are left when the measuring part begins, slowest first."""

    decay_1_s: FloatArray
    """Decay rates σ, shape (parts,)."""
    omega_rad_s: FloatArray
    """Frequencies ν, shape (parts,)."""

    def columns(self, samples: int, sample_time_s: float) -> FloatArray:
        """Return e^{−σt} cos νt and e^{−σt} sin νt of each part, shape (samples, 2 parts)."""
        times_s = np.arange(samples) * sample_time_s
        return _decaying(times_s, self.decay_1_s, self.omega_rad_s)


def still_ringing(found: RingDown, settle_s: float) -> Finding | None:
    """Return the finding that a robot settles more slowly than the test waited; None if it did.

    Its value is the time in s in which the slowest part decays to 5 %.

    Args:
        found: Transient that was left when the measuring part began.
        settle_s: Time that the test waited, after the ramp.
    """
    if not len(found.decay_1_s):
        return None
    settling_s = DECAYS_UNTIL_SETTLED / float(found.decay_1_s[0])
    if settling_s <= settle_s:
        return None
    return Finding(
        code="ringing",
        text=f"it needs {settling_s:.3g} s to settle to 5 %, at {found.omega_rad_s[0]:.3g} rad/s, "
        f"and the test waited {settle_s:.3g} s",
        value=settling_s,
    )


def ring_down(
    output: FloatArray, omega_rad_s: FloatArray, sample_time_s: float, settle_samples: int
) -> RingDown:
    """Find the transient in the output between the ramps of a test.

    Args:
        output: Output while the reference consists of tones alone, that is while the robot settles
            and is measured, shape (samples,), in any unit.
        omega_rad_s: Frequencies of the tones and their harmonics, shape (F,).
        sample_time_s: Time between samples.
        settle_samples: Number of samples before the measuring part.

    Returns:
        The parts of the transient that noise does not hide; none in a record that is too short.
    """
    nothing = RingDown(np.empty(0), np.empty(0))
    top = float(omega_rad_s.max())
    block = max(1, int(PHASE_PER_BLOCK / (top * sample_time_s)))
    count = len(output) // block
    if count < 4 * len(omega_rad_s) + 8:
        return nothing
    y = output[: count * block].reshape(count, block).mean(axis=1)
    times_s = np.arange(count) * (block * sample_time_s)
    size = float(np.std(y))
    if size == 0.0:
        return nothing
    phase = np.outer(times_s, omega_rad_s)
    steady = [np.cos(phase), np.sin(phase), np.ones((count, 1)), times_s[:, None] / times_s[-1]]
    basis = np.linalg.qr(np.concatenate(steady, axis=1))[0]
    found: list[tuple[float, float]] = []
    for _ in range(PARTS_MAX):
        left = y - basis @ (basis.T @ y)
        if float(np.std(left)) <= NEGLIGIBLE * size:
            break
        start = _loudest(left, times_s, 1.3 * top)
        if start is None:
            break
        decay, omega = _refined(left, basis, times_s, start)
        found.append((decay, omega))
        part = _decaying(times_s, np.array([decay]), np.array([omega]))
        part -= basis @ (basis.T @ part)
        basis = np.concatenate([basis, np.linalg.qr(part)[0]], axis=1)
    settle_s = settle_samples * sample_time_s
    late = sorted(one for one in found if one[0] * settle_s < DECAYS_GONE)
    return RingDown(np.array([decay for decay, _ in late]), np.array([omega for _, omega in late]))


def _decaying(times_s: FloatArray, decay_1_s: FloatArray, omega_rad_s: FloatArray) -> FloatArray:
    envelope = np.exp(-np.outer(times_s, decay_1_s))
    phase = np.outer(times_s, omega_rad_s)
    return np.concatenate([envelope * np.cos(phase), envelope * np.sin(phase)], axis=1)


def _loudest(left: FloatArray, times_s: FloatArray, top_rad_s: float) -> tuple[float, float] | None:
    """Return decay and frequency of what most exceeds the noise; None if nothing does."""
    step_s = times_s[1]
    bins = np.fft.rfftfreq(2 * len(left), step_s) * 2 * np.pi
    heard = bins <= top_rad_s
    white = float(np.var(left[len(left) // 2 :]))
    best, start = RATIO_MIN, None
    for decay in np.geomspace(1 / times_s[-1], max(top_rad_s, 2 / times_s[-1]), DECAYS):
        envelope = np.exp(-decay * times_s)
        energy = float(np.sum(envelope**2))
        forwards, backwards = (
            np.abs(np.fft.rfft(envelope * signal, 2 * len(left))) ** 2 / energy
            for signal in (left, left[::-1])
        )
        noise = np.maximum(uniform_filter1d(backwards, NEIGHBOURS, mode="nearest"), white)
        ratio = (forwards / np.maximum(noise, np.finfo(float).tiny))[heard]
        if ratio.max() > best:
            best, start = float(ratio.max()), (float(decay), float(bins[np.argmax(ratio)]))
    return start


def _refined(
    left: FloatArray, basis: FloatArray, times_s: FloatArray, start: tuple[float, float]
) -> tuple[float, float]:
    """Return decay and frequency that leave the least, by variable projection."""

    def unexplained(place: FloatArray) -> float:
        # Slower than this is not told from offset and drift, faster not from a single block.
        decay = float(np.clip(np.exp(place[0]), 0.3 / times_s[-1], 1 / times_s[1]))
        part = _decaying(times_s, np.array([decay]), np.array([abs(place[1])]))
        part = part - basis @ (basis.T @ part)
        weights = np.linalg.lstsq(part, left, rcond=1e-9)[0]
        return float(np.sum((left - part @ weights) ** 2))

    width = max(start[0], 2 * np.pi / times_s[-1])
    corner = np.array([np.log(start[0]), start[1]])
    simplex = corner + np.array([[0.0, 0.0], [0.7, 0.0], [0.0, 0.5 * width]])
    found = minimize(
        unexplained,
        corner,
        method="Nelder-Mead",
        options={"initial_simplex": simplex, "maxfev": 80, "xatol": 1e-3, "fatol": 0.0},
    ).x
    decay = float(np.clip(np.exp(found[0]), 0.3 / times_s[-1], 1 / times_s[1]))
    return decay, abs(float(found[1]))
