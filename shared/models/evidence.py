"""What flights tell about the error response of one axis, as sums that add up."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.models.error_response import ErrorBasis
from nufleet.shared.strict import NonNegative, Strict

_LARGEST = 1e9  # no robot goes farther, in m or rad, and no square of it overflows
_DISTORTION = 0.3  # least share of an error due to friction that is beyond a linear answer
_SURE = 2.0  # standard deviations of what chance may explain
_ROUNDED = 0.06  # share by which a noise's mean square is found too large or too small
_HELD = (0.3, 0.7, 1.4)  # how far friction may hold an axis, as shares of its reference's size
_LATE = (0.0, 0.02, 0.06, 0.16)  # when this shows in its output, in settling times
_INDEPENDENT = 1e-9  # least power of a direction that a motion shows, as a share of the largest


class Evidence(Strict):
    """What flights tell about one axis: the normal equations of e = A x + offset + noise.

    The offset of each flight is eliminated, so that a sensor's bias is no error response. Evidence
    on the same basis adds up.
    """

    normal: Annotated[tuple[float, ...], Field(min_length=1)]
    """AᵀA, row by row, size × size numbers in unit²."""
    right: Annotated[tuple[float, ...], Field(min_length=1)]
    """Aᵀe, size numbers in unit²."""
    squares: NonNegative
    """eᵀe in unit²."""
    rows: Annotated[int, Field(ge=1)]
    """Number of samples that count (see `thinned`), less one for each flight's offset."""
    moved: NonNegative
    """Sum of the squares of the reference's deviations from its mean, in unit²."""
    flown_s: NonNegative
    """Duration of the flights in s."""
    answered: NonNegative = 0.0
    """Sum of the squares of the output's deviations from its mean, in unit²."""
    left: NonNegative = 0.0
    """Sum of the squares of the error beyond any linear answer, in unit²."""
    distorted: NonNegative = 0.0
    """The part of it that goes with friction's error, beyond chance, in unit²."""
    largest: NonNegative = 0.0
    """Root mean square of the reference's deviations from its mean in the largest flight."""

    @model_validator(mode="after")
    def _square(self) -> Evidence:
        if len(self.normal) != len(self.right) ** 2:
            raise ValueError(f"{len(self.right)} parameters with {len(self.normal)} products")
        return self

    @staticmethod
    def of(basis: ErrorBasis, reference: FloatArray, output: FloatArray, before: float) -> Evidence:
        """Return the evidence in one flight's record.

        Args:
            basis: Parameters of the error response.
            reference: References sent, shape (samples,), in the axis's unit.
            output: Outputs measured before each reference acted, shape (samples,).
            before: Reference at which the robot rested before the record.

        Raises:
            InvalidInputError: The record has fewer than two samples, numbers that are not finite,
                or absurd ones.
        """
        if len(reference) < 2 or not (np.isfinite(reference).all() and np.isfinite(output).all()):
            raise InvalidInputError(
                f"a record of {len(reference)} samples, or one with numbers that are not finite, "
                "tells nothing of a robot"
            )
        largest = max(float(np.abs(reference).max()), float(np.abs(output).max()))
        if largest > _LARGEST:
            raise InvalidInputError(f"a record that reaches {largest:.3g} tells nothing of a robot")
        samples = len(reference)
        error = reference - output
        error = error - error.mean()
        held = _held(basis, reference)
        normal = np.zeros((basis.size, basis.size))
        right, sums = np.zeros(basis.size), np.zeros(basis.size)
        together = np.zeros((basis.size, held.shape[1]))
        done = 0
        for columns in basis.blocks(reference, before):
            rows = slice(done, done + len(columns))
            normal += columns.T @ columns
            right += columns.T @ error[rows]
            together += columns.T @ held[rows]
            sums += columns.sum(axis=0)
            done += len(columns)
        normal -= np.outer(sums, sums) / samples  # the offset takes every column's mean
        left, distorted = _beyond(normal, right, error, held, together)
        return Evidence(
            normal=tuple(normal.ravel().tolist()),
            right=tuple(right.tolist()),
            squares=float(error @ error),
            rows=samples - 1,
            moved=float(np.sum((reference - reference.mean()) ** 2)),
            flown_s=samples * basis.sample_time_s,
            answered=float(np.sum((output - output.mean()) ** 2)),
            left=left,
            distorted=distorted,
            largest=float(np.std(reference)),
        )

    def thinned(self, lasting: float) -> Evidence:
        """Return the evidence of a record in which what is unexplained lasts several samples.

        It shows no more than as many times fewer samples with noise that is new at each of them.

        Args:
            lasting: Correlation time of what is unexplained, in samples, at least 1.
        """
        rows = max(1, round(self.rows / lasting))
        share = rows / self.rows
        return Evidence(
            normal=tuple(share * each for each in self.normal),
            right=tuple(share * each for each in self.right),
            squares=share * self.squares,
            rows=rows,
            moved=share * self.moved,
            flown_s=self.flown_s,
            answered=share * self.answered,
            left=share * self.left,
            distorted=share * self.distorted,
            largest=self.largest,
        )

    def __add__(self, other: Evidence) -> Evidence:
        """Return the evidence of both; they must be on the same basis."""
        return Evidence(
            normal=tuple(a + b for a, b in zip(self.normal, other.normal, strict=True)),
            right=tuple(a + b for a, b in zip(self.right, other.right, strict=True)),
            squares=self.squares + other.squares,
            rows=self.rows + other.rows,
            moved=self.moved + other.moved,
            flown_s=self.flown_s + other.flown_s,
            answered=self.answered + other.answered,
            left=self.left + other.left,
            distorted=self.distorted + other.distorted,
            largest=max(self.largest, other.largest),
        )

    def bounded(self, noise_std: float) -> float:
        """Return the share of the error that may not grow with the size of the motion.

        An axis with dry friction F, held by a stiffness K, is off by up to F/K however far it
        moves: from a small motion, this looks like a part of its answer. The distortion that comes
        with it gives it away, and tells it from noise and gusts.

        Args:
            noise_std: Standard deviation of what no linear response explains, in the axis's unit.
        """
        unexplained = noise_std**2 * self.rows
        answer = self.answered - unexplained
        chance = _SURE * float(np.sqrt(2 / self.rows)) + _ROUNDED
        if self.largest > 0 and answer <= chance * unexplained:
            return 1.0  # it never left its place, as far as its sensor shows
        least = min(self.squares, answer) if self.largest > 0 else self.squares
        if self.distorted <= 0 or least <= 0:
            return 0.0
        odd = self.distorted / self.left * unexplained
        return min(1.0, float(np.sqrt(odd / least)) / _DISTORTION)


def _held(basis: ErrorBasis, reference: FloatArray) -> FloatArray:
    """Return what friction may do to an axis, shape (samples, columns), in the axis's unit.

    An axis that friction holds moves only once its reference is far enough away (the play operator:
    Krasnosel'skii and Pokrovskii, Systems with Hysteresis, 1989). Neither this distance nor what
    the loop makes of it is known. Several distances, each with several lags, nearly span both.
    """
    reaches = float(np.std(reference)) * np.array(_HELD)[:, np.newaxis]
    slacks = reference - held_within(reference - reaches, reference + reaches)
    held = np.zeros((len(_HELD), len(_LATE), len(reference)))
    for columns, late in zip(held.swapaxes(0, 1), _LATE, strict=True):
        lag = min(round(late * basis.settling_time_s / basis.sample_time_s), len(reference))
        columns[:, lag:] = slacks[:, : len(reference) - lag]
    held -= held.mean(axis=2, keepdims=True)
    return held.reshape(-1, len(reference)).T


def held_within(lowest: FloatArray, highest: FloatArray) -> FloatArray:
    """Return where something lies that bounds push before them, all of shape (rows, samples).

    It begins within the first bounds, and moves only where it must. What the bounds of several
    samples in a row do to any place is to bound it, too, so that doubling the number of samples
    gives all places in a few steps.
    """
    low, high = lowest.copy(), highest.copy()
    low[:, 0] = high[:, 0] = (lowest[:, 0] + highest[:, 0]) / 2
    step = 1
    while step < low.shape[1]:
        before_low, before_high = low[:, :-step].copy(), high[:, :-step].copy()
        after_low, after_high = low[:, step:], high[:, step:]
        np.clip(before_low, after_low, after_high, out=before_low)
        np.clip(before_high, after_low, after_high, out=before_high)
        low[:, step:], high[:, step:] = before_low, before_high
        step *= 2
    return low


def _beyond(
    normal: FloatArray,
    right: FloatArray,
    error: FloatArray,
    held: FloatArray,
    together: FloatArray,
) -> tuple[float, float]:
    """Return how much of an error is beyond a linear answer, and how much of that is friction's.

    The first is what least squares leave, in unit², and the second what they explain of it beyond
    chance.

    Args:
        normal: AᵀA of the linear answer, with the offset eliminated, shape (size, size).
        right: Aᵀe, shape (size,).
        error: Error e, without its mean, shape (samples,).
        held: What friction may do, H, without its mean, shape (samples, columns).
        together: AᵀH, shape (size, columns).
    """
    inverse = np.linalg.pinv(normal, rcond=_INDEPENDENT, hermitian=True)
    beyond = held.T @ held - together.T @ inverse @ together
    toward = held.T @ error - together.T @ inverse @ right
    explained = toward @ np.linalg.pinv(beyond, rcond=_INDEPENDENT, hermitian=True) @ toward
    left = max(0.0, float(error @ error - right @ inverse @ right))
    number = held.shape[1]
    chance = (number + _SURE * np.sqrt(2 * number)) / len(error)
    return left, min(left, max(0.0, float(explained - chance * left)))
