"""The transient that the tones of a test may hide.

A part of the transient that decays within the record stands out of it, and `ring_down` finds it.
One that outlasts the record, at a frequency near a tone or below all of them, looks like that tone,
or like an offset and a drift: many decay rates σ and frequencies ν explain the record equally well,
and each of them says something else about the tones. So none is chosen here. All are averaged,
weighted by how well they explain the record (Bayesian model averaging: Hoeting et al., Statistical
Science 14, 1999), and the tones are less certain by what they would do to them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.ndimage import uniform_filter1d

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.quality import Finding
from nufleet.shared.frequency_test.ring_down import (
    PHASE_PER_BLOCK,
    SAMPLES_MAX,
    decaying,
    ringing,
)
from nufleet.shared.frequency_test.sinusoid_fit import exponentials

CERTAIN = 0.9
"""Probability of a transient from which it is a finding."""

EXPECTED = 0.5
"""Prior probability that something still rings."""

SIZE = 0.3
"""Prior standard deviation of what rings at the beginning, as a multiple of the deviation of
the output."""

DECAYS = 10
SLOWEST = 0.25
FASTEST = 20.0
"""Number of decay rates, and the least and the largest of them, per length of the record."""

HALF_PERIODS = 30
"""Largest number of half periods in the record. What rings faster than that is told from tones."""

FINE = 0.5
"""Distance of frequencies, in half periods per length of the record; or else in decay rates."""

DAMPED = 0.05
"""Damping ratio σ/ν below which a part is improbable."""

EXPLAINED = 2
"""Number of parts that are taken away before it is asked whether the rest is white noise."""

WHITE = 3.0
NEIGHBOURS = 17
"""Power of the rest over that of white noise, averaged over as many neighbouring frequencies, from
which it is no decay that the tones leave, but gusts, a drift or a change."""

TINY = 1e-12
"""Share of a part's energy, as its samples are at most 1, below which the tones leave nothing."""

NEGLIGIBLE = 1e-5
"""Weight below which a part does not count, and noise as a multiple of the output."""

RECORDS_KEPT = 8
"""Number of records of which all that does not depend on the output is kept for further robots."""


@dataclass(frozen=True)
class HiddenTransient:
    """What is believed of the transient that the tones of a test may hide."""

    probability: float
    """Probability that there is one."""
    decay_1_s: float
    """Decay rate σ that it exceeds as probably as not, if there is one."""
    omega_rad_s: float
    """Its most probable frequency ν."""
    variance: FloatArray
    """Mean square by which it moves each tone's phasor, shape (tones,), in the output's unit."""


def may_ring(hidden: HiddenTransient | None, settle_s: float) -> Finding | None:
    """Return the finding that a robot settles more slowly than the test waited; None if it did.

    Args:
        hidden: What the tones may hide of it; None if nothing is known of that.
        settle_s: Time that the test waited, after the ramp.
    """
    if hidden is None or hidden.probability < CERTAIN:
        return None
    return ringing(hidden.decay_1_s, hidden.omega_rad_s, settle_s)


def hidden_transient(
    output: FloatArray,
    omega_rad_s: FloatArray,
    tones: int,
    sample_time_s: float,
    settle_samples: int,
    found: FloatArray | None = None,
) -> HiddenTransient | None:
    """Return what the tones may hide; None if that cannot be told in a record like this.

    Args:
        output: Output while the reference consists of tones alone, that is while the robot settles
            and is measured, shape (samples,), in any unit.
        omega_rad_s: Frequencies of the tones and, after them, of their harmonics, shape (F,).
        tones: Number of tones.
        sample_time_s: Time between samples.
        settle_samples: Number of samples before those that the tones are fitted to.
        found: Transient that was found already, shape (samples, columns); None if none was.
    """
    top_rad_s = float(omega_rad_s[:tones].max())
    block = max(1, int(PHASE_PER_BLOCK / (top_rad_s * sample_time_s)))
    count = len(output) // block
    if not 4 * len(omega_rad_s) + 8 <= count <= SAMPLES_MAX:
        return None
    y = _averaged(output, block)
    size = float(np.std(y))
    # White noise, from what neighbouring samples differ by.
    white = float(np.mean(np.diff(output, 2) ** 2)) / (6 * block)
    white = max(white, (NEGLIGIBLE * size) ** 2)
    if white == 0.0:
        return None
    first = settle_samples // block
    of = (tuple(omega_rad_s.tolist()), tones, block * sample_time_s, count, first)
    grid = _kept_grid(*of) if found is None else _Grid.of(*of, _averaged(found, block))
    left = y - grid.basis @ (grid.basis.T @ y)
    noise = grid.noise(left, white)
    if noise is None:
        return None
    prior = (SIZE * size) ** 2
    # Along each direction, whitened: the data b = g a + noise, with a of variance `prior`.
    along = (left @ grid.directions).reshape(-1, 2)
    gain = prior * grid.power + noise
    log_weight = 0.5 * np.sum(
        along**2 * (prior * grid.power / gain) / noise - np.log(gain / noise), axis=1
    )
    log_weight += grid.log_prior + math.log(EXPECTED)
    largest = max(float(log_weight.max()), math.log(1 - EXPECTED))
    weight, none = np.exp(log_weight - largest), (1 - EXPECTED) * math.exp(-largest)
    probability = float(weight.sum() / (weight.sum() + none))
    weight *= probability / weight.sum()
    # Mean and variance of each part's amplitudes, and what they do to the tones.
    mean, spread = prior * np.sqrt(grid.power) * along / gain, prior * noise / gain
    moved = np.abs(np.einsum("kce,ce->kc", grid.moved, mean)) ** 2
    moved += np.einsum("kce,ce->kc", np.abs(grid.moved) ** 2, spread)
    return HiddenTransient(
        probability,
        _median(grid.decay_1_s, weight),
        float(grid.omega_rad_s[np.argmax(weight)]),
        moved @ weight,
    )


@dataclass(frozen=True, eq=False)
class _Grid:
    """All parts that a transient may have; nothing in it depends on the output."""

    basis: FloatArray
    """Orthonormal columns of tones, offset and drift, shape (count, columns)."""
    decay_1_s: FloatArray
    omega_rad_s: FloatArray
    """Decay rate σ and frequency ν of each part, shape (parts,)."""
    log_prior: FloatArray
    """Logarithm of the prior probability of each, shape (parts,)."""
    directions: FloatArray
    """What the tones leave of each part: two orthonormal columns, shape (count, 2 parts)."""
    power: FloatArray
    """Squared length of what is left along each, shape (parts, 2)."""
    moved: ComplexArray
    """By how much each of the two, if it is mistaken for tones, moves their phasors, shape (tones,
    parts, 2)."""

    @staticmethod
    def of(
        omega_rad_s: tuple[float, ...],
        tones: int,
        step_s: float,
        count: int,
        first: int,
        found: FloatArray | None = None,
    ) -> _Grid:
        length_s, frequencies = step_s * (count - 1), len(omega_rad_s)
        turning = exponentials(step_s * np.array(omega_rad_s), count)
        drift = np.linspace(0, 1, count)[:, None]
        columns = [turning.real, turning.imag, np.ones((count, 1)), drift]
        if found is not None:
            columns.append(found)
        steady = np.concatenate(columns, axis=1)
        basis = np.linalg.qr(steady)[0]
        decays, omegas, priors = [], [], []
        bin_rad_s = np.pi / length_s
        top_rad_s = min(1.2 * max(omega_rad_s[:tones]), HALF_PERIODS * bin_rad_s)
        for decay in np.geomspace(SLOWEST, FASTEST, DECAYS) / length_s:
            omega = np.arange(0.0, top_rad_s, FINE * max(decay, bin_rad_s)) + 0.1 * decay
            # Hardly damped parts, σ below `DAMPED` ν, are the less probable the less they are.
            density = np.minimum(1.0, decay / (DAMPED * omega))
            decays.append(np.full(len(omega), decay))
            omegas.append(omega)
            priors.append(density / (DECAYS * density.sum()))
        decay_1_s, of_parts = np.concatenate(decays), np.concatenate(omegas)
        parts = decaying(step_s * np.arange(count, dtype=np.float64), decay_1_s, of_parts)
        parts = parts.reshape(count, 2, -1).transpose(0, 2, 1).reshape(count, -1)
        left = (parts - basis @ (basis.T @ parts)).reshape(count, -1, 2).transpose(1, 0, 2)
        # Axes of the ellipse of what is left of a cosine and a sine.
        power, turned = np.linalg.eigh(left.transpose(0, 2, 1) @ left)
        power = np.maximum(power, TINY * count)
        directions = left @ (turned / np.sqrt(power)[:, None])
        # The tones are fitted to the measuring part alone.
        late, triangle = np.linalg.qr(steady[first:])
        theta = np.linalg.solve(triangle, late.T @ parts[first:])
        phasors = theta[:tones] - 1j * theta[frequencies : frequencies + tones]
        return _Grid(
            basis,
            decay_1_s,
            of_parts,
            np.log(np.concatenate(priors)),
            directions.transpose(1, 0, 2).reshape(count, -1),
            power,
            np.einsum("kcd,cde->kce", phasors.reshape(tones, -1, 2), turned),
        )

    def noise(self, left: FloatArray, white: float) -> float | None:
        """Return the variance of the noise in what the tones leave; None if it is not white."""
        rest = left
        for _ in range(EXPLAINED):
            along = (rest @ self.directions).reshape(-1, 2)
            most = int(np.argmax(np.sum(along**2, axis=1)))
            rest = rest - self.directions[:, 2 * most : 2 * most + 2] @ along[most]
        slowest = int(np.sum(self.decay_1_s == self.decay_1_s[0]))
        heard = np.sum((rest @ self.directions[:, : 2 * slowest]).reshape(-1, 2) ** 2, axis=1) / 2
        level = uniform_filter1d(heard, min(NEIGHBOURS, slowest), mode="nearest")
        if level.max() > WHITE * white:
            return None
        degrees = len(left) - self.basis.shape[1] - 2 * EXPLAINED
        return float(max(white, float(rest @ rest) / degrees))


_kept_grid = lru_cache(RECORDS_KEPT)(_Grid.of)


def _median(values: FloatArray, weight: FloatArray) -> float:
    """Return the value up to which half of the weight lies."""
    order = np.argsort(values)
    reached = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(reached, 0.5 * reached[-1])])


def _averaged(values: FloatArray, block: int) -> FloatArray:
    """Return the means of blocks of samples, along the first axis."""
    count = len(values) // block
    return np.asarray(values[: count * block].reshape(count, block, *values.shape[1:]).mean(axis=1))
