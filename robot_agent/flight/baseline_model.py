"""What a robot's baseline would do on a path, from records of what it did on others."""

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

_FINE_S = 0.3  # up to this lag the taps are equally wide; then they widen
_FINE_TAPS = 40  # at most, and none narrower than two samples
_WIDENING = 1.25
_LAGS_MAX = 100_000
_SAMPLES_PER_TAP = 10
_UNEXPLAINED_MAX = 0.15  # of the reference: what friction and other nonlinearities may leave
_NOISE_RATIO = 4.0  # of the noise at rest: in flight there is more
_BLOCK_SAMPLES = 4096  # of the rows of the least-squares problem that are in memory at a time


class BaselineModel(Strict):
    """The error response of one axis: y(k) = u(k) − Σ g_j [u(k − j) − u(k − j − 1)].

    g is one minus the step response, shape (taps,). `residual_std` is what the model leaves of a
    record, measurement noise included.
    """

    error_response: Annotated[tuple[float, ...], Field(min_length=1, max_length=_LAGS_MAX)]
    residual_std: NonNegative

    def error(self, reference: FloatArray) -> FloatArray:
        """Return u − y for a reference (samples,) that starts from rest."""
        change = np.diff(reference, prepend=reference[0])
        response = np.array(self.error_response[: len(change)])
        return np.asarray(oaconvolve(change, response)[: len(change)])


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
        InvalidInputError: fewer samples than the fit needs, numbers that are not finite, or a
            response of more samples than a model holds.
    """
    edges = _edges(sample_time_s, memory_s)
    taps = len(edges) - 1
    samples = sum(len(reference) for reference, _ in records)
    finite = all(np.isfinite(signal).all() for record in records for signal in record)
    if samples < _SAMPLES_PER_TAP * taps or not finite:
        raise InvalidInputError(
            f"{samples} samples are too few for a model with {taps} taps, "
            "or hold a number that is not finite"
        )
    normal, right = np.zeros((taps, taps)), np.zeros(taps)
    for columns, error in _blocks(records, edges):
        normal += columns.T @ columns
        right += columns.T @ error
    # The mean square of the columns makes the penalty independent of unit and excitation.
    penalty = 1e-4 * np.trace(normal) / taps * _roughness(taps)
    response = np.linalg.lstsq(normal + penalty, right, rcond=None)[0]
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
    """Refuse a model that does not explain the record that it was fitted to, noise apart.

    A guard would take what is left for the baseline's own error. A sensor that was late by more
    than the robot remembers, lost its place on the way or measured something else leaves much.

    Args:
        model: fitted to the record.
        reference: shape (samples,).
        noise_std: of the output at rest.
        axis: that it is of, for the error.

    Raises:
        InvalidInputError: the model leaves more than it may.
    """
    moved = float(reference.std())
    if model.residual_std > max(_UNEXPLAINED_MAX * moved, _NOISE_RATIO * noise_std):
        raise InvalidInputError(
            f"axis {axis.name} did {model.residual_std:.3g} {axis.unit} RMS that is no answer to "
            f"its reference of {moved:.3g} {axis.unit} RMS within the settling time: see to its "
            "sensor, or give a longer settling time"
        )


def samples_needed(sample_time_s: float, memory_s: float) -> int:
    """Return how many samples a record must have for `identify_baseline` to fit it.

    Raises:
        InvalidInputError: the response is of more samples than a model holds.
    """
    return _SAMPLES_PER_TAP * (len(_edges(sample_time_s, memory_s)) - 1)


def _edges(sample_time_s: float, memory_s: float) -> np.ndarray:
    """Return where the bins of lags begin and end, in samples; at least one bin of one sample."""
    fine = np.arange(0.0, _FINE_S, max(2 * sample_time_s, _FINE_S / _FINE_TAPS))
    count = int(np.ceil(np.log(max(memory_s / _FINE_S, 1.1)) / np.log(_WIDENING))) + 1
    wide = _FINE_S * _WIDENING ** np.arange(count)
    edges = np.unique(np.round(np.concatenate([fine, wide]) / sample_time_s).astype(int))
    if edges[-1] > _LAGS_MAX:
        raise InvalidInputError(
            f"a response of {memory_s:g} s is {edges[-1]} samples of {sample_time_s:g} s; a model "
            f"of the baseline holds at most {_LAGS_MAX}: give a shorter settling time"
        )
    # A robot whose sample is longer than its memory answers to the sample before, and no other.
    return edges if len(edges) > 1 else np.array([0, 1])


def _blocks(
    records: list[tuple[FloatArray, FloatArray]], edges: np.ndarray
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Yield rows of the least-squares problem and the errors they explain, block by block.

    A row holds, per bin, the sum of the reference's changes that lie in it.
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
    """Return the penalty on second differences: smooth records do not tell neighbours apart."""
    second = np.diff(np.eye(taps), 2, axis=0)
    return np.asarray(second.T @ second) * 1e-2
