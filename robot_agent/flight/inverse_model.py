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
