"""Realisation of transfer functions, one or a matrix of them, as state-space models."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.transfer_models import ModelError, StateSpace

# Singular values below this, relative to the norms of A and B, count as zero when the order is
# reduced.
RANK_TOLERANCE = 1e-9

# A state is scaled again only if that makes the norms of its row and column this much smaller.
BALANCE_GAIN = 0.95

Polynomial = Sequence[float] | NDArray[np.floating]


@dataclass(frozen=True, eq=False, kw_only=True)
class TransferFunction(StateSpace):
    """A model with one input and one output that is realised from the fraction num/den."""

    num: FloatArray
    """Coefficients of the numerator, from the highest power of s or z down, shape (degree + 1,)."""
    den: FloatArray
    """Coefficients of the denominator, in the same order, shape (degree + 1,)."""


def transfer_function(num: Polynomial, den: Polynomial, dt_s: float = 0.0) -> TransferFunction:
    """Return a realisation of num/den with deg(den) states, in controllable canonical form, scaled.

    Args:
        num: Coefficients of the numerator, from the highest power of the variable down, which is s
            in continuous time and z in discrete time.
        den: Coefficients of the denominator, in the same order.
        dt_s: Sample time, or 0 for continuous time.

    Raises:
        ModelError: the fraction is improper or undefined, or a coefficient is not finite, also
            after division by the denominator's first.

    Examples:
        The model 1/(s + 2), and a delay of one sample at 100 Hz:

        >>> transfer_function([1.0], [1.0, 2.0]).modes
        array([-2.+0.j])
        >>> transfer_function([1.0], [1.0, 0.0], dt_s=0.01).states
        1
    """
    numerator = np.trim_zeros(np.atleast_1d(np.asarray(num, dtype=np.float64)), "f")
    denominator = np.trim_zeros(np.atleast_1d(np.asarray(den, dtype=np.float64)), "f")
    if not (np.isfinite(numerator).all() and np.isfinite(denominator).all()):
        raise ModelError("the coefficients of a transfer function must be finite")
    if not denominator.size:
        raise ModelError("the denominator of a transfer function is zero")
    fraction = {"num": numerator, "den": denominator}
    order = denominator.size - 1
    if numerator.size > order + 1:
        raise ModelError(
            f"improper transfer function: the numerator has degree {numerator.size - 1},"
            f" the denominator {order}; the denominator must not have the lower degree"
        )
    padded = np.concatenate([np.zeros(order + 1 - numerator.size), numerator])
    # All poles of a model sampled fast are near z = 1, where a companion matrix in z − 1 resolves
    # them.
    shift = 1.0 if dt_s > 0 and order and -denominator[1] > 0.5 * order * denominator[0] else 0.0
    if shift:
        padded, denominator = _about_one(padded), _about_one(denominator)
    with np.errstate(over="ignore"):
        padded, monic = padded / denominator[0], denominator / denominator[0]
    if not (np.isfinite(padded).all() and np.isfinite(monic).all()):
        raise ModelError(
            f"the first coefficient of the denominator, {denominator[0]:g}, is too small beside the"
            " other coefficients"
        )
    companion = np.zeros((order, order))
    if order:
        companion[0] = -monic[1:]
        companion[1:, :-1] = np.eye(order - 1)
    scale = _balance(companion)
    b = np.zeros((order, 1))
    b[:1, 0] = 1.0
    return TransferFunction(
        companion * scale / scale[:, None] + shift * np.eye(order),
        b / scale[:, None],
        (padded[1:] - padded[0] * monic[1:])[None, :] * scale,
        padded[:1, None],
        dt_s,
        **fraction,
    )


def _balance(matrix: FloatArray) -> FloatArray:
    """Return the scales of the states with which the norms of each row and column are alike.

    The scales d, shape (n,), are powers of 2, so that dividing row i and multiplying column i by
    dᵢ loses no digits: B. N. Parlett and C. Reinsch, "Balancing a matrix for calculation of
    eigenvalues and eigenvectors", Numerische Mathematik 13 (1969) 293–304. `scipy.linalg` has the
    same, but loading it takes longer than most comparisons of two models.
    """
    balanced, scale = matrix.copy(), np.ones(len(matrix))
    changed = True
    while changed:
        changed = False
        for i in range(len(matrix)):
            column, row = math.hypot(*balanced[:, i]), math.hypot(*balanced[i])
            if not (0 < column < math.inf and 0 < row < math.inf):
                continue
            factor = 2.0 ** round((math.log2(row) - math.log2(column)) / 2)
            if column * factor + row / factor < BALANCE_GAIN * (column + row):
                balanced[:, i] *= factor
                balanced[i] /= factor
                scale[i] *= factor
                changed = True
    return scale


def _about_one(p: FloatArray) -> FloatArray:
    """Return the coefficients of p(1 + δ), computed exactly, since they nearly cancel."""
    exact = [Fraction(float(coefficient)) for coefficient in p]
    for end in range(len(exact), 1, -1):
        for k in range(1, end):
            exact[k] += exact[k - 1]
    return np.array([float(coefficient) for coefficient in exact])


def transfer_matrix(
    num: Sequence[Sequence[Polynomial]], den: Sequence[Sequence[Polynomial]], dt_s: float = 0.0
) -> StateSpace:
    """Return a realisation of a matrix of fractions, with the fewest possible states.

    Args:
        num: Numerators, one row per output and one column per input, see `transfer_function`.
        den: Denominators, of the same shape.
        dt_s: Sample time, or 0 for continuous time.

    Raises:
        ModelError: `num` and `den` have different or ragged shapes, or a fraction cannot be
            realised, see `transfer_function`.

    Examples:
        One output of two inputs, 1/(s + 1) and 2/(s + 2):

        >>> model = transfer_matrix([[[1.0], [2.0]]], [[[1.0, 1.0], [1.0, 2.0]]])
        >>> model.outputs, model.inputs, model.states
        (1, 2, 2)
    """
    from scipy.linalg import block_diag

    inputs = len(num[0]) if num else 0
    if inputs == 0 or [len(row) for row in [*num, *den]] != [inputs] * (2 * len(num)):
        raise ModelError("num and den must be full matrices of polynomials, of the same shape")
    entries = [
        [transfer_function(n, d, dt_s) for n, d in zip(*rows, strict=True)]
        for rows in zip(num, den, strict=True)
    ]
    flat = [entry for row in entries for entry in row]
    unit = np.eye(max(inputs, len(num)))
    return minimal(
        StateSpace(
            block_diag(*(entry.a for entry in flat)),
            np.vstack([e.b * unit[j, :inputs] for row in entries for j, e in enumerate(row)]),
            np.hstack(
                [e.c * unit[: len(num), i : i + 1] for i, row in enumerate(entries) for e in row]
            ),
            np.array([[entry.d[0, 0] for entry in row] for row in entries]),
            dt_s,
        )
    )


def minimal(model: StateSpace) -> StateSpace:
    """Return the model without states that are not reachable or not observable."""
    a, b, c = _reachable(model.a, model.b, model.c)
    a, c, b = (part.T for part in _reachable(a.T, c.T, b.T))
    return StateSpace(a, b, c, model.d, model.dt_s)


def _reachable(a: FloatArray, b: FloatArray, c: FloatArray) -> tuple[FloatArray, ...]:
    """Restrict a model to its reachable subspace, built block by block (the staircase algorithm).

    Each block holds the new directions that A reaches from the previous block; the basis is
    orthonormal throughout.
    """
    size = np.linalg.norm(a) + np.linalg.norm(b)
    basis = np.zeros((len(a), 0))
    block = b / (np.linalg.norm(b) or 1.0)
    while basis.shape[1] < len(a):
        for _ in range(2):  # twice is enough to be orthogonal to working precision
            block = block - basis @ (basis.T @ block)
        left, singular, _ = np.linalg.svd(block, full_matrices=False)
        new = left[:, singular > RANK_TOLERANCE]
        if not new.shape[1]:
            break
        basis = np.hstack([basis, new])
        block = a @ new / size
    return basis.T @ a @ basis, basis.T @ b, c @ basis
