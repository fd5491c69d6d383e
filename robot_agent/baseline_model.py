"""What a robot's baseline would do on a path, from records of what it did on others."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.signal import lfilter

from shared.arrays import FloatArray
from shared.errors import InvalidInputError
from shared.strict import NonNegative, Strict

_FINE_S = 0.3  # up to this lag every tap is its own, two samples wide; then they widen
_WIDENING = 1.25


class BaselineModel(Strict):
    """The error response of one axis: y(k) = u(k) − Σ g_j [u(k − j) − u(k − j − 1)].

    g is one minus the step response, shape (taps,). `residual_std` is what the model leaves of a
    record, measurement noise included.
    """

    error_response: Annotated[tuple[float, ...], Field(min_length=1, max_length=100_000)]
    residual_std: NonNegative

    def error(self, reference: FloatArray) -> FloatArray:
        """Return u − y for a reference (samples,) that starts from rest."""
        change = np.diff(reference, prepend=reference[0])
        return np.asarray(lfilter(self.error_response, [1.0], change))


def needed_correction(model: BaselineModel, desired: FloatArray) -> FloatArray:
    """Return about how far the reference has to be from the path for the output to be on it.

    With the error operator E the exact correction is (1 − E)⁻¹ E y_d; these are the first two terms
    of its Neumann series, which suffice where the baseline follows at all. Shape (samples,).
    """
    first = model.error(desired)
    return first + model.error(first)


def identify_baseline(
    records: list[tuple[FloatArray, FloatArray]], sample_time_s: float, memory_s: float
) -> BaselineModel:
    """Fit the error response of one axis by least squares.

    The taps are constant over bins that widen with the lag, as the response gets slower.

    Args:
        records: pairs of reference and output, shape (samples,) each, each starting at rest.
        sample_time_s: between two samples.
        memory_s: how long the robot remembers a step, its settling time.

    Raises:
        InvalidInputError: fewer samples than the fit needs, or numbers that are not finite.
    """
    edges = _edges(sample_time_s, memory_s)
    matrix = np.concatenate([_columns(reference, edges) for reference, _ in records])
    error = np.concatenate([reference - output for reference, output in records])
    if len(error) < 10 * (len(edges) - 1) or not np.isfinite(error).all():
        raise InvalidInputError(
            f"{len(error)} samples are too few for a model with {len(edges) - 1} taps, "
            "or hold a number that is not finite"
        )
    scale = float(np.sqrt(np.mean(matrix**2)))
    normal = matrix.T @ matrix + 1e-4 * scale**2 * len(error) * _roughness(len(edges) - 1)
    taps = np.linalg.lstsq(normal, matrix.T @ error, rcond=None)[0]
    residual = error - matrix @ taps
    return BaselineModel(
        error_response=tuple(np.repeat(taps, np.diff(edges)).tolist()),
        residual_std=float(residual.std()),
    )


def _edges(sample_time_s: float, memory_s: float) -> np.ndarray:
    fine = np.arange(0.0, _FINE_S, 2 * sample_time_s)
    count = int(np.ceil(np.log(max(memory_s / _FINE_S, 1.1)) / np.log(_WIDENING))) + 1
    wide = _FINE_S * _WIDENING ** np.arange(count)
    return np.unique(np.round(np.concatenate([fine, wide]) / sample_time_s).astype(int))


def _columns(reference: FloatArray, edges: np.ndarray) -> FloatArray:
    """Return, per bin, the sum of the reference's changes that lie in it."""
    lagged = reference[
        np.clip(np.arange(len(reference))[:, np.newaxis] - edges[np.newaxis, :], 0, None)
    ]
    return np.asarray(lagged[:, :-1] - lagged[:, 1:])


def _roughness(taps: int) -> FloatArray:
    """Return the penalty on second differences: smooth records do not tell neighbours apart."""
    second = np.diff(np.eye(taps), 2, axis=0)
    return np.asarray(second.T @ second) * 1e-2
