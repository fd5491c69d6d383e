"""Random linear models for tests, and exact arithmetic about them."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.linear_model import LinearModel
from nufleet.shared.models.transfer_models import StateSpace

Quotient = tuple[FloatArray, FloatArray]


def random_quotient(
    rng: np.random.Generator,
    dt_s: float = 0.0,
    unstable: float = 0.25,
    damping_min: float = 0.1,
    omega_rad_s: tuple[float, float] = (0.3, 30.0),
) -> Quotient:
    """Draw num, den of order 1 to 4 with a moderate gain somewhere in the band."""
    order = int(rng.integers(1, 5))
    den = _polynomial(rng, order, dt_s, unstable, damping_min, omega_rad_s)
    num = _polynomial(
        rng, int(rng.integers(0, order + 1)), dt_s, unstable, damping_min, omega_rad_s
    )
    omega = _log_uniform(rng, *omega_rad_s)
    point = np.exp(1j * omega * dt_s) if dt_s > 0 else 1j * omega
    gain = abs(np.polyval(num, point) / np.polyval(den, point))
    return num * float(rng.choice([-1.0, 1.0])) * _log_uniform(rng, 0.1, 10.0) / gain, den


def perturbed(rng: np.random.Generator, quotient: Quotient, size: float) -> Quotient:
    """Change every coefficient but the leading one of den by about a share `size`."""
    num, den = quotient
    change = 1 + size * rng.standard_normal(len(den))
    change[0] = 1.0
    return num * (1 + size * rng.standard_normal(len(num))), den * change


def random_state_space(
    rng: np.random.Generator, states: int, inputs: int, outputs: int, shift: float = 0.0
) -> StateSpace:
    """Draw a continuous-time model, unstable for most draws with `shift` = 0."""
    return StateSpace(
        rng.standard_normal((states, states)) - shift * np.eye(states),
        rng.standard_normal((states, inputs)),
        rng.standard_normal((outputs, states)),
        rng.choice([0.0, 0.3]) * rng.standard_normal((outputs, inputs)),
    )


def state_space(model: LinearModel) -> StateSpace:
    """Return a robot's discrete-time closed-loop model as a state-space model with n states."""
    return StateSpace(
        np.asarray(model.a),
        np.asarray(model.b)[:, None],
        np.asarray(model.c)[None, :],
        np.array([[model.d]]),
        model.sample_time_s,
    )


def exact_excess(first: Quotient, second: Quotient, dt_s: float = 0.0) -> int:
    """Return wno det(I + P₂*P₁) + η(P₁) − η(P₂) − η₀(P₂), in rational arithmetic.

    That is the number of zeros of n₂(−s) n₁(s) + d₂(−s) d₁(s) in the right half-plane, counted by
    Routh's array, less the order of the second model; z = (1 + s)/(1 − s) in discrete time.
    """
    (n1, d1), (n2, d2) = (_exact(quotient, dt_s > 0) for quotient in (first, second))
    parts = _times(_mirror(n2), n1), _times(_mirror(d2), d1)
    mixed = [a + b for a, b in zip(*parts, strict=True)]
    return _right_half_plane_zeros(mixed) - (len(d2) - 1)


def _polynomial(
    rng: np.random.Generator,
    degree: int,
    dt_s: float,
    unstable: float,
    damping_min: float,
    omega_rad_s: tuple[float, float],
) -> FloatArray:
    roots: list[complex] = []
    while len(roots) < degree:
        omega = _log_uniform(rng, *omega_rad_s)
        drawn = [complex(-omega)]
        if degree - len(roots) >= 2 and rng.random() < 0.5:
            damping = _log_uniform(rng, damping_min, 1.0)
            root = omega * complex(-damping, np.sqrt(1 - damping**2))
            drawn = [root, root.conjugate()]
        flip = rng.random() < unstable
        roots += [-root.conjugate() if flip else root for root in drawn]
    placed = np.exp(np.array(roots) * dt_s) if dt_s > 0 else np.array(roots)
    return np.atleast_1d(np.real(np.poly(placed)))


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _exact(quotient: Quotient, discrete: bool) -> tuple[list[Fraction], list[Fraction]]:
    """Return n and d, of one length, coefficients from the constant up."""
    num, den = quotient
    order = len(den) - 1
    padded = np.concatenate([np.zeros(order + 1 - len(num)), num])
    n, d = ([Fraction(float(x)) for x in p[::-1]] for p in (padded, den))
    return (_to_half_plane(n), _to_half_plane(d)) if discrete else (n, d)


def _to_half_plane(p: list[Fraction]) -> list[Fraction]:
    order = len(p) - 1
    mapped = [Fraction(0)] * (order + 1)
    for k, coefficient in enumerate(p):
        term = [coefficient]
        for factor in range(order):
            term = _times(term, [Fraction(1), Fraction(1 if factor < k else -1)])
        mapped = [a + b for a, b in zip(mapped, term, strict=True)]
    return mapped


def _times(p: list[Fraction], q: list[Fraction]) -> list[Fraction]:
    product = [Fraction(0)] * (len(p) + len(q) - 1)
    for i, a in enumerate(p):
        for j, b in enumerate(q):
            product[i + j] += a * b
    return product


def _mirror(p: list[Fraction]) -> list[Fraction]:
    return [-c if k % 2 else c for k, c in enumerate(p)]


def _right_half_plane_zeros(p: list[Fraction]) -> int:
    """Count sign changes in the first column of Routh's array; a zero there is an error."""
    degree = len(p) - 1
    falling = p[::-1]
    above, row = falling[0::2], falling[1::2]
    column = [above[0]]
    for _ in range(degree):
        row += [Fraction(0)] * (len(above) - len(row))
        column.append(row[0])
        if row[0] == 0:
            raise ZeroDivisionError("Routh's array has a zero in its first column")
        below = [above[k + 1] - above[0] / row[0] * row[k + 1] for k in range(len(row) - 1)]
        above, row = row, below
    return sum(1 for a, b in pairwise(column) if (a > 0) != (b > 0))
