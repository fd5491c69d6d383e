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
_DISTORTION = 0.43  # of a Coulomb friction's force under a sinusoidal velocity, by its fundamental
_STICKS = 0.15  # share of its error beyond a linear answer that an axis leaves which sticks
_SURE = 2.0  # standard deviations of the noise's mean square that may hide what is not linear


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
    sensed: NonNegative = 0.0
    """Sum of the squares of the sensor's noise, as far as it is new at each sample, in unit²."""
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
        normal = np.zeros((basis.size, basis.size))
        right, sums = np.zeros(basis.size), np.zeros(basis.size)
        done = 0
        for columns in basis.blocks(reference, before):
            normal += columns.T @ columns
            right += columns.T @ error[done : done + len(columns)]
            sums += columns.sum(axis=0)
            done += len(columns)
        normal -= np.outer(sums, sums) / samples  # the offset takes every column's mean
        return Evidence(
            normal=tuple(normal.ravel().tolist()),
            right=tuple(right.tolist()),
            squares=float(error @ error),
            rows=samples - 1,
            moved=float(np.sum((reference - reference.mean()) ** 2)),
            flown_s=samples * basis.sample_time_s,
            answered=float(np.sum((output - output.mean()) ** 2)),
            sensed=_white(output) * (samples - 1),
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
            sensed=share * self.sensed,
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
            sensed=self.sensed + other.sensed,
            largest=max(self.largest, other.largest),
        )

    def bounded(self, noise_std: float) -> float:
        """Return the share of the error that may not grow with the size of the motion.

        An axis with dry friction F, held by a stiffness K, is off by up to F/K however far it
        moves: from a small motion, this looks like a part of its answer. The distortion that comes
        with it gives it away. While the axis slides, a force with the sign of a sinusoidal velocity
        is distorted by 0.43 of its fundamental; while it sticks, which is linear in its way, less
        is left.

        Args:
            noise_std: Standard deviation of what no linear response explains, in the axis's unit.
        """
        if self.largest > 0 and self.answered <= 2 * self.sensed:
            return 1.0  # it never left its place, as far as its sensor shows
        # The fewer samples, the more of their noise's mean square is chance.
        noise = self.sensed / self.rows * (1 + _SURE * float(np.sqrt(2 / self.rows)))
        least = min(self.squares, self.answered) if self.largest > 0 else self.squares
        if noise_std**2 <= noise or least <= 0:
            return 0.0
        odd_share = float(np.sqrt((noise_std**2 - noise) * self.rows / least))
        return min(1.0, max(odd_share / _DISTORTION, (odd_share / _STICKS) ** 2))


def _white(output: FloatArray) -> float:
    """Return the variance of noise that is new at each sample, in unit²: a smooth motion hardly has
    a fourth difference, and noise is 70 times its variance there."""
    fourth = np.diff(output, 4)
    return float(np.mean(fourth**2)) / 70 if len(fourth) else 0.0
