"""The tracking error of a closed loop as the answer to the changes of its reference.

A loop with the reference u and the output y leaves the error

    u(k) − y(k) = Σ_j g(j) [u(k − j) − u(k − j − 1)],

where g(j) = 1 − s(j) and s is the unit step response. A loop that comes to rest where its reference
is has g → 0. Here g is piecewise linear between nodes that lie close together at first and widen
with the lag, since a late answer varies slowly, and constant after the last node: g∞, the share of
a reference at rest by which the output misses it.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.errors import InvalidInputError

LAGS_MAX = 100_000
"""Largest number of samples that an answer may last."""

_FINE_S = 0.3  # up to this lag the nodes are equally far apart; beyond it they spread
_FINE_NODES = 40  # most nodes up to that lag; none is closer than two samples to the next
_WIDENING = 1.15  # ratio of the lags of neighbouring nodes beyond it
_BLOCK_SAMPLES = 4096  # rows of `columns` held in memory at a time


@dataclass(frozen=True)
class ErrorBasis:
    """The parameters of an error response: its value at every node, and g∞ as the last one."""

    sample_time_s: float
    """Time between samples."""
    settling_time_s: float
    """Time after which a step of the reference has no more effect."""

    @cached_property
    def nodes(self) -> np.ndarray:
        """Lags of the nodes in samples, ascending from 0, shape (nodes,), at least two.

        Raises:
            InvalidInputError: The answer lasts more than `LAGS_MAX` samples.
        """
        step_s, last_s = self.sample_time_s, self.settling_time_s
        if last_s > LAGS_MAX * step_s:
            raise InvalidInputError(
                f"an answer of {last_s:g} s lasts {last_s / step_s:.0f} samples of {step_s:g} s, "
                f"and a model of it holds at most {LAGS_MAX}: give a shorter settling time"
            )
        fine = np.arange(0.0, _FINE_S, max(2 * step_s, _FINE_S / _FINE_NODES))
        spread = int(np.ceil(np.log(max(last_s / _FINE_S, 1.0)) / np.log(_WIDENING))) + 1
        lags_s = np.concatenate([fine, _FINE_S * _WIDENING ** np.arange(spread)])
        lags = np.unique(np.round(np.minimum(lags_s, last_s) / step_s).astype(int))
        return lags if len(lags) > 1 else np.array([0, 1])

    @property
    def size(self) -> int:
        """Number of parameters."""
        return len(self.nodes) + 1

    def columns(self, reference: FloatArray, before: float) -> FloatArray:
        """Return the matrix A of the error A x that parameters x leave along a reference.

        Args:
            reference: Reference u, shape (samples,), in the axis's unit.
            before: Reference at which the robot rested before the first sample.

        Returns:
            The matrix, shape (samples, size), in the axis's unit.
        """
        return np.concatenate(list(self.blocks(reference, before)))

    def blocks(self, reference: FloatArray, before: float) -> Iterator[FloatArray]:
        """Yield the rows of `columns` in blocks, since a long record's matrix may be large.

        Args:
            reference: Reference u, shape (samples,), in the axis's unit.
            before: Reference at which the robot rested before the first sample.

        Yields:
            Some of the rows, shape (rows, size), in the axis's unit.
        """
        nodes, samples = self.nodes, len(reference)
        last = int(nodes[-1]) + 1
        known = np.concatenate([np.full(last, before), reference])
        total = np.concatenate([[0.0], np.cumsum(known)])
        for start in range(last, last + samples, _BLOCK_SAMPLES):
            end = min(start + _BLOCK_SAMPLES, last + samples)
            # Means of the reference over the lags from one node's next to the other. With g linear
            # between nodes, its differences are constant there, and summation by parts turns
            # Σ g(j) Δu(k − j) into a sum over these means, each times a change of g.
            boxes = np.empty((self.size, end - start))
            boxes[0], boxes[-1] = known[start:end], known[start - last : end - last]
            for box, (a, b) in zip(boxes[1:-1], pairwise(nodes), strict=True):
                np.subtract(total[start - a : end - a], total[start - b : end - b], out=box)
                np.divide(box, b - a, out=box)
            boxes[:-1] -= boxes[1:]
            yield boxes.T

    def response(self, omega_rad_s: FloatArray) -> ComplexArray:
        """Return the matrix X of the error's frequency response X x; the loop's is z = 1 − X x.

        Args:
            omega_rad_s: Frequencies in rad/s, shape (frequencies,).

        Returns:
            The matrix, shape (frequencies, size), without unit.
        """
        nodes = self.nodes
        turn = omega_rad_s * self.sample_time_s  # phase per sample

        def mean(first: int, end: int) -> ComplexArray:
            # The mean of e^{−jkθ} over a range of k is a Dirichlet kernel about its centre.
            return np.asarray(
                np.exp(-0.5j * turn * (first + end - 1)) * dirichlet(turn, int(end - first))
            )

        between = [mean(a + 1, b + 1) for a, b in pairwise(nodes)]
        last = np.exp(-1j * turn * (nodes[-1] + 1))
        boxes = np.stack([np.ones_like(last), *between, last], axis=1)
        return np.concatenate([boxes[:, :-1] - boxes[:, 1:], boxes[:, -1:]], axis=1)


def dirichlet(turn: FloatArray, terms: int) -> FloatArray:
    """Return the periodic sinc function sin(n θ / 2) / (n sin(θ / 2)), and its limit ±1 at 2π k.

    Args:
        turn: Angles θ in rad, of any shape, which the result has too.
        terms: Number n of the terms e^{jkθ} of which this is the mean about their centre.
    """
    half = turn / 2
    below = np.sin(half)
    limit = np.abs(below) < 1e-9  # there the next term of the series is below 1e-18 n²
    mean = np.sin(terms * half) / np.where(limit, 1.0, terms * below)
    return np.asarray(np.where(limit, np.cos(np.pi * np.round(half / np.pi) * (terms - 1)), mean))
