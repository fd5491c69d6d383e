"""White measurement noise, drawn once per sample and the same for every reading of that sample."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray


class MeasurementNoise:
    """Independent normal noise on every state of every axis.

    The draws depend only on the generator and on the number of samples that have passed. Playing a
    signal at once or sample by sample therefore gives the same measurements.
    """

    def __init__(self, sigma: FloatArray, rng: np.random.Generator) -> None:
        """Start with the noise of the first sample.

        Args:
            sigma: Standard deviation of each state, shape (axes, states), in the states' units.
            rng: Generator of the noise.
        """
        self._sigma = sigma
        self._rng = rng
        self._aside_rng = rng.spawn(1)[0]
        self._now: FloatArray = self._draw(1)[0]

    @property
    def now(self) -> FloatArray:
        """Noise of the current sample, shape (axes, states)."""
        return self._now

    def aside(self) -> FloatArray:
        """Return new noise for a measurement outside the samples, shape (axes, states).

        It comes from a stream of its own, so that it does not shift the noise of the samples.
        """
        return np.asarray(self._sigma * self._aside_rng.standard_normal(self._sigma.shape))

    def take(self, samples: int) -> FloatArray:
        """Return the noise of the next samples, the current one included, and advance past them.

        Args:
            samples: Number of samples.

        Returns:
            The noise, shape (samples, axes, states).
        """
        ahead = np.concatenate([self._now[np.newaxis], self._draw(samples)])
        self._now = ahead[-1]
        return ahead[:-1]

    def _draw(self, samples: int) -> FloatArray:
        return self._sigma * self._rng.standard_normal((samples, *self._sigma.shape))
