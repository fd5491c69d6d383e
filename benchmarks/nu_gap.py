"""Comparison of the ν-gap with PyPI's `nugap`: agreement, speed, and the correct value.

Pairs are random transfer functions of order 1 to 4: continuous and sampled, stable and unstable,
near and far, some of them lightly damped. Where the results differ, arithmetic with 50 digits
decides. Every difference found until now was an error of nugap: a peak between the points of its
grid, or a large |P| that it mistakes for det(I + P2*P1) = 0. It also does not indent its contour
around poles on the axis, which no pair here has.

    python -m benchmarks.nu_gap --pairs 500 --seed 1 --json nu_gap.json

Needs `nugap` and `mpmath`.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TypeVar

import mpmath  # type: ignore[import-untyped]
import nugap
import numpy as np
from rich.console import Console
from rich.table import Table

from nufleet.shared.arrays import FloatArray
from nufleet.shared.distance.nu_gap import NuGap, nu_gap
from nufleet.shared.distance.rational_gap import RationalGap, compiled
from nufleet.shared.models.realization import transfer_function

AGREEMENT = 1e-4
DT_S = 0.05
NUGAP_POINTS = 8192  # its default
NUGAP_POINTS_MAX = 2**21

Result = TypeVar("Result")
Quotient = tuple[FloatArray, FloatArray]


@dataclass(frozen=True)
class Pair:
    """Two transfer functions and their sample time, 0 for continuous time."""

    first: Quotient
    second: Quotient
    dt_s: float


@dataclass(frozen=True)
class Comparison:
    """What three computations said of one pair, in how many seconds, and what 50 digits say."""

    compiled: NuGap
    matrices: NuGap
    nugap_value: float
    compiled_s: float
    matrices_s: float
    nugap_s: float
    nugap_accurate_s: float | None  # at the number of points that reaches `accuracy`
    winding_ok: bool | None  # None where the answers agree
    psi_at_peak: float | None


def random_pairs(rng: np.random.Generator, count: int) -> list[Pair]:
    """Draw pairs, half of them sampled, half of them near each other."""
    pairs = []
    for index in range(count):
        dt_s = DT_S if index % 2 else 0.0
        first = _quotient(rng, dt_s)
        second = _quotient(rng, dt_s)
        if index % 4 < 2:
            size = 10 ** rng.uniform(-3, -0.5)
            den = first[1] * (1 + (0.0 if dt_s else size) * rng.standard_normal(len(first[1])))
            den[0] = 1.0
            second = first[0] * (1 + size * rng.standard_normal(len(first[0]))), den
        pairs.append(Pair(first, second, dt_s))
    return pairs


def compare(pair: Pair, gap: RationalGap, repeats: int, accuracy: float | None) -> Comparison:
    """Run all three on one pair; each time is the best of `repeats`, models included."""
    (n1, d1), (n2, d2) = pair.first, pair.second
    nugap_dt = pair.dt_s or None

    def by_nugap(points: int) -> float:
        models = nugap.tf(n1, d1, nugap_dt), nugap.tf(n2, d2, nugap_dt)
        return float(nugap.nu_gap(*models, n=points))

    def by_matrices() -> NuGap:
        return nu_gap(transfer_function(n1, d1, pair.dt_s), transfer_function(n2, d2, pair.dt_s))

    compiled, compiled_s = _timed(lambda: gap(n1, d1, n2, d2, pair.dt_s), repeats)
    matrices, matrices_s = _timed(by_matrices, repeats)
    value, nugap_s = _timed(lambda: by_nugap(NUGAP_POINTS), repeats)
    agree = abs(value - compiled.value) <= AGREEMENT
    accurate_s = None
    if accuracy is not None and agree:
        points, reached, accurate_s = NUGAP_POINTS, value, nugap_s
        while abs(reached - compiled.value) > accuracy and points < NUGAP_POINTS_MAX:
            points *= 2
            reached, accurate_s = _timed(partial(by_nugap, points), 1)
    return Comparison(
        compiled,
        matrices,
        value,
        compiled_s,
        matrices_s,
        nugap_s,
        accurate_s,
        None if agree else exact_winding_ok(pair),
        None if agree else exact_psi(pair, compiled.omega_peak_rad_s),
    )


def exact_winding_ok(pair: Pair) -> bool:
    """Count the zeros of n₂~n₁ + d₂~d₁ beyond the axis with 50 digits."""
    mpmath.mp.dps = 50
    orders = [len(den) - 1 for _, den in (pair.first, pair.second)]
    (n1, d1), (n2, d2) = (
        [
            [mpmath.mpf(float(c)) for c in np.concatenate([np.zeros(order + 1 - len(p)), p])]
            for p in quotient
        ]
        for quotient, order in zip((pair.first, pair.second), orders, strict=True)
    )
    mixed = [mpmath.mpf(0)] * (sum(orders) + 1)
    for p, q in ((n2, n1), (d2, d1)):
        signs = [(-1) ** (orders[1] - i) for i in range(len(p))]
        mirrored = p[::-1] if pair.dt_s else [c * s for c, s in zip(p, signs, strict=True)]
        for i, a in enumerate(mirrored):
            for j, b in enumerate(q):
                mixed[i + j] += a * b
    while mixed[0] == 0:
        mixed = mixed[1:]
    zeros = mpmath.polyroots(mixed, maxsteps=2000, extraprec=400)
    if pair.dt_s:
        return bool(sum(abs(zero) < 1 for zero in zeros) == orders[0])
    return bool(sum(zero.real > 0 for zero in zeros) == orders[1])


def exact_psi(pair: Pair, omega_rad_s: float) -> float | None:
    """Return ψ(ω) with 50 digits, None at infinity."""
    if not np.isfinite(omega_rad_s):
        return None
    omega = mpmath.mpf(omega_rad_s)
    point = mpmath.expj(omega * mpmath.mpf(pair.dt_s)) if pair.dt_s else mpmath.mpc(0, omega)
    (a, b), (c, d) = (
        [mpmath.polyval([mpmath.mpf(float(x)) for x in p], point) for p in quotient]
        for quotient in (pair.first, pair.second)
    )
    lengths = (abs(a) ** 2 + abs(b) ** 2) * (abs(c) ** 2 + abs(d) ** 2)
    return float(abs(a * d - c * b) / mpmath.sqrt(lengths))


def summary(comparisons: list[Comparison]) -> dict[str, float | int]:
    """Return ratios of times, largest differences, and who was right where answers differ."""

    def ratios(theirs: list[float], ours: list[float]) -> dict[str, float]:
        each = np.array(theirs) / np.array(ours)
        low, middle, high = np.percentile(each, [10, 50, 90])
        return {"p10": float(low), "median": float(middle), "p90": float(high)}

    compiled = [c.compiled_s for c in comparisons]
    nugap_s = [c.nugap_s for c in comparisons]
    accurate = [c for c in comparisons if c.nugap_accurate_s is not None]
    differing = [c for c in comparisons if c.winding_ok is not None]
    result: dict[str, float | int] = {
        "pairs": len(comparisons),
        "winding_failures": sum(not c.compiled.winding_ok for c in comparisons),
        "agree_with_nugap_1e-4": len(comparisons) - len(differing),
        "differ": len(differing),
        "differ_winding_ours_right": sum(
            c.winding_ok == c.compiled.winding_ok == c.matrices.winding_ok for c in differing
        ),
        "differ_psi_error_ours_max": max(
            (abs(c.psi_at_peak - c.compiled.chordal_peak) for c in differing if c.psi_at_peak),
            default=0.0,
        ),
        "compiled_against_matrices_max": max(
            abs(c.compiled.value - c.matrices.value) for c in comparisons
        ),
        "nugap_us_median": 1e6 * float(np.median(nugap_s)),
        "compiled_us_median": 1e6 * float(np.median(compiled)),
        "matrices_us_median": 1e6 * float(np.median([c.matrices_s for c in comparisons])),
    }
    for name, values in (
        ("nugap_over_compiled", ratios(nugap_s, compiled)),
        ("nugap_over_matrices", ratios(nugap_s, [c.matrices_s for c in comparisons])),
        (
            "nugap_accurate_over_compiled",
            ratios([c.nugap_accurate_s or 0.0 for c in accurate], [c.compiled_s for c in accurate]),
        ),
    ):
        result |= {f"{name}_{quantile}": value for quantile, value in values.items()}
    return result


def _quotient(rng: np.random.Generator, dt_s: float) -> Quotient:
    order = int(rng.integers(1, 5))
    den = _polynomial(rng, order, dt_s)
    num = _polynomial(rng, int(rng.integers(0, order + 1)), dt_s)
    omega = 10 ** rng.uniform(-0.5, 1.5)
    point = np.exp(1j * omega * dt_s) if dt_s else 1j * omega
    gain = 10 ** rng.uniform(-1, 1) * abs(np.polyval(den, point) / np.polyval(num, point))
    return num * gain * rng.choice([-1.0, 1.0]), den


def _polynomial(rng: np.random.Generator, degree: int, dt_s: float) -> FloatArray:
    roots: list[complex] = []
    while len(roots) < degree:
        omega, damping = 10 ** rng.uniform(-0.5, 1.5), 10 ** rng.uniform(-2, 0)
        drawn = [complex(-omega)]
        if degree - len(roots) >= 2 and rng.random() < 0.5:
            root = omega * complex(-damping, np.sqrt(1 - damping**2))
            drawn = [root, root.conjugate()]
        flip = rng.random() < 0.25
        roots += [-root.conjugate() if flip else root for root in drawn]
    placed = np.exp(np.array(roots) * dt_s) if dt_s else np.array(roots)
    return np.atleast_1d(np.real(np.poly(placed)))


def _timed(function: Callable[[], Result], repeats: int) -> tuple[Result, float]:
    best = float("inf")
    for _ in range(repeats):
        start = time.perf_counter()
        result = function()
        best = min(best, time.perf_counter() - start)
    return result, best


def main() -> None:
    """Compare, print the table, and write the document where asked."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--repeats", type=int, default=5, help="runs of which the best is timed")
    parser.add_argument(
        "--accuracy", type=float, default=1e-6, help="accuracy for which nugap is given points"
    )
    parser.add_argument("--json", type=Path, metavar="FILE")
    arguments = parser.parse_args()
    gap = compiled()
    gap([1], [1, 1], [1], [1, 2], 0.0)  # compiled before anything is timed
    gap([1], [1, 0.5], [1], [1, 0.2], DT_S)
    pairs = random_pairs(np.random.default_rng(arguments.seed), arguments.pairs)
    result = summary([compare(pair, gap, arguments.repeats, arguments.accuracy) for pair in pairs])
    table = Table(title=f"ν-gap of {arguments.pairs} random pairs, seed {arguments.seed}")
    table.add_column("what")
    table.add_column("value", justify="right")
    for name, value in result.items():
        table.add_row(
            name.replace("_", " "), f"{value}" if isinstance(value, int) else f"{value:.3g}"
        )
    Console().print(table)
    if arguments.json is not None:
        document = {"schema": 1, "seed": arguments.seed, "accuracy": arguments.accuracy, **result}
        arguments.json.write_text(json.dumps(document, indent=2), encoding="utf-8")


if __name__ == "__main__":
    main()
