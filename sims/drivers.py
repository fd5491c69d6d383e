"""The drivers of the simulated robots that need no simulator beyond this package."""

from __future__ import annotations

from nufleet.shared.robots.drivers import SeparateRobots
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings

DOUBLE_INTEGRATOR = SeparateRobots(DoubleIntegratorSettings, DoubleIntegrator)
"""The robots of the paper's Section V."""
