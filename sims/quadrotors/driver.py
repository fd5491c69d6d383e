"""The driver `quadrotor`: all simulated quadrotors of a fleet in one process."""

from __future__ import annotations

import os
from collections.abc import Mapping
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from nufleet.robot_agent.robot import Robot
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.drivers import require_packages
from nufleet.shared.strict import Strict
from nufleet.sims.quadrotors.environment import environment
from nufleet.sims.quadrotors.settings import QuadrotorSettings

if TYPE_CHECKING:
    from nufleet.sims.quadrotors.simulator import Hangar


class QuadrotorDriver:
    """Builds quadrotors that share crazyflow and its compiled programs."""

    settings: type[Strict] = QuadrotorSettings
    """Model that validates one robot's settings."""
    shares_process = True
    """Whether all robots of this kind in a fleet must run in one process."""

    @property
    def environment(self) -> Mapping[str, str]:
        """Environment variables that the process calling `build` needs from its start."""
        return environment()

    @cached_property
    def _hangar(self) -> Hangar:
        # Kept, because a program takes seconds to compile and flies vehicles of any parameters.
        from nufleet.sims.quadrotors.simulator import Hangar

        return Hangar()

    def require(self) -> None:
        """Check that crazyflow, and JAX with it, are installed."""
        require_packages("simulated quadrotors", "quadrotors", "crazyflow", "jax")

    def build(
        self, settings: Mapping[str, QuadrotorSettings], rng: np.random.Generator
    ) -> dict[str, Robot]:
        """Build the robots, disconnected, by name; compiles one program per kind of vehicle.

        Args:
            settings: Settings of each robot, by name.
            rng: Generator of the robots' measurement noise.

        Raises:
            InvalidInputError: crazyflow is missing, or SciPy was imported without its array
                interface.
        """
        self.require()
        _require_scipy_array_interface()
        from nufleet.sims.quadrotors.robot import Quadrotor

        hangar = self._hangar
        generators = rng.spawn(len(settings))
        return {
            name: Quadrotor(name, entry, *hangar.plant(entry, own), own)
            for (name, entry), own in zip(settings.items(), generators, strict=True)
        }


def _require_scipy_array_interface() -> None:
    os.environ.setdefault("SCIPY_ARRAY_API", "1")  # early enough where SciPy is not imported yet
    import jax
    from scipy.spatial.transform import Rotation

    level = Rotation.from_quat(jax.numpy.array([0.0, 0.0, 0.0, 1.0])).as_matrix()
    if not isinstance(level, jax.Array):
        raise InvalidInputError(
            "SciPy was imported before SCIPY_ARRAY_API=1 was set, and crazyflow needs it: "
            "set it in the environment of the process that hosts the quadrotors"
        )


DRIVER = QuadrotorDriver()
