"""Inverse models as a robot evaluates them: in NumPy, without torch, in microseconds per call."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.file import Experience


class InverseModel(Protocol):
    """Maps the inputs of an `InverseLayout` to its output γ."""

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return γ, shape (m,), in unit/s, for inputs in the layout's order, (m, inputs)."""


class NetworkInverse:
    """The feed-forward network of an experience, with ReLU layers and standardised ends.

    It computes h_0 = (ξ − mean) / scale, h_i = max(0, h_(i−1) W_i + b_i) for the hidden layers, and
    γ = (h W + b) scale + mean with the scale and mean of the output.
    """

    def __init__(self, experience: Experience) -> None:
        manifest, arrays = experience.manifest, experience.arrays
        self._mean = np.array(manifest.input_mean)
        self._scale = np.array(manifest.input_scale)
        self._output = manifest.output_mean, manifest.output_scale
        layers = len(manifest.hidden) + 1
        # Stored in single precision but computed in double: converting between the two at each
        # call would cost more than single precision saves.
        self._layers = [
            (arrays[f"weight_{i}"].astype(np.float64), arrays[f"bias_{i}"].astype(np.float64))
            for i in range(layers)
        ]

    @property
    def shape(self) -> tuple[tuple[int, ...], ...]:
        """Shape of every layer's weights, (inputs of the layer, outputs of the layer)."""
        return tuple(weight.shape for weight, _ in self._layers)

    def folded(self) -> list[tuple[FloatArray, FloatArray]]:
        """Return weights and bias of every layer, with the standardisation of both ends in them.

        Without the ends, γ = max(0, … max(0, ξ W_0 + b_0) …) W + b computes the same numbers.
        """
        layers = list(self._layers)
        weight, bias = layers[0]
        scaled = weight / self._scale[:, np.newaxis]
        layers[0] = scaled, bias - self._mean @ scaled
        weight, bias = layers[-1]
        mean, scale = self._output
        layers[-1] = weight * scale, bias * scale + mean
        return layers

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return γ, shape (m,), in unit/s, for inputs in the layout's order, (m, inputs)."""
        activity = (inputs - self._mean) / self._scale
        for weight, bias in self._layers[:-1]:
            activity = activity @ weight
            activity += bias
            np.maximum(activity, 0.0, out=activity)
        weight, bias = self._layers[-1]
        mean, scale = self._output
        return np.asarray((activity @ weight + bias)[:, 0] * scale + mean)
