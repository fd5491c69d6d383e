"""The drivers of the simulated robots that need no simulator beyond this package."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings


class DoubleIntegratorDriver:
    """Builds the robots of the paper's Section V; each can run in a process of its own."""

    settings: type[DoubleIntegratorSettings] = DoubleIntegratorSettings
    """Settings of one robot in a fleet file."""
    shares_process = False
    """Whether the robots of a fleet have to run in one process."""
    environment: Mapping[str, str] = {}
    """Environment variables that the process of a robot needs."""

    def build(
        self, settings: Mapping[str, DoubleIntegratorSettings], rng: np.random.Generator
    ) -> Mapping[str, DoubleIntegrator]:
        """Build the robots, disconnected, by name; each gets a noise stream of its own."""
        streams = rng.spawn(len(settings))
        return {
            name: DoubleIntegrator(own, stream)
            for (name, own), stream in zip(settings.items(), streams, strict=True)
        }


DOUBLE_INTEGRATOR = DoubleIntegratorDriver()
