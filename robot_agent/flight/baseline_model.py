"""Predicts a robot's tracking error under its baseline controller from records of earlier flights.

The model is a finite step response of the error, fitted by regularised least squares.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Annotated

import numpy as np
from pydantic import Field
from scipy.signal import oaconvolve

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.spec import AxisSpec
from nufleet.shared.strict import NonNegative, Strict

_FINE_S = 0.3  # up to this lag the taps are equally wide; beyond it they widen
_FINE_TAPS = 40  # most taps up to that lag; none is narrower than two samples
_WIDENING = 1.25  # ratio of the end of a wide tap to its beginning
_LAGS_MAX = 100_000
_SAMPLES_PER_TAP = 10  # fewest samples of a record per tap that is fitted
_UNEXPLAINED_MAX = 0.15  # share of the reference that friction and other nonlinearities may leave
_NOISE_RATIO = 4.0  # multiple of the noise at rest: a moving robot's sensor is noisier
_BLOCK_SAMPLES = 4096  # rows of the least-squares problem held in memory at a time


class BaselineModel(Strict):
    """The error response of one axis: y(k) = u(k) − Σ_j g_j [u(k − j) − u(k − j − 1)].

    With the reference u and the output y; g_j = 1 − s_j, where s is the unit step response.
    """

    error_response: Annotated[tuple[float, ...], Field(min_length=1, max_length=_LAGS_MAX)]
    """Coefficients g_j, one for each lag j in samples, without unit."""

    residual_std: NonNegative
    """Standard deviation of the output that the model leaves unexplained, measurement noise
    included, in the axis's unit."""

    def error(self, reference: FloatArray) -> FloatArray:
        """Predict the tracking error u − y along a reference that starts from rest.

        Args:
            reference: Reference u, shape (samples,), in the axis's unit.

        Returns:
            The error, shape (samples,), in the axis's unit.
        """
        # The sum over j above is a convolution of the changes of u with g; overlap-add keeps it
        # fast for long records.
        change = np.diff(reference, prepend=reference[0])
        response = np.array(self.error_response[: len(change)])
        return np.asarray(oaconvolve(change, response)[: len(change)])


def needed_correction(model: BaselineModel, desired: FloatArray) -> FloatArray:
    """Return approximately the correction of the reference that puts the output on the path.

    With the error operator E of the model, the exact correction is (1 − E)⁻¹ E y_d. Computed are
    the first two terms of its Neumann series, E y_d + E² y_d, which suffice where the baseline
    follows at all.

    Args:
        model: Model of the axis's baseline.
        desired: Path y_d, shape (samples,), in the axis's unit.

    Returns:
        The correction, shape (samples,), in the axis's unit.
    """
    first = model.error(desired)
    return first + model.error(first)


def identify_baseline(
    records: list[tuple[FloatArray, FloatArray]], sample_time_s: float, memory_s: float
) -> BaselineModel:
    """Fit the error response of one axis by regularised least squares.

    The response is constant over bins of lags that widen with the lag, since a late response varies
    slowly. Each bin is a tap x_i, and the fit minimises |A x − e|² + λ |D x|² with the recorded
    errors e = u − y, a row of A per sample (see `_blocks`) and second differences D.

    Args:
        records: Pairs of reference and output, each of shape (samples,) in the axis's unit, each
            starting at rest.
        sample_time_s: Sample time in seconds.
        memory_s: Time in seconds after which a step of the reference has no more effect, the
            robot's settling time.

    Returns:
        The model, with one coefficient per lag.

    Raises:
        InvalidInputError: The records have fewer samples than the fit needs or numbers that are not
            finite, or the response has more samples than a model holds.
    """
    edges = _edges(sample_time_s, memory_s)
    taps = len(edges) - 1
    samples = sum(len(reference) for reference, _ in records)
    finite = all(np.isfinite(signal).all() for record in records for signal in record)
    if samples < _SAMPLES_PER_TAP * taps or not finite:
        raise InvalidInputError(
            f"{samples} samples are too few for a model with {taps} taps, "
            "or one of them is not finite"
        )
    # The normal equations AᵀA x = Aᵀe are accumulated block by block: A itself may not fit into
    # memory.
    normal, right = np.zeros((taps, taps)), np.zeros(taps)
    for columns, error in _blocks(records, edges):
        normal += columns.T @ columns
        right += columns.T @ error
    # Scaling λ with the mean square of A's columns, trace(AᵀA) / taps, makes the penalty
    # independent of the unit and of the excitation.
    penalty = 1e-4 * np.trace(normal) / taps * _roughness(taps)
    response = np.linalg.lstsq(normal + penalty, right, rcond=None)[0]
    # Variance of the residuals, as the mean of their squares minus the square of their mean.
    total = squares = 0.0
    for columns, error in _blocks(records, edges):
        residual = error - columns @ response
        total += float(residual.sum())
        squares += float(residual @ residual)
    return BaselineModel(
        error_response=tuple(np.repeat(response, np.diff(edges)).tolist()),
        residual_std=math.sqrt(max(0.0, squares / samples - (total / samples) ** 2)),
    )


def check_explained(
    model: BaselineModel, reference: FloatArray, noise_std: float, axis: AxisSpec
) -> None:
    """Refuse a model that does not explain the record that it was fitted to, apart from noise.

    A guard would mistake the unexplained part for the baseline's own error. It is large for a
    sensor that was late by more than the settling time, lost its place during the record, or
    measured something else.

    Args:
        model: Model fitted to the record.
        reference: Reference of the record, shape (samples,), in the axis's unit.
        noise_std: Standard deviation of the output at rest, in the axis's unit.
        axis: Axis that the model describes, for the error.

    Raises:
        InvalidInputError: The model leaves too much unexplained.
    """
    moved = float(reference.std())
    if model.residual_std > max(_UNEXPLAINED_MAX * moved, _NOISE_RATIO * noise_std):
        raise InvalidInputError(
            f"axis {axis.name} moved by {model.residual_std:.3g} {axis.unit} RMS that its "
            f"reference of {moved:.3g} {axis.unit} RMS within the settling time does not explain: "
            "check its sensor, or state a longer settling time"
        )


def samples_needed(sample_time_s: float, memory_s: float) -> int:
    """Return the number of samples that a record needs for `identify_baseline` to fit it.

    Args:
        sample_time_s: Sample time in seconds.
        memory_s: Settling time of the robot in seconds.

    Raises:
        InvalidInputError: The response has more samples than a model holds.
    """
    return _SAMPLES_PER_TAP * (len(_edges(sample_time_s, memory_s)) - 1)


def _edges(sample_time_s: float, memory_s: float) -> np.ndarray:
    """Return the edges of the bins of lags, shape (taps + 1,), in samples.

    The bins are equally wide up to `_FINE_S` and widen geometrically beyond it, to at least the
    settling time. There is at least one bin of one sample.
    """
    fine = np.arange(0.0, _FINE_S, max(2 * sample_time_s, _FINE_S / _FINE_TAPS))
    count = int(np.ceil(np.log(max(memory_s / _FINE_S, 1.1)) / np.log(_WIDENING))) + 1
    wide = _FINE_S * _WIDENING ** np.arange(count)
    edges = np.unique(np.round(np.concatenate([fine, wide]) / sample_time_s).astype(int))
    if edges[-1] > _LAGS_MAX:
        raise InvalidInputError(
            f"a response of {memory_s:g} s has {edges[-1]} samples of {sample_time_s:g} s; a model "
            f"of the baseline has at most {_LAGS_MAX}: state a shorter settling time"
        )
    # A robot whose sample lasts longer than its settling time answers to the sample before alone.
    return edges if len(edges) > 1 else np.array([0, 1])


def _blocks(
    records: list[tuple[FloatArray, FloatArray]], edges: np.ndarray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield the least-squares problem in blocks: rows (rows, taps) and errors (rows,).

    With a response that is constant over a bin of lags [a, b), the changes of the reference in that
    bin telescope: Σ_j [u(k − j) − u(k − j − 1)] = u(k − a) − u(k − b). The row of sample k holds
    these numbers, and the error it explains is u(k) − y(k).
    """
    last = int(edges[-1])
    for reference, output in records:
        # Before the record the robot rested at its first reference.
        known = np.concatenate([np.full(last, reference[0]), reference])
        for start in range(0, len(reference), _BLOCK_SAMPLES):
            stop = min(start + _BLOCK_SAMPLES, len(reference))
            lagged = np.stack(
                [known[last - edge + start : last - edge + stop] for edge in edges.tolist()], axis=1
            )
            yield lagged[:, :-1] - lagged[:, 1:], reference[start:stop] - output[start:stop]


def _roughness(taps: int) -> FloatArray:
    """Return the penalty matrix DᵀD on second differences, shape (taps, taps).

    A smooth record cannot distinguish neighbouring taps; the penalty makes the response smooth
    where the record leaves it open.
    """
    second = np.diff(np.eye(taps), 2, axis=0)
    return np.asarray(second.T @ second) * 1e-2
