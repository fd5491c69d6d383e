"""Models mapped to one half-plane: discrete and continuous time become the same problem."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import schur

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.models.transfer_models import StateSpace

Matrix = FloatArray | ComplexArray

# The point of the unit circle that is sent to infinity keeps this distance from every pole.
CLEAR_OF_POLES = 0.05


@dataclass(frozen=True, eq=False)
class Image:
    """A continuous-time model (A, B, C, D), complex where no real one is well conditioned."""

    a: Matrix
    b: Matrix
    c: Matrix
    d: Matrix

    def triangular(self) -> Image:
        """Return the same model with A in Schur form.

        All modes of a model sampled fast are near one point, and its states are often far from
        orthogonal to them. From here on the balancing inside the eigenvalue routine can scale them
        apart; without it peaks were missed by up to 1e-2.
        """
        if not len(self.a):
            return self
        a, basis = schur(self.a)
        return Image(a, basis.conj().T @ self.b, self.c @ basis, self.d)


@dataclass(frozen=True)
class HalfPlane:
    """The change of variable from s or z to a half-plane variable.

    In continuous time it is the identity. In discrete time the unit circle becomes the imaginary
    axis, its inside the left half-plane and its point e^{jφ} infinity, so that poles, zeros and
    their counts carry over exactly. φ = π, s = (z − 1)/(z + 1), unless a pole is near −1.
    """

    dt_s: float
    angle_at_infinity: float = np.pi

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
        """Return the frequencies ≥ 0 of the points' imaginary parts, in rad/s."""
        height = points.imag
        if self.dt_s == 0:
            return np.abs(height)
        angle = 2 * np.arctan(height) + (self.angle_at_infinity - np.pi)
        return np.asarray(np.abs(np.angle(np.exp(1j * angle))) / self.dt_s)

    @property
    def omega_max_rad_s(self) -> float:
        """The highest frequency there is: infinity, or Nyquist's."""
        return np.inf if self.dt_s == 0 else np.pi / self.dt_s


def common_half_plane(first: StateSpace, second: StateSpace) -> HalfPlane:
    """Return the map under which neither model has a pole at or near infinity."""
    if first.dt_s == 0:
        return HalfPlane(0.0)
    poles = np.concatenate([first.modes, second.modes])
    if not poles.size or np.abs(poles + 1).min() > CLEAR_OF_POLES:
        return HalfPlane(first.dt_s)
    angles = np.linspace(0, np.pi, 64)[1:-1]
    distance = np.abs(np.exp(1j * angles)[:, None] - poles).min(axis=1)
    return HalfPlane(first.dt_s, float(angles[int(np.argmax(distance))]))
