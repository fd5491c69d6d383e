"""Distances between responses on the Riemann sphere: the chordal distance and its uncertainty."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.models.linear_model import LinearModel

POLE_FROM = 1e150
"""Magnitude from which on z is the north pole in double precision; the squares of larger magnitudes
overflow."""

GRID_POINTS = 2000
"""Number of frequencies on the linear grid, and on the logarithmic grid, of a worst-case search."""

PEAKS_REFINED = 32
"""Largest number of peaks refined; for equal models, rounding makes every grid point a peak."""

FINER_POINTS = 33
"""Number of grid points around a peak while it is refined; the next grid is a sixteenth as wide."""

RESPONSES_AT_ONCE = 2**20
"""Largest number of matrix entries solved for at once, so that models of high order fit into
memory."""


def chordal_distance(z_1: ComplexArray, z_2: ComplexArray) -> FloatArray:
    """Return ψ = |z₁ − z₂| / (√(1 + |z₁|²) √(1 + |z₂|²)), the paper's eq. (4), in [0, 1].

    Args:
        z_1: Responses, any shape; infinity is the north pole of the sphere.
        z_2: Responses, a shape that broadcasts with that of `z_1`.

    Returns:
        Chordal distances, of the broadcast shape.

    Examples:
        Two responses in quadrature, and the two poles of the sphere:

        >>> chordal_distance(np.array([1.0, 0.0j]), np.array([1.0j, complex(np.inf)])).round(4)
        array([0.7071, 1.    ])
    """
    (finite_1, pole_1), (finite_2, pole_2) = _finite_part(z_1), _finite_part(z_2)
    # hypot gives √(1 + |z|²) without overflow. The distance from z to the pole is 1 / √(1 + |z|²).
    h_1, h_2 = np.hypot(1.0, np.abs(finite_1)), np.hypot(1.0, np.abs(finite_2))
    between = np.abs(finite_1 - finite_2) / (h_1 * h_2)
    to_pole = np.where(pole_1, np.where(pole_2, 0.0, 1 / h_2), 1 / h_1)
    return np.minimum(np.where(pole_1 | pole_2, to_pole, between), 1.0)


def matrix_chordal_distance(z_1: ComplexArray, z_2: ComplexArray) -> FloatArray:
    """Return ψ of two matrices, σ_max[(I + Z₂Z₂*)^(−1/2) (Z₂ − Z₁) (I + Z₁*Z₁)^(−1/2)].

    It is the sine of the largest angle between the graphs of the responses, at one frequency the
    quantity whose largest value is the ν-gap (Vinnicombe, IEEE Trans. Autom. Control 38, 1993), and
    |z₁ − z₂| / (√(1 + |z₁|²) √(1 + |z₂|²)) for numbers.

    Args:
        z_1: Responses, outputs over inputs, shape (…, p, m), finite.
        z_2: Responses of the same shape.

    Returns:
        Distances in [0, 1], shape (…).
    """

    def adjoint(z: ComplexArray) -> ComplexArray:
        return np.asarray(np.swapaxes(z, -1, -2).conj())

    # Any factors L with LL* = I + ZZ* differ from the roots by rotations, which keep σ_max.
    left = np.linalg.inv(np.linalg.cholesky(np.eye(z_2.shape[-2]) + z_2 @ adjoint(z_2)))
    right = np.linalg.inv(np.linalg.cholesky(np.eye(z_1.shape[-1]) + adjoint(z_1) @ z_1))
    between = left @ (z_2 - z_1) @ adjoint(np.asarray(right, dtype=np.complex128))
    largest = np.linalg.svd(between, compute_uv=False)[..., 0]
    return np.asarray(np.minimum(largest, 1.0))


def riemann_sphere(z: ComplexArray) -> FloatArray:
    """Return the stereographic projections (x, y, height) of z, shape (…, 3).

    The sphere has radius ½ and touches the plane at 0, as in the paper's Fig. 1: 0 is its south
    pole, infinity its north pole (0, 0, 1). The Euclidean distance between projections is ψ.

    Args:
        z: Responses, any shape.

    Examples:
        >>> riemann_sphere(np.array([0.0, 1.0, complex(np.inf)]))
        array([[0. , 0. , 0. ],
               [0.5, 0. , 0.5],
               [0. , 0. , 1. ]])
    """
    finite, pole = _finite_part(z)
    h = np.hypot(1.0, np.abs(finite))
    shadow = np.where(pole, 0.0, finite / h / h)
    height = np.where(pole, 1.0, (np.abs(finite) / h) ** 2)
    return np.stack([shadow.real, shadow.imag, height], axis=-1)


def chordal_variance(
    z_1: ComplexArray, variance_1: FloatArray, z_2: ComplexArray, variance_2: FloatArray
) -> FloatArray:
    """Return Var ψ̂ ≈ ½ (1 − ψ²) [σ₁²/(1 + |z₁|²)² + σ₂²/(1 + |z₂|²)²].

    This holds to first order in the (circular) errors. Near ψ = 0 it does not: there the estimate ψ̂
    is biased upwards, since a distance is never negative.

    Args:
        z_1: Estimated responses of one robot, any shape.
        variance_1: Variance σ₁² = E|ẑ₁ − z₁|², of the same shape.
        z_2: Estimated responses of the other robot, the same shape.
        variance_2: Variance σ₂² = E|ẑ₂ − z₂|², of the same shape.

    Returns:
        Variances of the chordal distances, the same shape.
    """
    psi = chordal_distance(z_1, z_2)
    spread = sum(
        variance * np.hypot(1.0, np.abs(z)) ** -4.0
        for z, variance in ((z_1, variance_1), (z_2, variance_2))
    )
    return np.asarray(0.5 * (1 - psi**2) * spread, dtype=np.float64)


def geodesic_radius(z: ComplexArray, radius: FloatArray) -> FloatArray:
    """Return the distance on the sphere from the centre of a disc to its furthest point.

    The furthest point of the disc |w − z| ≤ ρ lies on the line through 0 and z, on the side of 0:
    r = arctan |z| − arctan(|z| − ρ). If that exceeds π/2, the disc contains the point opposite z,
    whose distance is π/2.

    Args:
        z: Centres of the discs, any shape.
        radius: Radii ρ in the plane, the same shape.

    Returns:
        Angles arcsin ψ in rad, the same shape.
    """
    gain = np.abs(z)
    reach: FloatArray = np.minimum(np.arctan(gain) - np.arctan(gain - radius), np.pi / 2)
    return reach


def worst_case_chordal_distance(
    model_1: LinearModel, model_2: LinearModel, omega_band_rad_s: tuple[float, float]
) -> tuple[float, float]:
    """Return ψ* = max ψ(z₁(ω), z₂(ω)) over a band, the paper's eq. (6), and the ω that attains it.

    A dense grid (linear, logarithmic, and around every pole) locates the peaks; finer and finer
    grids refine them.

    Args:
        model_1: Baseline loop of one robot.
        model_2: Baseline loop of the other robot.
        omega_band_rad_s: Lowest and highest frequency, below the Nyquist frequencies of both.

    Returns:
        The distance ψ*, accurate to about 1e-12 at a peak that was found, and ω* in rad/s.

    Raises:
        InvalidInputError: the band is empty or reaches a Nyquist frequency.
    """
    low, high = omega_band_rad_s
    nyquist = np.pi / max(model_1.sample_time_s, model_2.sample_time_s)
    if not 0 <= low < high < nyquist:
        raise InvalidInputError(
            f"the band must satisfy 0 <= low < high < {nyquist:.4g} rad/s (Nyquist), "
            f"got {low:.4g} and {high:.4g}"
        )
    omega = _search_grid(model_1, model_2, low, high)
    psi = chordal_distance(_responses(model_1, omega), _responses(model_2, omega))
    best, best_omega = float(psi.max()), float(omega[psi.argmax()])

    for peak in _promising_peaks(psi):
        around = omega[max(peak - 1, 0) : peak + 2]
        while True:
            finer = np.linspace(around[0], around[-1], FINER_POINTS)
            fine = chordal_distance(_responses(model_1, finer), _responses(model_2, finer))
            top = int(fine.argmax())
            if fine[top] > best:
                best, best_omega = float(fine[top]), float(finer[top])
            if around[-1] - around[0] <= 1e-9 * high:
                break
            around = finer[max(top - 1, 0) : top + 2]
    return best, best_omega


def _finite_part(z: ComplexArray) -> tuple[ComplexArray, np.ndarray]:
    """Return z with infinite (or too large) values replaced by 0, and True where that was done."""
    values = np.asarray(z, dtype=np.complex128)
    pole = np.maximum(np.abs(values.real), np.abs(values.imag)) > POLE_FROM
    return np.where(pole, 0.0, values), pole


def _search_grid(model_1: LinearModel, model_2: LinearModel, low: float, high: float) -> FloatArray:
    """Return frequencies dense enough that no peak lies undetected between them, ascending.

    A resonance is as narrow as the damping of its pole, so points are spaced by that width there.
    """
    grids = [
        np.linspace(low, high, GRID_POINTS),
        np.geomspace(max(low, 1e-6 * high), high, GRID_POINTS),
    ]
    for model in (model_1, model_2):
        poles = np.linalg.eigvals(np.asarray(model.a))
        poles = poles[np.abs(poles) > np.finfo(float).tiny]
        exponents = np.log(poles) / model.sample_time_s
        widths = np.maximum(np.abs(exponents.real), 1e-9 * high)
        # Even far out on the flank of a resonance the response may pass the point opposite to the
        # other model's, so the points thin out with the distance from the pole but do not end.
        flank = np.geomspace(8.0, 1e8, 180)
        offsets = np.concatenate([-flank, np.linspace(-8.0, 8.0, 65), flank])
        grids.append((np.abs(exponents.imag)[:, None] + np.outer(widths, offsets)).ravel())
    omega = np.unique(np.concatenate(grids))
    return omega[(omega >= low) & (omega <= high)]


def _promising_peaks(psi: FloatArray) -> list[int]:
    """Return the indices of local maxima that may exceed the greatest grid value, highest first.

    Between grid points a smooth peak rises by less than its fall to the lower of its neighbours.
    """
    padded = np.concatenate([psi[:1], psi, psi[-1:]])
    left, right = padded[:-2], padded[2:]
    could_reach = psi + (psi - np.minimum(left, right)) >= psi.max()
    peaks = np.flatnonzero((psi >= left) & (psi >= right) & could_reach)
    return [int(peak) for peak in peaks[np.argsort(psi[peaks])[::-1]][:PEAKS_REFINED]]


def _responses(model: LinearModel, omega_rad_s: FloatArray) -> ComplexArray:
    at_once = max(1, RESPONSES_AT_ONCE // len(model.a) ** 2)
    parts = [
        model.frequency_response(omega_rad_s[start : start + at_once])
        for start in range(0, len(omega_rad_s), at_once)
    ]
    return np.concatenate(parts)
