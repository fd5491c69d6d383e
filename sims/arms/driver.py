"""The driver `arm`: one simulated arm per entry, each in a process of its own if need be."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from nufleet.robot_agent.robot import Robot
from nufleet.shared.robots.drivers import require_packages
from nufleet.shared.strict import Strict
from nufleet.sims.arms.settings import ArmSettings


class ArmDriver:
    """Builds arms; they share no state, so each can run in a process of its own."""

    settings: type[Strict] = ArmSettings
    """Model that validates one robot's settings."""
    shares_process = False
    """Whether all robots of this kind in a fleet must run in one process."""
    environment: Mapping[str, str] = {}
    """Environment variables that the process calling `build` needs from its start."""

    def require(self) -> None:
        """Check that MuJoCo and Gymnasium are installed."""
        require_packages("simulated arms", "arms", "mujoco", "gymnasium")

    def build(
        self, settings: Mapping[str, ArmSettings], rng: np.random.Generator
    ) -> dict[str, Robot]:
        """Build the robots, disconnected, by name; raises InvalidInputError without MuJoCo."""
        self.require()
        from nufleet.sims.arms.robot import Arm

        generators = rng.spawn(len(settings))
        return {
            name: Arm(name, entry, own)
            for (name, entry), own in zip(settings.items(), generators, strict=True)
        }


DRIVER = ArmDriver()
