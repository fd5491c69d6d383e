"""Mapping of models to one half-plane, so that discrete and continuous time are one problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.models.transfer_models import StateSpace

Matrix = FloatArray | ComplexArray

# Least distance from any pole to the point of the unit circle that is mapped to infinity.
CLEAR_OF_POLES = 0.05


@dataclass(frozen=True, eq=False)
class Image:
    """A continuous-time model, complex if no real one is well conditioned."""

    a: Matrix
    """A, shape (n, n)."""
    b: Matrix
    """B, shape (n, m)."""
    c: Matrix
    """C, shape (p, n)."""
    d: Matrix
    """D, shape (p, m)."""

    def triangular(self) -> Image:
        """Return the same model with A in Schur form.

        The modes of a model sampled fast are all close to one point, and its states are often far
        from orthogonal. In Schur form, the balancing inside the eigenvalue routine can separate the
        modes by scaling; without it, peaks were missed by up to 1e-2.
        """
        if len(self.a) < 2:
            return self
        # Imported here because it takes longer to load than most comparisons take to compute.
        from scipy.linalg import schur

        a, basis = schur(self.a)
        return Image(a, basis.conj().T @ self.b, self.c @ basis, self.d)


@dataclass(frozen=True)
class HalfPlane:
    """The change of variable from s or z to a half-plane variable.

    In continuous time it is the identity. In discrete time the unit circle becomes the imaginary
    axis, its inside the left half-plane and its point e^{jφ} infinity, so that poles, zeros and
    their counts carry over exactly.
    """

    dt_s: float
    """Sample time of the models; 0 for continuous time."""
    angle_at_infinity: float = np.pi
    """Angle φ in rad: π, which gives s = (z − 1)/(z + 1), unless a pole is near −1."""

    def image(self, model: StateSpace) -> Image:
        """Return the model as a function of the half-plane variable."""
        if self.dt_s == 0:
            return Image(model.a, model.b, model.c, model.d).triangular()
        turn: complex | float = 1.0
        if self.angle_at_infinity != np.pi:
            turn = -np.exp(-1j * self.angle_at_infinity)
        a, b = turn * model.a, turn * model.b
        # z' = turn·z puts infinity at z' = −1; then s = (z' − 1)/(z' + 1).
        solved = np.linalg.solve(a + np.eye(model.states), np.hstack([a, b, np.eye(model.states)]))
        states = model.states
        a_inverse_a, ratio, inverse = np.split(solved, [states, states + model.inputs], axis=1)
        root = np.sqrt(2.0)
        return Image(
            a_inverse_a - inverse,
            root * ratio,
            root * (model.c @ inverse),
            model.d - model.c @ ratio,
        ).triangular()

    def omega_rad_s(self, points: ComplexArray) -> FloatArray:
        """Return the frequencies ≥ 0 that the imaginary parts of points correspond to.

        Args:
            points: Points of the half-plane variable, shape (k,).

        Returns:
            Frequencies in rad/s, shape (k,).
        """
        height = points.imag
        if self.dt_s == 0:
            return np.abs(height)
        angle = 2 * np.arctan(height) + (self.angle_at_infinity - np.pi)
        return np.asarray(np.abs(np.angle(np.exp(1j * angle))) / self.dt_s)

    @property
    def omega_max_rad_s(self) -> float:
        """Highest frequency of the models: infinity, or the Nyquist frequency."""
        return np.inf if self.dt_s == 0 else np.pi / self.dt_s


def common_half_plane(first: StateSpace, second: StateSpace) -> HalfPlane:
    """Return a map under which neither of two models has a pole at or near infinity.

    Args:
        first: A model.
        second: A model with the same sample time.
    """
    if first.dt_s == 0:
        return HalfPlane(0.0)
    poles = np.concatenate([first.modes, second.modes])
    if not poles.size or np.abs(poles + 1).min() > CLEAR_OF_POLES:
        return HalfPlane(first.dt_s)
    angles = np.linspace(0, np.pi, 64)[1:-1]
    distance = np.abs(np.exp(1j * angles)[:, None] - poles).min(axis=1)
    return HalfPlane(first.dt_s, float(angles[int(np.argmax(distance))]))
