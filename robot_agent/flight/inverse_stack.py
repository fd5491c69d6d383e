"""Several inverse models evaluated together: networks of equal shape as one stack of matrices."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from nufleet.robot_agent.flight.inverse_model import InverseModel, NetworkInverse
from nufleet.shared.arrays import FloatArray

_Single = NDArray[np.float32]


class InverseStack:
    """Evaluates inverse models of one layout at the same inputs.

    Five networks of the paper's size cost two to three times as much as one. Networks of equal
    shape are multiplied in one call per layer, in single precision, in which they were trained and
    are stored: their weights then fit into a processor's cache. Other models are called one by one.
    """

    def __init__(self, inverses: Sequence[InverseModel]) -> None:
        """Sort the models by shape, and stack those that have one.

        Args:
            inverses: Inverse models, all with the inputs of one layout.
        """
        self._count = len(inverses)
        shapes: dict[tuple[tuple[int, ...], ...], list[int]] = {}
        self._alone: list[tuple[int, InverseModel]] = []
        networks = {i: m for i, m in enumerate(inverses) if isinstance(m, NetworkInverse)}
        for index, inverse in enumerate(inverses):
            if index in networks:
                shapes.setdefault(networks[index].shape, []).append(index)
            else:
                self._alone.append((index, inverse))
        self._stacks = [
            (np.array(members), _Stack([networks[i] for i in members]))
            for members in shapes.values()
        ]

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return γ of every model, shape (models, m), in unit/s, for inputs of shape (m, inputs).

        A model's answer that is not finite is returned as it is.
        """
        gamma = np.empty((self._count, len(inputs)))
        with np.errstate(over="ignore", invalid="ignore"):
            for members, stack in self._stacks:
                gamma[members] = stack(inputs)
            for index, inverse in self._alone:
                gamma[index] = inverse(inputs)
        return gamma


class _Stack:
    """Networks of one shape; the scales of inputs and output are folded into the outer layers."""

    def __init__(self, networks: Sequence[NetworkInverse]) -> None:
        folded = [network.folded() for network in networks]
        layers = len(folded[0])
        self._weights: list[_Single] = []
        self._biases: list[_Single] = []
        for layer in range(layers):
            weights = np.stack([each[layer][0] for each in folded])
            biases = np.stack([each[layer][1] for each in folded])[:, np.newaxis]
            self._weights.append(np.ascontiguousarray(weights, dtype=np.float32))
            self._biases.append(np.ascontiguousarray(biases, dtype=np.float32))

    def __call__(self, inputs: FloatArray) -> FloatArray:
        activity: _Single = inputs.astype(np.float32)[np.newaxis]
        for weight, bias in zip(self._weights[:-1], self._biases[:-1], strict=True):
            activity = np.matmul(activity, weight)
            activity += bias
            np.maximum(activity, np.float32(0.0), out=activity)
        gamma = np.matmul(activity, self._weights[-1]) + self._biases[-1]
        return np.asarray(gamma[..., 0], dtype=np.float64)
