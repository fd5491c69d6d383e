"""White measurement noise, drawn once per sample and seen alike by whoever looks at that sample."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray


class MeasurementNoise:
    """Independent normal noise on every state of every axis.

    The draws depend on the generator and on the number of samples gone by only, so that playing a
    signal at once or sample by sample gives the same measurements.
    """

    def __init__(self, sigma: FloatArray, rng: np.random.Generator) -> None:
        """Start with the noise of the first sample; `sigma` has shape (axes, states)."""
        self._sigma = sigma
        self._rng = rng
        self._aside_rng = rng.spawn(1)[0]
        self._now: FloatArray = self._draw(1)[0]

    @property
    def now(self) -> FloatArray:
        """The noise of the current sample, shape (axes, states)."""
        return self._now

    def aside(self) -> FloatArray:
        """Return noise of a measurement that is no sample, shape (axes, states); a new one each."""
        return np.asarray(self._sigma * self._aside_rng.standard_normal(self._sigma.shape))

    def take(self, samples: int) -> FloatArray:
        """Return the noise of the current and the following samples, and go past them.

        Returns:
            Shape (samples, axes, states).
        """
        ahead = np.concatenate([self._now[np.newaxis], self._draw(samples)])
        self._now = ahead[-1]
        return ahead[:-1]

    def _draw(self, samples: int) -> FloatArray:
        return self._sigma * self._rng.standard_normal((samples, *self._sigma.shape))
