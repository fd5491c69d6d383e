"""The compiled numerics of exact Gaussian processes: Matérn 3/2 likelihood, its maximum, posterior.

All compiled functions are in this one file on purpose: numba's cache of a function notices changes
in that function's own file only, so a kernel in a second file could be called in an outdated
version.

Notation (Rasmussen & Williams, *Gaussian Processes for Machine Learning*, 2006, ch. 2 and 5):
K = σ_f² (R + jitter I) + N with R_ij = (1 + s) e^{−s}, s = √3 |x_i − x_j| / ℓ, and
N = diag(σ_n² + known noise variances). Parameters are θ = (log σ_f², log ℓ, log σ_n²);
K_i = ∂K/∂θ_i, P = K⁻¹, α = P y. The function minimised is the negative log marginal likelihood
f = ½ yᵀα + ½ log|K| + ½ n log 2π (ibid., eq. 2.30 and 5.8). Subscripts f, ℓ and n stand for the
derivatives by log σ_f², log ℓ and log σ_n². For n points, arrays have shape (n,) or (n, n); rows
are padded to whole vector registers, see `_width`.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, NamedTuple, TypeVar, cast

import numpy as np
from numba import njit
from numpy.typing import NDArray

from nufleet.shared.arrays import FloatArray
from nufleet.shared.gaussian_process.problem import FitStatus

IntArray = NDArray[np.int64]
_Function = TypeVar("_Function", bound=Callable[..., Any])

# Members of an enum are not numbers to compiled code; plain integers can be returned from it.
CONVERGED, PRECISION_LIMIT = int(FitStatus.CONVERGED), int(FitStatus.PRECISION_LIMIT)
EVALUATION_LIMIT, FAILED = int(FitStatus.EVALUATION_LIMIT), int(FitStatus.FAILED)

_LANES = 8  # rows are padded to a multiple of this: one vector register of eight doubles
_BLOCK = 64  # number of queries that share one forward substitution
_SCALED_DISTANCE_MAX = 700.0  # for a larger s, e^{−s} is a denormal number or zero
# The jitter tried after 0 fails, and the largest tried, as fractions of σ_f²; it grows tenfold.
_JITTER_FIRST, _JITTER_LAST = 1e-13, 1e-5
# Half the width of the trust region, in units of θ: 2 is a factor e² of a hyperparameter.
_RADIUS_FIRST, _RADIUS_MAX, _RADIUS_MIN = 2.0, 8.0, 1e-10
# Steps allowed after the decrease they predict has sunk below the rounding error of f. Newton's
# method converges quadratically, so the gradient, which rounds less, needs no more to vanish.
_STEPS_BELOW_ROUNDING = 4
_HALF_LOG_2PI = 0.5 * math.log(2.0 * math.pi)
_EPSILON = float(np.finfo(np.float64).eps)
_LOG2_E = 1.0 / math.log(2.0)
# log 2 in two parts (Cody and Waite). The first ends in 21 zero bits, so that k × part is exact.
_LOG_2_HIGH = float.fromhex("0x1.62e42fee00000p-1")
_LOG_2_LOW = float.fromhex("0x1.a39ef35793c76p-33")


def _compiled(function: _Function) -> _Function:
    """Compile a function that is called only from this file; products and sums may be fused.

    Sums may not be reordered. A loop is compiled to a vector and a scalar form, the alignment of
    its memory may decide which of them runs, and both must give the same numbers. (A function
    inherits its caller's `fastmath` unless it sets its own.)
    """
    return cast(_Function, njit(fastmath={"contract"}, error_model="numpy", cache=True)(function))


def _summing(function: _Function) -> _Function:
    """Compile a function whose inner loops only accumulate sums, which may be reordered."""
    fast = {"contract", "reassoc"}
    return cast(_Function, njit(fastmath=fast, error_model="numpy", cache=True)(function))


def _entry(signature: str) -> Callable[[_Function], _Function]:
    """Compile an entry point for Python: one signature, compiled on import, releasing the GIL."""

    def compile_entry(function: _Function) -> _Function:
        compiled = njit(signature, error_model="numpy", cache=True, nogil=True)(function)
        return cast(_Function, compiled)

    return compile_entry


class _Work(NamedTuple):
    """Working memory for one problem, allocated once for the largest problem of a batch."""

    distance: FloatArray  # √3 |x_i − x_j| for i < j, row by row, (n (n − 1) / 2,)
    scaled: FloatArray  # s of the same pairs, (n (n − 1) / 2,)
    decay: FloatArray  # e^{−s} of the same pairs, (n (n − 1) / 2,)
    noise: FloatArray  # the diagonal of N, (n,)
    factor: FloatArray  # U with K = UᵀU in the upper triangle; column n is z = U⁻ᵀ y; (n, width)
    factor_inverse: FloatArray  # U⁻ᵀ, lower triangle, (n, width)
    inverse: FloatArray  # P, (n + 1, width): one spare row for `_multiply`
    slope: FloatArray  # K_ℓ, (n, width)
    product: FloatArray  # P K_ℓ, (n + 1, width)
    alpha: FloatArray  # α, (width,)
    weighted: FloatArray  # N α, (width,)
    turned: FloatArray  # K_ℓ α, (width,)


@_compiled
def _width(n: int) -> int:
    """Return the row length for n columns and one of targets, rounded up to whole registers."""
    return (n + 1 + _LANES - 1) // _LANES * _LANES


@_compiled
def _allocate(n: int) -> _Work:
    pairs, width = n * (n - 1) // 2, _width(n)
    return _Work(
        np.zeros(pairs),
        np.zeros(pairs),
        np.zeros(pairs),
        np.zeros(n),
        np.zeros((n, width)),
        np.zeros((n, width)),
        np.zeros((n + 1, width)),
        np.zeros((n, width)),
        np.zeros((n + 1, width)),
        np.zeros(width),
        np.zeros(width),
        np.zeros(width),
    )


@_compiled
def _exp(x: float) -> float:
    """Return e^x for −708 < x < 709 to one unit in the last place, in a form that vectorises.

    x = k log 2 + r with |r| ≤ ½ log 2; e^r comes from its Taylor series up to r¹³, whose remainder
    is 4e-18. A call of the library's exp would keep the loops around it from being vectorised.
    """
    k = math.floor(x * _LOG2_E + 0.5)
    # Subtracting the two parts of k log 2 one after the other loses no digit of r.
    r = (x - k * _LOG_2_HIGH) - k * _LOG_2_LOW
    series = 1.0 / 6227020800.0
    series = series * r + 1.0 / 479001600.0
    series = series * r + 1.0 / 39916800.0
    series = series * r + 1.0 / 3628800.0
    series = series * r + 1.0 / 362880.0
    series = series * r + 1.0 / 40320.0
    series = series * r + 1.0 / 5040.0
    series = series * r + 1.0 / 720.0
    series = series * r + 1.0 / 120.0
    series = series * r + 1.0 / 24.0
    series = series * r + 1.0 / 6.0
    series = series * r + 0.5
    series = series * r + 1.0
    series = series * r + 1.0
    # 2^k is made from its bits: the biased exponent of a double, above 52 bits of mantissa.
    exponent = (np.int64(np.int32(k)) + 1023) << 52
    return series * np.int64(exponent).view(np.float64)


@_compiled
def _measure(work: _Work, x: FloatArray) -> None:
    """Set `work.distance` to √3 times the distances between the rows of x, shape (n, d)."""
    n, d = x.shape
    q = 0
    for i in range(n):
        for j in range(i + 1, n):
            square = 0.0
            for c in range(d):
                difference = x[i, c] - x[j, c]
                square += difference * difference
            work.distance[q] = math.sqrt(3.0 * square)
            q += 1


@_compiled
def _add_rows(
    target: FloatArray,
    i: int,
    source: FloatArray,
    weights: FloatArray,
    rows: tuple[int, int],
    columns: tuple[int, int],
    sign: float,
) -> None:
    """Add sign × Σ_k weights[k, i] source[k] to target[i], for k in `rows`, in `columns`.

    Everything cubic in n, except for one product, is done by this function. Taking four rows at a
    time saves most loads and stores of the target; `columns` begin and end at whole registers. One
    plain loop over the columns is compiled to vector code where they are known to begin at 0; loops
    over blocks of constant length never were.
    """
    first, last = rows
    four = first + (last - first) // 4 * 4
    for k in range(first, four, 4):
        c0, c1 = sign * weights[k, i], sign * weights[k + 1, i]
        c2, c3 = sign * weights[k + 2, i], sign * weights[k + 3, i]
        for j in range(columns[0], columns[1]):
            pair = c0 * source[k, j] + c1 * source[k + 1, j]
            target[i, j] += pair + c2 * source[k + 2, j] + c3 * source[k + 3, j]
    for k in range(four, last):
        c0 = sign * weights[k, i]
        for j in range(columns[0], columns[1]):
            target[i, j] += c0 * source[k, j]


@_compiled
def _cholesky(a: FloatArray, n: int, floor: float) -> bool:
    """Factorise the upper triangle of a in place, K = UᵀU, turning column n from y into U⁻ᵀ y.

    Entries left of the diagonal are scratch. Returns False if a pivot is not above `floor` times
    the diagonal entry it came from: a pivot that small could be the result of rounding alone.
    """
    width = _width(n)
    for i in range(n):
        start = i // _LANES * _LANES
        smallest = floor * a[i, i]
        # U_ij = (K_ij − Σ_{k<i} U_ki U_kj) / U_ii; the column of targets is treated like any other.
        _add_rows(a, i, a, a, (0, i), (start, width), -1.0)
        if not a[i, i] > smallest:
            return False
        scale = 1.0 / math.sqrt(a[i, i])
        for j in range(start, width):
            a[i, j] *= scale
    return True


@_compiled
def _likelihood(
    work: _Work, y: FloatArray, known: FloatArray, theta: FloatArray, jitter: float
) -> float:
    """Return f at θ, leaving U, z, s and e^{−s} in `work`; ∞ if K is not positive definite.

    `y` and `known`, the known noise variances, have shape (n,), `theta` has shape (3,).
    """
    n = len(y)
    width = _width(n)
    signal, scale, noise = math.exp(theta[0]), math.exp(-theta[1]), math.exp(theta[2])
    for q in range(n * (n - 1) // 2):
        s = min(work.distance[q] * scale, _SCALED_DISTANCE_MAX)
        work.scaled[q] = s
        work.decay[q] = _exp(-s)
    # Pair q of (i, j), i < j, row by row: offset + j, without a table of indices.
    q = 0
    for i in range(n):
        work.noise[i] = noise + known[i]
        work.factor[i, i] = signal * (1.0 + jitter) + work.noise[i]
        offset = q - i - 1
        for j in range(i + 1, n):
            work.factor[i, j] = signal * (1.0 + work.scaled[offset + j]) * work.decay[offset + j]
        q += n - 1 - i
        work.factor[i, n] = y[i]
        for j in range(n + 1, width):
            work.factor[i, j] = 0.0
    if not _cholesky(work.factor, n, n * _EPSILON):
        return np.inf
    # f = ½ yᵀα + ½ log|K| + ½ n log 2π, where ½ log|K| = Σ log U_ii and ½ yᵀα = ½ |z|².
    f = n * _HALF_LOG_2PI
    for i in range(n):
        f += math.log(work.factor[i, i]) + 0.5 * work.factor[i, n] * work.factor[i, n]
    return f if math.isfinite(f) else np.inf


@_compiled
def _invert(work: _Work, n: int) -> None:
    """Compute X = U⁻ᵀ row by row from U and z, then P = XᵀX and α = Xᵀz, all in `work`."""
    u, x, p, width = work.factor, work.factor_inverse, work.inverse, _width(n)
    for j in range(width):
        work.alpha[j] = 0.0
    for i in range(n):
        scale, z = 1.0 / u[i, i], u[i, n]
        for j in range(width):
            x[i, j] = 0.0
        _add_rows(x, i, x, u, (0, i), (0, _width(i)), -1.0)
        for j in range(i):
            x[i, j] *= scale
        x[i, i] = scale
        for j in range(i + 1):
            work.alpha[j] += z * x[i, j]
    for i in range(n):
        for j in range(width):
            p[i, j] = 0.0
        _add_rows(p, i, x, x, (i, n), (0, _width(i)), 1.0)
        for j in range(i):
            p[j, i] = p[i, j]


@_compiled
def _multiply(p: FloatArray, d: FloatArray, w: FloatArray, n: int) -> None:
    """Set w = p d, two rows of w and four of d at a time.

    Each row of d that is loaded then serves two rows of w, and each row of w that is loaded takes
    four rows of d. p and w have a spare row as the partner of the last one of an odd n.
    """
    width = _width(n)
    four = n // 4 * 4
    for i in range(0, n, 2):
        for j in range(width):
            w[i, j] = 0.0
            w[i + 1, j] = 0.0
        for k in range(0, four, 4):
            a0, a1, a2, a3 = p[i, k], p[i, k + 1], p[i, k + 2], p[i, k + 3]
            b0, b1, b2, b3 = p[i + 1, k], p[i + 1, k + 1], p[i + 1, k + 2], p[i + 1, k + 3]
            for j in range(width):
                d0, d1, d2, d3 = d[k, j], d[k + 1, j], d[k + 2, j], d[k + 3, j]
                w[i, j] += a0 * d0 + a1 * d1 + a2 * d2 + a3 * d3
                w[i + 1, j] += b0 * d0 + b1 * d1 + b2 * d2 + b3 * d3
        for k in range(four, n):
            a0, b0 = p[i, k], p[i + 1, k]
            for j in range(width):
                w[i, j] += a0 * d[k, j]
                w[i + 1, j] += b0 * d[k, j]


@_compiled
def _differentiate(work: _Work, theta: FloatArray, n: int) -> None:
    """Set `work.slope` to K_ℓ, with off-diagonal entries σ_f² s² e^{−s} and a zero diagonal."""
    signal, width, slope = math.exp(theta[0]), _width(n), work.slope
    q = 0
    for i in range(n):
        slope[i, i] = 0.0
        offset = q - i - 1
        for j in range(i + 1, n):
            s = work.scaled[offset + j]
            slope[i, j] = signal * (s * s) * work.decay[offset + j]
        q += n - 1 - i
        for j in range(n, width):
            slope[i, j] = 0.0
    for i in range(n):
        for j in range(i + 1, n):
            slope[j, i] = slope[i, j]


@_summing
def _curvature(work: _Work, n: int) -> float:
    """Return −½ αᵀK_ℓℓ α + ½ tr(P K_ℓℓ), where K_ℓℓ = (s − 2) K_ℓ entry by entry.

    Both matrices are symmetric, so the sum over i < j, doubled, cancels the factor ½.
    """
    alpha, p, slope = work.alpha, work.inverse, work.slope
    curvature = 0.0
    q = 0
    for i in range(n):
        offset = q - i - 1
        for j in range(i + 1, n):
            weight = p[i, j] - alpha[i] * alpha[j]
            curvature += weight * slope[i, j] * (work.scaled[offset + j] - 2.0)
        q += n - 1 - i
    return curvature


@_summing
def _derivatives(
    work: _Work, y: FloatArray, theta: FloatArray, gradient: FloatArray, hessian: FloatArray
) -> float:
    """Fill in the gradient and the exact Hessian of f at the θ that `_likelihood` just factorised.

    The gradient is Rasmussen & Williams' eq. 5.9 with the opposite sign; the Hessian follows by
    differentiating it once more:

        f_i = −½ αᵀK_i α + ½ tr(P K_i)
        f_ij = αᵀK_i P K_j α − ½ tr(P K_i P K_j) − ½ αᵀK_ij α + ½ tr(P K_ij)

    Since K_f = K − N and K_n = σ_n² I, every trace except those with P K_ℓ follows from P alone,
    without the cancellation that a sum over P K_f would suffer.

    Returns the sensitivity of f to rounding errors in K, |α|² + tr P per unit of error.
    """
    n = len(y)
    _invert(work, n)
    _differentiate(work, theta, n)
    noise = math.exp(theta[2])
    alpha, p, slope, product = work.alpha, work.inverse, work.slope, work.product
    _multiply(p, slope, product, n)
    for i in range(n):
        total = 0.0
        for j in range(n):
            total += slope[i, j] * alpha[j]
        work.turned[i] = total
        work.weighted[i] = work.noise[i] * alpha[i]

    p_trace = pn_trace = w_trace = 0.0  # P, P N, P K_ℓ
    pp_trace = pnp_trace = pnpn_trace = 0.0  # P P, P N P, P N P N
    wp_trace = wpn_trace = ww_trace = 0.0  # P K_ℓ P, P K_ℓ P N, P K_ℓ P K_ℓ
    alpha_f = alpha_l = alpha_alpha = 0.0  # αᵀK_f α, αᵀK_ℓ α, αᵀα
    q_ff = q_fl = q_fn = q_ll = q_ln = q_nn = 0.0  # αᵀK_i P K_j α
    for i in range(n):
        p_alpha = p_weighted = p_turned = 0.0
        pp = pnp = wp = ww = 0.0
        for j in range(n):
            p_alpha += p[i, j] * alpha[j]
            p_weighted += p[i, j] * work.weighted[j]
            p_turned += p[i, j] * work.turned[j]
            square = p[i, j] * p[i, j]
            pp += square
            pnp += square * work.noise[j]
            wp += product[i, j] * p[i, j]
        for j in range(i):
            ww += product[i, j] * product[j, i]
        p_trace += p[i, i]
        pn_trace += p[i, i] * work.noise[i]
        w_trace += product[i, i]
        pp_trace += pp
        pnp_trace += pnp
        pnpn_trace += work.noise[i] * pnp
        wp_trace += wp
        wpn_trace += work.noise[i] * wp
        ww_trace += 2.0 * ww + product[i, i] * product[i, i]
        f_alpha = y[i] - work.weighted[i]  # K_f α
        n_alpha = noise * alpha[i]  # K_n α
        alpha_f += alpha[i] * f_alpha
        alpha_l += alpha[i] * work.turned[i]
        alpha_alpha += alpha[i] * alpha[i]
        q_ff += f_alpha * (alpha[i] - p_weighted)
        q_fl += f_alpha * p_turned
        q_fn += f_alpha * noise * p_alpha
        q_ll += work.turned[i] * p_turned
        q_ln += n_alpha * p_turned
        q_nn += n_alpha * noise * p_alpha

    # P K_f = I − P N and K_f α = y − N α replace K_f throughout. Since K_f and K_n are proportional
    # to their parameters, K_ff = K_f, K_fℓ = K_ℓ and K_nn = K_n, so their second-order terms are
    # the gradient again; K_fn and K_ℓn are zero.
    gradient[0] = 0.5 * (n - pn_trace - alpha_f)
    gradient[1] = 0.5 * (w_trace - alpha_l)
    gradient[2] = 0.5 * noise * (p_trace - alpha_alpha)
    hessian[0, 0] = q_ff - 0.5 * (n - 2.0 * pn_trace + pnpn_trace) + gradient[0]
    hessian[0, 1] = q_fl - 0.5 * (w_trace - wpn_trace) + gradient[1]
    hessian[0, 2] = q_fn - 0.5 * noise * (p_trace - pnp_trace)
    hessian[1, 1] = q_ll - 0.5 * ww_trace + _curvature(work, n)
    hessian[1, 2] = q_ln - 0.5 * noise * wp_trace
    hessian[2, 2] = q_nn - 0.5 * noise * noise * pp_trace + gradient[2]
    hessian[1, 0], hessian[2, 0], hessian[2, 1] = hessian[0, 1], hessian[0, 2], hessian[1, 2]
    return alpha_alpha + p_trace


@_compiled
def _condense(gradient: FloatArray, hessian: FloatArray, face: FloatArray, out: FloatArray) -> None:
    """Write into `out` (3, 4) the equations of the stationary point on a face of the box.

    They are H p = −g in the free components of p and p_i = face_i in the fixed ones; the fixed
    ones are moved to the right-hand side, column 3, so that the system stays symmetric.
    """
    for i in range(3):
        for j in range(3):
            out[i, j] = 1.0 if i == j else 0.0
        out[i, 3] = face[i]
        if math.isnan(face[i]):
            out[i, 3] = -gradient[i]
            for j in range(3):
                if math.isnan(face[j]):
                    out[i, j] = hessian[i, j]
                else:
                    out[i, 3] -= hessian[i, j] * face[j]


@_compiled
def _solve_definite(system: FloatArray) -> bool:
    """Solve three equations in place, the solution replacing column 3.

    Returns False if the matrix is not positive definite, which Gaussian elimination without
    pivoting shows by a pivot that is not positive.
    """
    for k in range(3):
        if not system[k, k] > 0.0:
            return False
        for i in range(k + 1, 3):
            ratio = system[i, k] / system[k, k]
            for j in range(k + 1, 4):
                system[i, j] -= ratio * system[k, j]
    for i in range(2, -1, -1):
        for j in range(i + 1, 3):
            system[i, 3] -= system[i, j] * system[j, 3]
        system[i, 3] /= system[i, i]
    return True


@_compiled
def _model(gradient: FloatArray, hessian: FloatArray, system: FloatArray) -> float:
    """Return the quadratic model gᵀp + ½ pᵀHp at the step p in column 3 of `system`."""
    model = 0.0
    for i in range(3):
        bent = 0.0
        for j in range(3):
            bent += hessian[i, j] * system[j, 3]
        model += (gradient[i] + 0.5 * bent) * system[i, 3]
    return model


@_compiled
def _name_face(number: int, low: FloatArray, high: FloatArray, face: FloatArray) -> bool:
    """Set face_i to the bound that digit i of `number` (base 3) selects; NaN means free.

    Returns False if the box has no thickness in some direction and the digit would select its only
    side a second time.
    """
    for i in range(3):
        digit = number // 3**i % 3
        if low[i] == high[i]:
            if digit > 0:
                return False
            face[i] = low[i]
        else:
            face[i] = np.nan if digit == 0 else (low[i] if digit == 1 else high[i])
    return True


@_compiled
def _box_minimum(
    gradient: FloatArray, hessian: FloatArray, low: FloatArray, high: FloatArray, step: FloatArray
) -> float:
    """Set `step` to the global minimum of the quadratic model over a box; return the model there.

    A minimum lies inside one of the 27 faces of the box (interior, sides, edges, corners), and the
    model is convex on that face. Solving the model on every face is therefore exact even for an
    indefinite Hessian. Face 0 is the interior: a minimum there is the global one, since it exists
    only if the whole Hessian is positive definite.
    """
    face, system = np.empty(3), np.empty((3, 4))
    best = np.inf
    for number in range(27):
        if number == 1 and best < np.inf:
            break
        if not _name_face(number, low, high, face):
            continue
        _condense(gradient, hessian, face, system)
        if not _solve_definite(system):
            continue
        inside = True
        for i in range(3):
            inside = inside and low[i] <= system[i, 3] <= high[i]
        if inside:
            model = _model(gradient, hessian, system)
            if model < best:
                best = model
                for i in range(3):
                    step[i] = system[i, 3]
    return best


@_compiled
def _factorise(
    work: _Work, y: FloatArray, known: FloatArray, theta: FloatArray, jitter: float
) -> tuple[float, float]:
    """Return f at θ and the jitter used: the given one or, if K is indefinite, larger ones.

    The jitter is raised by factors of ten up to `_JITTER_LAST`; if that fails too, f is ∞.
    """
    while True:
        value = _likelihood(work, y, known, theta, jitter)
        if value < np.inf or jitter >= _JITTER_LAST:
            return value, jitter
        jitter = max(10.0 * jitter, _JITTER_FIRST)


@_compiled
def _projected_gradient(
    derivatives: tuple[FloatArray, FloatArray], theta: FloatArray, bounds: FloatArray
) -> float:
    """Return the largest component of |θ − clip(θ − g)|: zero exactly at a stationary point.

    It is infinite if a derivative has overflowed.
    """
    gradient, hessian = derivatives
    largest = 0.0
    for i in range(3):
        if not math.isfinite(gradient[i] + hessian[i, 0] + hessian[i, 1] + hessian[i, 2]):
            return np.inf
        if bounds[0, i] < bounds[1, i]:
            # Descent moves against the gradient, towards the lower bound if it is positive.
            room = theta[i] - bounds[0, i] if gradient[i] > 0.0 else bounds[1, i] - theta[i]
            largest = max(largest, min(abs(gradient[i]), room))
    return largest


@_compiled
def _try_step(
    theta: FloatArray,
    bounds: FloatArray,
    derivatives: tuple[FloatArray, FloatArray],
    radius: float,
    trial: FloatArray,
) -> tuple[float, float]:
    """Set `trial` to the minimum of the quadratic model within the bounds and the radius around θ.

    Returns the decrease of f that the model predicts, and the largest component of the step.
    """
    low, high, step = np.empty(3), np.empty(3), np.empty(3)
    for i in range(3):
        fixed = bounds[0, i] == bounds[1, i]
        low[i] = 0.0 if fixed else max(bounds[0, i] - theta[i], -radius)
        high[i] = 0.0 if fixed else min(bounds[1, i] - theta[i], radius)
    predicted = -_box_minimum(derivatives[0], derivatives[1], low, high, step)
    length = 0.0
    for i in range(3):
        length = max(length, abs(step[i]))
        trial[i] = min(max(theta[i] + step[i], bounds[0, i]), bounds[1, i])
    return predicted, length


@_compiled
def _next_radius(radius: float, ratio: float, length: float) -> float:
    """Return the next radius of the trust region.

    It shrinks if f decreased by much less than predicted (`ratio` of actual to predicted), and
    grows if the model was accurate and the radius is what limited the step.
    """
    if ratio < 0.25:
        return 0.25 * length
    if ratio > 0.75 and length > 0.99 * radius:
        return min(2.0 * radius, _RADIUS_MAX)
    return radius


@_compiled
def _minimise(
    work: _Work,
    y: FloatArray,
    known: FloatArray,
    theta: FloatArray,
    bounds: FloatArray,
    tolerance: float,
    evaluations_max: int,
) -> tuple[float, float, float, int, int]:
    """Minimise f from θ, in place; return f, projected gradient, jitter, evaluations and status.

    The method is Newton's in a trust region (Conn, Gould & Toint, *Trust-Region Methods*, 2000,
    ch. 6 and 12). The region is a box like the bounds, so each step is the exact minimum of the
    model within both. The rounding error of f is added to both the actual and the predicted
    decrease before they are compared (ibid., section 17.4.2).
    """
    trial, derivatives = np.empty(3), (np.empty(3), np.empty((3, 3)))
    value, jitter = _factorise(work, y, known, theta, 0.0)
    if value == np.inf:
        return value, np.inf, jitter, 1, FAILED
    evaluations, below_rounding, radius = 1, 0, _RADIUS_FIRST
    sensitivity, stale = 0.0, True
    while True:
        if stale:
            sensitivity = _derivatives(work, y, theta, derivatives[0], derivatives[1])
        residual = _projected_gradient(derivatives, theta, bounds)
        if residual <= tolerance:
            return value, residual, jitter, evaluations, CONVERGED
        # The values of f can no longer tell a better point from a worse one.
        blind = residual == np.inf or below_rounding > _STEPS_BELOW_ROUNDING
        if blind or radius < _RADIUS_MIN:
            return value, residual, jitter, evaluations, PRECISION_LIMIT
        if evaluations >= evaluations_max:
            return value, residual, jitter, evaluations, EVALUATION_LIMIT
        predicted, length = _try_step(theta, bounds, derivatives, radius, trial)
        attempt = _likelihood(work, y, known, trial, jitter)
        evaluations += 1
        # Errors of f itself, and of entries of K (ε σ_f² each) times the sensitivity of f to them.
        rounding = 4.0 * _EPSILON * (max(1.0, abs(value)) + math.exp(theta[0]) * sensitivity)
        below_rounding += predicted < rounding
        ratio = (value - attempt + rounding) / (predicted + rounding)
        radius = _next_radius(radius, ratio, length)
        stale = True
        # A decrease far below the prediction is accepted too; the next region is smaller then.
        if ratio > 1e-4:
            value = attempt
            for i in range(3):
                theta[i] = trial[i]
        elif radius < _RADIUS_MIN and attempt == np.inf and jitter < _JITTER_LAST:
            # Every descent step ends where K cannot be factorised; more jitter moves that edge.
            value, jitter = _factorise(work, y, known, theta, max(10.0 * jitter, _JITTER_FIRST))
            radius = _RADIUS_FIRST
        else:
            # The step was rejected and θ is unchanged, so its derivatives are still valid.
            stale = False


@_compiled
def _largest(offsets: IntArray, first: int, last: int) -> int:
    largest = 0
    for problem in range(first, last):
        largest = max(largest, offsets[problem + 1] - offsets[problem])
    return largest


_BATCH = "float64[:, ::1], float64[::1], float64[::1], int64[::1], int64, int64"


@_entry(
    f"void({_BATCH}, float64[:, :, ::1], float64[:, ::1], float64, int64, "
    "float64[:, ::1], float64[:, ::1], int64[:, ::1])"
)
def fit_range(
    x: FloatArray,
    y: FloatArray,
    known: FloatArray,
    offsets: IntArray,
    first: int,
    last: int,
    starts: FloatArray,
    bounds: FloatArray,
    tolerance: float,
    evaluations_max: int,
    theta: FloatArray,
    outcomes: FloatArray,
    counts: IntArray,
) -> None:
    """Fit problems `first` to `last` − 1 from each of their starts and keep the best maximum.

    Args:
        x: Inputs of all problems, shape (rows, d), in any unit.
        y: Targets, shape (rows,).
        known: Known noise variances, shape (rows,), in the targets' unit squared.
        offsets: Row boundaries, shape (problems + 1,); problem p owns rows offsets[p] to
            offsets[p + 1] − 1.
        first: Index of the first problem to fit.
        last: Index after the last problem to fit.
        starts: θ at each start, shape (starts, problems, 3).
        bounds: Least and greatest θ, shape (2, 3).
        tolerance: Projected gradient in θ at which a search has converged.
        evaluations_max: Limit on evaluations of the likelihood per problem and start.
        theta: Output, shape (problems, 3): θ at the maximum.
        outcomes: Output, shape (problems, 3): log marginal likelihood, projected gradient, jitter.
        counts: Output, shape (problems, 2): evaluations over all starts, and the `FitStatus`.
    """
    work = _allocate(_largest(offsets, first, last))
    point = np.empty(3)
    for problem in range(first, last):
        rows = slice(offsets[problem], offsets[problem + 1])
        _measure(work, x[rows])
        counts[problem, 0] = 0
        for start in range(len(starts)):
            for i in range(3):
                point[i] = min(max(starts[start, problem, i], bounds[0, i]), bounds[1, i])
            value, residual, jitter, evaluations, status = _minimise(
                work, y[rows], known[rows], point, bounds, tolerance, evaluations_max
            )
            counts[problem, 0] += evaluations
            # Strictly greater, so that the first of equal maxima is kept.
            if start == 0 or -value > outcomes[problem, 0]:
                outcomes[problem, 0] = -value
                outcomes[problem, 1] = residual
                outcomes[problem, 2] = jitter
                counts[problem, 1] = status
                for i in range(3):
                    theta[problem, i] = point[i]


@_entry(f"void({_BATCH}, float64[:, ::1], float64[::1], float64[:, ::1])")
def likelihood_range(
    x: FloatArray,
    y: FloatArray,
    known: FloatArray,
    offsets: IntArray,
    first: int,
    last: int,
    theta: FloatArray,
    value: FloatArray,
    gradient: FloatArray,
) -> None:
    """Compute log marginal likelihoods and their gradients for problems `first` to `last` − 1.

    Args:
        x: Inputs of all problems, shape (rows, d).
        y: Targets, shape (rows,).
        known: Known noise variances, shape (rows,).
        offsets: Row boundaries of the problems, shape (problems + 1,).
        first: Index of the first problem.
        last: Index after the last problem.
        theta: θ of each problem, shape (problems, 3).
        value: Output, shape (problems,): log p(y | x, θ); −∞ if no jitter makes K definite.
        gradient: Output, shape (problems, 3): its gradient in θ; 0 where `value` is −∞.
    """
    work = _allocate(_largest(offsets, first, last))
    slope, hessian = np.empty(3), np.empty((3, 3))
    for problem in range(first, last):
        rows = slice(offsets[problem], offsets[problem + 1])
        _measure(work, x[rows])
        outcome = _factorise(work, y[rows], known[rows], theta[problem], 0.0)
        value[problem] = -outcome[0]
        gradient[problem] = 0.0
        if outcome[0] < np.inf:
            _derivatives(work, y[rows], theta[problem], slope, hessian)
            for i in range(3):
                gradient[problem, i] = -slope[i]


@_compiled
def _predict_block(
    work: _Work,
    x: FloatArray,
    theta: FloatArray,
    queries: FloatArray,
    cross: FloatArray,
    mean: FloatArray,
    variance: FloatArray,
) -> None:
    """Predict at up to `_BLOCK` queries, shape (d, lanes), given U and z in `work`.

    V = U⁻ᵀ K(x, queries) is found by forward substitution in `cross` (n, _BLOCK), for all lanes at
    once. The mean is Vᵀz and the latent variance σ_f² − |V|² (Rasmussen & Williams, algorithm 2.1).
    """
    d, lanes = queries.shape
    signal, scale = math.exp(theta[0]), math.exp(-theta[1])
    whole = (lanes + _LANES - 1) // _LANES * _LANES
    for b in range(lanes):
        mean[b], variance[b] = 0.0, signal
    for i in range(len(x)):
        for b in range(whole):
            cross[i, b] = 0.0
        for c in range(d):
            for b in range(lanes):
                difference = queries[c, b] - x[i, c]
                cross[i, b] += difference * difference
        for b in range(lanes):
            s = min(math.sqrt(3.0 * cross[i, b]) * scale, _SCALED_DISTANCE_MAX)
            cross[i, b] = signal * (1.0 + s) * _exp(-s)
        _add_rows(cross, i, cross, work.factor, (0, i), (0, whole), -1.0)
        inverse, z = 1.0 / work.factor[i, i], work.factor[i, len(x)]
        for b in range(lanes):
            v = cross[i, b] * inverse
            cross[i, b] = v
            mean[b] += z * v
            # Rounding may take the last digits of a vanishing variance below zero.
            variance[b] = max(variance[b] - v * v, 0.0)


@_entry(f"void({_BATCH}, float64[:, ::1], float64[:, ::1], float64[:, ::1], float64[:, ::1])")
def posterior_range(
    x: FloatArray,
    y: FloatArray,
    known: FloatArray,
    offsets: IntArray,
    first: int,
    last: int,
    theta: FloatArray,
    queries: FloatArray,
    mean: FloatArray,
    variance: FloatArray,
) -> None:
    """Compute posterior means and latent variances for problems `first` to `last` − 1.

    If no jitter makes a problem's covariance positive definite, the result is its prior: mean 0,
    variance σ_f².

    Args:
        x: Inputs of all problems, shape (rows, d).
        y: Targets, shape (rows,).
        known: Known noise variances, shape (rows,).
        offsets: Row boundaries of the problems, shape (problems + 1,).
        first: Index of the first problem.
        last: Index after the last problem.
        theta: θ of each problem, shape (problems, 3).
        queries: Points to predict at, shape (d, queries), the same for all problems.
        mean: Output, shape (problems, queries), in the targets' unit.
        variance: Output, shape (problems, queries), in the targets' unit squared.
    """
    n = _largest(offsets, first, last)
    work = _allocate(n)
    cross = np.empty((n, _BLOCK))
    for problem in range(first, last):
        rows = slice(offsets[problem], offsets[problem + 1])
        _measure(work, x[rows])
        if _factorise(work, y[rows], known[rows], theta[problem], 0.0)[0] == np.inf:
            mean[problem] = 0.0
            variance[problem] = math.exp(theta[problem, 0])
            continue
        for start in range(0, queries.shape[1], _BLOCK):
            lanes = slice(start, min(start + _BLOCK, queries.shape[1]))
            _predict_block(
                work,
                x[rows],
                theta[problem],
                queries[:, lanes],
                cross,
                mean[problem, lanes],
                variance[problem, lanes],
            )
