"""The ν-gap of two transfer functions, from their polynomials.

The mathematics of `nufleet.shared.distance.nu_gap` with polynomials instead of matrices. With graph
symbols (nᵢ, dᵢ), p~(s) = p(−s) and

    f = n₂~ n₁ + d₂~ d₁,   g = n₁ d₂ − n₂ d₁,   Dᵢ = |nᵢ|² + |dᵢ|²   on s = jω,

D₁D₂ = |f|² + |g|² and ψ² = |g|²/(D₁D₂). The winding condition is that f has as many zeros in the
right half-plane as d₂ has roots in total. Discrete time is mapped to the same half-plane by
z = (1 + s)/(1 − s). Nothing is divided by d, so poles on the axis need no special treatment.
"""

from __future__ import annotations

import cmath
import math
from collections.abc import Callable
from types import FunctionType

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance import polynomials
from nufleet.shared.distance.frequency_peak import Peak
from nufleet.shared.distance.nu_gap import ACCURACY, NuGap, nu_gap, verdict
from nufleet.shared.distance.polynomials import (
    in_half_plane,
    mirror_of,
    power_on_axis,
    product_of,
    roots_of,
    sum_of,
    value_at,
)
from nufleet.shared.models.realization import Polynomial, transfer_function
from nufleet.shared.models.transfer_models import HIDDEN, ON_AXIS

RationalGap = Callable[[Polynomial, Polynomial, Polynomial, Polynomial, float], NuGap]
"""A function like `rational_nu_gap`."""

_DONE, _ASK_THE_MATRICES = 0, 1
_FAILED = (_ASK_THE_MATRICES, 0.0, 0.0, 0, 0, 0, 0, 0)


def rational_nu_gap(
    num1: Polynomial, den1: Polynomial, num2: Polynomial, den2: Polynomial, dt_s: float = 0.0
) -> NuGap:
    """Return the ν-gap of num1/den1 and num2/den2, as `nu_gap` does.

    Coefficients are ordered from the highest power of s (or of z if `dt_s` > 0) down.

    Args:
        num1: Numerator of the first model.
        den1: Denominator of the first model, of no lower degree than its numerator.
        num2: Numerator of the second model.
        den2: Denominator of the second model, of no lower degree than its numerator.
        dt_s: Sample time, or 0 for continuous time.

    Raises:
        ModelError: a fraction is improper or undefined, or has a common root that is not stable.
        PeakSearchError: the models are too badly scaled for the search.
    """
    n1, d1, n2, d2 = (np.array(p, dtype=np.float64, ndmin=1) for p in (num1, den1, num2, den2))
    # Models too badly scaled for polynomials overflow, which NumPy and Python report differently.
    try:
        with np.errstate(all="ignore"):
            found = _gap(n1, d1, n2, d2, dt_s > 0)
    except ArithmeticError:
        found = _FAILED
    status, value, omega, excess, unstable1, unstable2, axis1, axis2 = found
    if status == _ASK_THE_MATRICES:
        return nu_gap(transfer_function(num1, den1, dt_s), transfer_function(num2, den2, dt_s))
    if dt_s > 0:
        omega = 2 * math.atan(omega) / dt_s
    peak = Peak(value, omega)
    return verdict(peak, excess, (unstable1, unstable2), (axis1, axis2), "polynomials")


def compiled() -> RationalGap:
    """Return `rational_nu_gap` compiled, about 25 times faster.

    It is meant for thousands of pairs: numba takes some seconds to compile it in each process.
    """
    from numba import njit

    # The compiled functions call one another, so they live in a namespace of their own.
    namespace = vars(polynomials) | globals()
    for function in [*vars(polynomials).values(), *_ARITHMETIC]:
        if isinstance(function, FunctionType):
            copy = FunctionType(function.__code__, namespace)
            namespace[function.__name__] = njit(error_model="numpy")(copy)
    entry = rational_nu_gap
    return FunctionType(entry.__code__, namespace, argdefs=entry.__defaults__)


def _poles(n: FloatArray, d: FloatArray, scale: float, discrete: bool) -> tuple[bool, int, int]:
    """Count the poles beyond and on the axis.

    The first result is False if n shares such a root, or if the roots could not be found.
    """
    found, roots = roots_of(d)
    at_zero, lost = 0, 0
    while at_zero < len(d) - 1 and d[at_zero] == 0.0:
        at_zero += 1
    lost = len(d) - 1 - at_zero - len(roots)
    # Roots at 0 and at infinity (z = 1 and z = −1) lie on the axis; n must not share them.
    fine = found and (at_zero == 0 or n[0] != 0.0) and (lost == 0 or n[-1] != 0.0)
    beyond, on = 0, at_zero + lost
    for root in roots:
        if discrete:
            instability = abs((1 + scale * root) / (1 - scale * root)) - 1
        else:
            instability = root.real * scale / max(abs(root) * scale, 1.0)
        if instability > ON_AXIS:
            beyond += 1
        elif instability >= -ON_AXIS:
            on += 1
        if instability >= -ON_AXIS:
            bound = 0.0
            for k in range(len(n) - 1, -1, -1):
                bound = bound * abs(root) + abs(n[k])
            fine = fine and abs(value_at(n, root)) > HIDDEN * bound
    return fine, beyond, on


def _distance(
    n1: FloatArray, d1: FloatArray, n2: FloatArray, d2: FloatArray, omega: float
) -> float:
    """Return ψ(ω) = |n₁d₂ − n₂d₁| / √(D₁D₂), where ω may be infinite."""
    if math.isinf(omega):
        a, b, c, d = complex(n1[-1]), complex(d1[-1]), complex(n2[-1]), complex(d2[-1])
    else:
        s = complex(0.0, omega)
        a, b, c, d = value_at(n1, s), value_at(d1, s), value_at(n2, s), value_at(d2, s)
    return abs(a * d - c * b) / (math.hypot(abs(a), abs(b)) * math.hypot(abs(c), abs(d)))


def _best(
    n1: FloatArray,
    d1: FloatArray,
    n2: FloatArray,
    d2: FloatArray,
    omegas: FloatArray,
    best: tuple[float, float],
) -> tuple[float, float]:
    """Return the larger of the best (ψ, ω) found before and the largest ψ at these frequencies."""
    for omega in omegas:
        value = _distance(n1, d1, n2, d2, omega)
        if value > best[0]:
            best = (value, omega)
    return best


def _peak(
    n1: FloatArray, d1: FloatArray, n2: FloatArray, d2: FloatArray, seeds: ComplexArray
) -> tuple[bool, float, float]:
    """Raise a level of ψ until nothing crosses it, as `find_peak` does."""
    first = np.zeros(2 * len(seeds) + 2)
    first[-1] = math.inf
    for i in range(len(seeds)):
        first[2 * i], first[2 * i + 1] = abs(seeds[i].imag), abs(seeds[i])
    best = _best(n1, d1, n2, d2, first, (-1.0, 0.0))
    # |g|² and D₁D₂ on s = jω, as polynomials of ω²; ψ equals a level where |g|² − level² D₁D₂ = 0.
    above = power_on_axis(sum_of(product_of(n1, d2), -1.0, product_of(n2, d1)))
    below = product_of(
        sum_of(power_on_axis(n1), 1.0, power_on_axis(d1)),
        sum_of(power_on_axis(n2), 1.0, power_on_axis(d2)),
    )
    around = np.empty(32)
    for _ in range(100):
        level = best[0] + ACCURACY
        found, squares = roots_of(sum_of(above, -(level**2), below))
        if not found:
            return False, best[0], best[1]
        best = _best(n1, d1, n2, d2, _with_middles(_upper_square_roots(squares)), best)
        if best[0] < level:
            # Crossings are least exact close to a peak, where two of them merge, so its
            # surroundings are evaluated once more before the search ends.
            for k in range(16):
                around[2 * k] = best[1] * (1 - 0.25 ** (k + 1))
                around[2 * k + 1] = best[1] * (1 + 0.25 ** (k + 1))
            best = _best(n1, d1, n2, d2, around, best)
            if best[0] < level:
                return True, best[0], best[1]
    return False, best[0], best[1]


def _with_middles(rising: FloatArray) -> FloatArray:
    """Return ascending numbers, the midpoints between them (the first from 0), and a larger one."""
    count = len(rising)
    omegas, previous = np.empty(2 * count + 1), 0.0
    for i in range(count):
        omegas[2 * i], omegas[2 * i + 1] = rising[i], (previous + rising[i]) / 2
        previous = rising[i]
    omegas[2 * count] = 2 * previous + 1.0
    return omegas


def _upper_square_roots(squares: ComplexArray) -> FloatArray:
    """Return Re √x in ascending order; of each complex pair only one is included."""
    rising, count = np.empty(len(squares)), 0
    for square in squares:
        if square.imag > -1e-6 * abs(square):
            root = cmath.sqrt(square).real
            place = count
            while place > 0 and rising[place - 1] > root:
                rising[place] = rising[place - 1]
                place -= 1
            rising[place] = root
            count += 1
    return rising[:count]


def _size(n: FloatArray, d: FloatArray) -> float:
    """Return the largest magnitude of a coefficient of n or d, which have the same length."""
    size = 0.0
    for k in range(len(n)):
        size = max(size, abs(n[k]), abs(d[k]))
    return size


def _trimmed(p: FloatArray) -> FloatArray:
    first = 0
    while first < len(p) and p[first] == 0.0:
        first += 1
    return p[first:]


def _gap(
    num1: FloatArray, den1: FloatArray, num2: FloatArray, den2: FloatArray, discrete: bool
) -> tuple[int, float, float, int, int, int, int, int]:
    """Return a status, sup ψ and its ω (half-plane), the excess, η(P₁), η(P₂), η₀(P₁), η₀(P₂)."""
    num1, den1, num2, den2 = _trimmed(num1), _trimmed(den1), _trimmed(num2), _trimmed(den2)
    order1, order2 = len(den1) - 1, len(den2) - 1
    if min(order1, order2) < 0 or len(num1) > len(den1) or len(num2) > len(den2):
        return _FAILED
    n1, d1 = in_half_plane(num1, order1, discrete), in_half_plane(den1, order1, discrete)
    n2, d2 = in_half_plane(num2, order2, discrete), in_half_plane(den2, order2, discrete)
    low = math.hypot(n1[0], d1[0]) * math.hypot(n2[0], d2[0])
    high = math.hypot(n1[-1], d1[-1]) * math.hypot(n2[-1], d2[-1])
    if not (0.0 < low < math.inf and 0.0 < high < math.inf):
        return _FAILED
    # Frequencies in units of the geometric mean of all corner frequencies.
    scale = (low / high) ** (1.0 / max(order1 + order2, 1))
    for n, d in ((n1, d1), (n2, d2)):
        for k in range(len(n)):
            n[k] *= scale**k
            d[k] *= scale**k
        size = _size(n, d)
        for k in range(len(n)):
            n[k] /= size
            d[k] /= size
    fine1, unstable1, axis1 = _poles(n1, d1, scale, discrete)
    fine2, unstable2, axis2 = _poles(n2, d2, scale, discrete)
    f = sum_of(product_of(mirror_of(n2), n1), 1.0, product_of(mirror_of(d2), d1))
    found, zeros = roots_of(f)
    if not (fine1 and fine2 and found):
        return _FAILED
    excess = -order2
    for zero in zeros:
        if zero.real > 0:
            excess += 1
    solved, value, omega = _peak(n1, d1, n2, d2, zeros)
    status = _DONE if solved else _ASK_THE_MATRICES
    return status, min(value, 1.0), omega * scale, excess, unstable1, unstable2, axis1, axis2


_ARITHMETIC = (
    _poles,
    _distance,
    _best,
    _peak,
    _with_middles,
    _upper_square_roots,
    _size,
    _trimmed,
    _gap,
)
"""The functions of this module that `compiled` compiles."""
