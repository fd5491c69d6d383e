"""Inverse models as a robot uses them: no torch, microseconds per call."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.file import Experience


class InverseModel(Protocol):
    """Maps the inputs of an `InverseLayout` to γ."""

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return γ, shape (m,), for inputs of shape (m, inputs)."""


class NetworkInverse:
    """The feed-forward network of an experience: ReLU layers between standardised ends."""

    def __init__(self, experience: Experience) -> None:
        manifest, arrays = experience.manifest, experience.arrays
        self._mean = np.array(manifest.input_mean)
        self._scale = np.array(manifest.input_scale)
        self._output = manifest.output_mean, manifest.output_scale
        layers = len(manifest.hidden) + 1
        # Double precision: conversions between single and double would cost more than they save.
        self._layers = [
            (arrays[f"weight_{i}"].astype(np.float64), arrays[f"bias_{i}"].astype(np.float64))
            for i in range(layers)
        ]

    def __call__(self, inputs: FloatArray) -> FloatArray:
        """Return γ, shape (m,), for inputs of shape (m, inputs)."""
        activity = (inputs - self._mean) / self._scale
        for weight, bias in self._layers[:-1]:
            activity = activity @ weight
            activity += bias
            np.maximum(activity, 0.0, out=activity)
        weight, bias = self._layers[-1]
        mean, scale = self._output
        return np.asarray((activity @ weight + bias)[:, 0] * scale + mean)
