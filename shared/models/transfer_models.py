"""Linear models with several inputs and outputs, and their graphs at given frequencies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.errors import InvalidInputError

# A pole this close to the axis, relative to its magnitude, makes the response itself too large to
# compute with. The graph is then computed as a null space, which such a pole does not disturb.
NEAR_AXIS = 1e-4
# A pole this close to the axis, relative to its magnitude, counts as lying on it.
ON_AXIS = 1e-7
# Relative singular value of a pencil below which its mode counts as hidden.
HIDDEN = 1e-10


class ModelError(InvalidInputError):
    """A model that cannot be used: inconsistent, improper, or with a hidden unstable mode."""


@dataclass(frozen=True, eq=False)
class StateSpace:
    """x' = A x + B u, y = C x + D u, where x' is dx/dt, or x(k+1) if `dt_s` > 0.

    All entries are real and finite; the number of states n may be 0. Raises ModelError if the
    shapes disagree or an entry is not finite.

    Examples:
        A double integrator in continuous time:

        >>> import numpy as np
        >>> a = np.array([[0.0, 1.0], [0.0, 0.0]])
        >>> b, c = np.array([[0.0], [1.0]]), np.array([[1.0, 0.0]])
        >>> model = StateSpace(a, b, c, np.zeros((1, 1)))
        >>> model.states, model.poles_unstable, model.poles_on_axis
        (2, 0, 2)
    """

    a: FloatArray
    """A, shape (n, n)."""
    b: FloatArray
    """B, shape (n, m)."""
    c: FloatArray
    """C, shape (p, n)."""
    d: FloatArray
    """D, shape (p, m)."""
    dt_s: float = 0.0
    """Sample time; 0 for continuous time."""

    def __post_init__(self) -> None:
        for name in "abcd":
            matrix = np.asarray(getattr(self, name), dtype=np.float64)
            object.__setattr__(self, name, matrix)
            if matrix.ndim != 2 or not np.isfinite(matrix).all():
                raise ModelError(f"{name.upper()} must be a matrix of finite numbers")
        states, (outputs, inputs) = len(self.a), self.d.shape
        expected = {
            "A": (self.a, (states, states)),
            "B": (self.b, (states, inputs)),
            "C": (self.c, (outputs, states)),
        }
        for name, (matrix, shape) in expected.items():
            if matrix.shape != shape:
                raise ModelError(
                    f"{name} is {_by(matrix.shape)}, expected {_by(shape)}, because A is"
                    f" {_by(self.a.shape)} and D is {_by(self.d.shape)}"
                )
        if inputs == 0 or outputs == 0:
            raise ModelError("a model needs at least one input and one output")
        if not (np.isfinite(self.dt_s) and self.dt_s >= 0):
            raise ModelError(f"dt must be 0 (continuous time) or a time in s, got {self.dt_s}")

    @property
    def states(self) -> int:
        """Number of states n."""
        return len(self.a)

    @property
    def inputs(self) -> int:
        """Number of inputs m."""
        return int(self.d.shape[1])

    @property
    def outputs(self) -> int:
        """Number of outputs p."""
        return int(self.d.shape[0])

    @cached_property
    def modes(self) -> ComplexArray:
        """Eigenvalues of A, shape (n,): rad/s in continuous time, else in the z-plane."""
        return np.asarray(np.linalg.eigvals(self.a), dtype=np.complex128)

    @cached_property
    def instability(self) -> FloatArray:
        """Distance of each mode beyond the stability boundary, relative to its size, shape (n,).

        The boundary is the imaginary axis or the unit circle. A positive value means unstable; a
        value within ±`ON_AXIS` means on the boundary.
        """
        if self.dt_s > 0:
            return np.asarray(np.abs(self.modes) - 1.0)
        return np.asarray(self.modes.real / np.maximum(np.abs(self.modes), 1.0))

    @property
    def poles_unstable(self) -> int:
        """η, the number of poles in the open right half-plane or outside the unit circle."""
        return int(np.count_nonzero(self.instability > ON_AXIS))

    @property
    def poles_on_axis(self) -> int:
        """η₀, the number of poles on the imaginary axis or on the unit circle."""
        return int(np.count_nonzero(np.abs(self.instability) <= ON_AXIS))

    def hidden_unstable_mode(self) -> complex | None:
        """Return a mode on or beyond the stability boundary that is unreachable or unobservable.

        It is found by the rank test of Popov, Belevitch and Hautus. None if there is no such mode.
        """
        for mode in self.modes[self.instability > -ON_AXIS]:
            shifted = self.a - mode * np.eye(self.states)
            # Rows are scaled so that the units of inputs and outputs do not matter.
            for pencil in (np.vstack([shifted.T, self.b.T]), np.vstack([shifted, self.c])):
                size = np.linalg.norm(pencil, axis=1, keepdims=True)
                scaled = pencil / np.where(size > 0, size, 1.0)
                if np.linalg.svd(scaled, compute_uv=False)[-1] < HIDDEN:
                    return complex(mode)
        return None

    def graph(self, omega_rad_s: FloatArray) -> ComplexArray:
        """Return bases of the graphs {(u, y): y = P(ω) u} at k frequencies.

        The graph is defined at a pole too, where it contains the directions in which P is infinite.

        Args:
            omega_rad_s: Frequencies, shape (k,); inf is allowed in continuous time.

        Returns:
            Bases whose columns span the graphs and are not normalised, shape (k, m + p, m).
        """
        finite = np.isfinite(omega_rad_s)
        if finite.all():
            return self._graph(omega_rad_s)
        bases = np.empty((len(omega_rad_s), self.inputs + self.outputs, self.inputs), complex)
        bases[:] = np.vstack([np.eye(self.inputs), self.d])
        bases[finite] = self._graph(omega_rad_s[finite])
        return bases

    def _graph(self, omega_rad_s: FloatArray) -> ComplexArray:
        states, inputs = self.b.shape
        points = np.exp(1j * omega_rad_s * self.dt_s) if self.dt_s > 0 else 1j * omega_rad_s
        if self._poles_near_axis:
            pencil = np.zeros((len(points), states + inputs, states), complex)
            pencil[:, :states] = -self.a.T
            pencil[:, range(states), range(states)] += points.conj()[:, None]
            pencil[:, states:] = -self.b.T
            kernel = np.linalg.qr(pencil, mode="complete").Q[:, :, states:]
            state, control = kernel[:, :states], kernel[:, states:]
            return np.concatenate([control, self.c @ state + self.d @ control], axis=1)
        resolvent = np.zeros((len(points), states, states), complex)
        resolvent[:] = -self.a
        resolvent[:, range(states), range(states)] += points[:, None]
        bases = np.empty((len(points), inputs + self.outputs, inputs), complex)
        bases[:, :inputs] = np.eye(inputs)
        bases[:, inputs:] = self.c @ np.linalg.solve(resolvent, self.b.astype(complex)) + self.d
        return bases

    @cached_property
    def _poles_near_axis(self) -> bool:
        return bool((np.abs(self.instability) < NEAR_AXIS).any())


def require_same_shape(first: StateSpace, second: StateSpace) -> None:
    """Raise ModelError unless both models have as many inputs and outputs, and one sample time."""
    require_same_time(first, second)
    shapes = [(model.outputs, model.inputs) for model in (first, second)]
    if shapes[0] != shapes[1]:
        raise ModelError(
            "the models differ in outputs × inputs:"
            f" {_by(shapes[0])} and {_by(shapes[1])}; compare models of the same signals"
        )


def require_same_time(first: StateSpace, second: StateSpace) -> None:
    """Raise ModelError unless both models are continuous, or discrete with the same sample time."""
    if abs(first.dt_s - second.dt_s) > 1e-9 * max(first.dt_s, second.dt_s):
        raise ModelError(
            f"the models differ in sample time: dt = {first.dt_s:g} s and {second.dt_s:g} s"
            " (0 means continuous time); resample one of them first"
        )


def _by(shape: tuple[int, ...]) -> str:
    return " × ".join(str(size) for size in shape)
