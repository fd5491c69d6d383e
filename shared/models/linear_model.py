"""A discrete-time linear model of a robot's baseline loop, for robots that know theirs."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.strict import Positive, Strict

Row = Annotated[tuple[float, ...], Field(min_length=1, max_length=256)]


class LinearModel(Strict):
    """x(k+1) = A x(k) + B u(k), y(k) = C x(k) + D u(k), from reference u to output y of one axis.

    A study never uses it; it provides the exact values that estimates are compared with.
    """

    a: Annotated[tuple[Row, ...], Field(min_length=1, max_length=256)]
    """A, n rows of n entries."""
    b: Row
    """B, n entries."""
    c: Row
    """C, n entries."""
    d: float = 0.0
    """D, a number."""
    sample_time_s: Positive
    """Time T between samples k and k + 1."""

    @model_validator(mode="after")
    def _shapes_agree(self) -> LinearModel:
        order = len(self.a)
        if any(len(row) != order for row in self.a) or len(self.b) != order or len(self.c) != order:
            raise ValueError(f"A must be n × n and B, C of length n; A has {order} rows")
        return self

    def frequency_response(self, omega_rad_s: FloatArray) -> ComplexArray:
        """Return z(ω) = C (e^{jωT} I − A)⁻¹ B + D.

        Args:
            omega_rad_s: Frequencies, shape (m,), each below the Nyquist frequency π / T.

        Returns:
            Complex responses, shape (m,).
        """
        a = np.asarray(self.a)
        shift = np.exp(1j * np.asarray(omega_rad_s) * self.sample_time_s)
        resolvent = shift[:, None, None] * np.eye(len(a)) - a
        states = np.linalg.solve(resolvent, np.asarray(self.b, dtype=complex)[None, :, None])
        return np.asarray(states[:, :, 0] @ np.asarray(self.c) + self.d, dtype=np.complex128)
