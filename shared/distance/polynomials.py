"""Arithmetic with polynomials of one variable, for the ν-gap of two transfer functions.

A polynomial of degree d is an array of coefficients of shape (d + 1,), ordered from the constant
up, without unit. The functions are written for one number at a time, so that numba can compile them
too (`nufleet.shared.distance.rational_gap.compiled`).
"""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray

_EPSILON = float(np.finfo(np.float64).eps)


def value_at(p: FloatArray, s: complex) -> complex:
    """Return p(s) by Horner's rule; p has shape (d + 1,)."""
    value = complex(p[-1])
    for k in range(len(p) - 2, -1, -1):
        value = value * s + p[k]
    return value


def product_of(p: FloatArray, q: FloatArray) -> FloatArray:
    """Return p · q, whose degree is the sum of the two, shape (len(p) + len(q) − 1,)."""
    product = np.zeros(len(p) + len(q) - 1)
    for i in range(len(p)):
        for j in range(len(q)):
            product[i + j] += p[i] * q[j]
    return product


def sum_of(p: FloatArray, factor: float, q: FloatArray) -> FloatArray:
    """Return p + factor · q for a q no longer than p, shape (len(p),)."""
    total = p.copy()
    for k in range(len(q)):
        total[k] += factor * q[k]
    return total


def mirror_of(p: FloatArray) -> FloatArray:
    """Return p~(s) = p(−s), shape (len(p),)."""
    mirrored = p.copy()
    for k in range(1, len(p), 2):
        mirrored[k] = -p[k]
    return mirrored


def power_on_axis(p: FloatArray) -> FloatArray:
    """Return |p(jω)|² as a polynomial of x = ω², shape (len(p),)."""
    degree = len(p) - 1
    power = np.zeros(degree + 1)
    for i in range(degree + 1):
        for j in range(i % 2, degree + 1, 2):
            sign = 1.0 if ((i - j) // 2) % 2 == 0 else -1.0
            power[(i + j) // 2] += sign * p[i] * p[j]
    return power


def in_half_plane(p: FloatArray, degree: int, discrete: bool) -> FloatArray:
    """Return p from the constant up and, in discrete time, (1 − s)ᵈ p((1 + s)/(1 − s)).

    Here p is ordered from its highest power down; the result has shape (degree + 1,).
    """
    ascending = np.zeros(degree + 1)
    for k in range(len(p)):
        ascending[k] = p[len(p) - 1 - k]
    if not discrete:
        return ascending
    weights = np.zeros((degree + 1, degree + 1))  # row k: (1 + s)ᵏ (1 − s)ᵈ⁻ᵏ, exact integers
    for k in range(degree + 1):
        weights[k, 0] = 1.0
        for factor in range(degree):
            sign = 1.0 if factor < k else -1.0
            for i in range(degree, 0, -1):
                weights[k, i] += sign * weights[k, i - 1]
    mapped = np.empty(degree + 1)
    for i in range(degree + 1):
        mapped[i] = _dot(ascending, weights[:, i])
    return mapped


def _dot(p: FloatArray, q: FloatArray) -> float:
    """Return Σ p_k q_k as if summed in twice the precision.

    Models sampled fast have all roots near z = 1, and their polynomials cancel there. T. Ogita,
    S. Rump and S. Oishi, "Accurate sum and dot product", SIAM Journal on Scientific Computing 26
    (2005), algorithm 5.3; the products are split after Dekker.
    """
    total, lost = 0.0, 0.0
    for k in range(len(p)):
        product = p[k] * q[k]
        p_split, q_split = 134217729.0 * p[k], 134217729.0 * q[k]
        p_high, q_high = p_split - (p_split - p[k]), q_split - (q_split - q[k])
        p_low, q_low = p[k] - p_high, q[k] - q_high
        lost += ((p_high * q_high - product) + p_high * q_low + p_low * q_high) + p_low * q_low
        above = total + product
        carried = above - total
        lost += (total - (above - carried)) + (product - carried)
        total = above
    return total + lost


def _first_guess(p: FloatArray) -> ComplexArray:
    """Return starting points for all roots, with magnitudes estimated from the Newton polygon.

    D. Bini, "Numerical computation of polynomial zeros by means of Aberth's method", Numerical
    Algorithms 13 (1996).
    """
    degree = len(p) - 1
    guess = np.empty(degree, np.complex128)
    k = 0
    while k < degree:
        corner, steepest = k + 1, -np.inf
        for j in range(k + 1, degree + 1):
            if p[j] != 0.0:
                slope = (math.log(abs(p[j])) - math.log(abs(p[k]))) / (j - k)
                if slope >= steepest:
                    corner, steepest = j, slope
        for i in range(k, corner):
            angle = 2 * math.pi * (i - k) / (corner - k) + 2 * math.pi * k / degree + 0.7
            guess[i] = math.exp(-steepest) * complex(math.cos(angle), math.sin(angle))
        k = corner
    return guess


def roots_of(p: FloatArray) -> tuple[bool, ComplexArray]:
    """Return True on success, and all finite nonzero roots, shape (roots,), by Aberth's method."""
    first, last = 0, len(p) - 1
    while first < last and p[first] == 0.0:
        first += 1
    while last > first and p[last] == 0.0:
        last -= 1
    p = p[first : last + 1]
    roots = _first_guess(p)
    moving = np.ones(len(roots), np.bool_)
    for _ in range(100):
        at_rest = True
        for i in range(len(roots)):
            if moving[i]:
                step = _step(p, roots, i)
                roots[i] -= step
                moving[i] = not abs(step) <= 2 * _EPSILON * abs(roots[i])
                at_rest = at_rest and not moving[i]
        if at_rest:
            return True, roots
    return False, roots


def _step(p: FloatArray, roots: ComplexArray, i: int) -> complex:
    """Return Aberth's step for one root: Newton's step, repelled by the other roots.

    The step is 0 once the value of the polynomial is at the level of its rounding errors.
    """
    z = roots[i]
    size = abs(z)
    value, slope, bound = complex(p[-1]), 0j, abs(p[-1])
    for k in range(len(p) - 2, -1, -1):
        slope = slope * z + value
        value = value * z + p[k]
        bound = bound * size + abs(p[k])
    if abs(value) <= 2 * _EPSILON * bound:
        return 0j
    # Σ 1/(z − root), written out in real numbers because it takes most of the time.
    real, imaginary = 0.0, 0.0
    for j in range(len(roots)):
        if j != i:
            x, y = z.real - roots[j].real, z.imag - roots[j].imag
            square = x * x + y * y
            real += x / square
            imaginary -= y / square
    return value / (slope - value * complex(real, imaginary))
