"""Robots with one loop on each axis, and what tests of several axes give of them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from random_loops import SPEC, Loop

from nufleet.shared.arrays import ComplexArray
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.matrix_response import MatrixResponse
from nufleet.shared.frequency_test.quality import Finding, Quality
from nufleet.shared.robots.spec import RobotSpec

AXES = ("x", "y")
Loops = Mapping[str, Loop]


def spec_of(*alone: str) -> RobotSpec:
    (axis,) = SPEC.axes
    axes = tuple(
        axis.model_copy(update={"name": name, "together": name not in alone}) for name in AXES
    )
    return SPEC.model_copy(update={"axes": axes})


def answer(
    loops: Loops,
    test: Excitation,
    deviation: float,
    rng: np.random.Generator,
    across: float = 0.0,
    silent: str | None = None,
    correlation: ComplexArray | None = None,
) -> FrequencyResponse:
    """Return what a test gives of loops, each of which adds a share of itself to the others.

    The axis `silent` does not respond. Errors of the outputs at a tone are independent, or have a
    correlation of shape (axes, axes).
    """
    nothing = Quality(warnings=(Finding(code="no-response", text="no response"),))
    if not test.also:
        return replace(loops[test.axis].answer(test, deviation, rng), axis=test.axis)
    names = tuple(one.axis for one in test.played)
    counts = [len(one.tones) for one in test.played]
    played_by = np.repeat(np.arange(len(names)), counts)
    omega = np.array([tone.omega_rad_s for one in test.played for tone in one.tones])
    degrees, white, scatter = 2.0 * (test.segments - 1), [], []
    for _ in names:
        real, imaginary = rng.standard_normal((2, len(omega))) / np.sqrt(2)
        white.append(real + 1j * imaginary)
        scatter.append(rng.chisquare(degrees, len(omega)) / degrees)
    order = [AXES.index(name) for name in names]
    together = np.eye(len(AXES), dtype=complex) if correlation is None else correlation
    together = together[np.ix_(order, order)]
    errors = deviation * np.linalg.cholesky(together) @ np.array(white)
    rows = [
        FrequencyResponse(
            omega_rad_s=omega,
            z=np.where(played_by == place, name != silent, across) * loops[name].z(omega)
            + errors[place],
            variance=deviation**2 * scatter[place],
            segments=test.segments,
            quality=nothing if name == silent else Quality(),
            amplitude=0.1,
        )
        for place, name in enumerate(names)
    ]
    matrix = MatrixResponse(names, played_by, tuple(rows), together)
    first = matrix.entry(0, 0)
    return FrequencyResponse(**{**vars(first), "matrix": matrix})
