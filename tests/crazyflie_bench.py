"""A Crazyflie on a test's bench: flown by its driver through cflib, over UDP."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np
import pytest

from nufleet.robot_agent.drivers.crazyflie import condition, flight, robot
from nufleet.robot_agent.drivers.crazyflie.motion_capture import Sighting
from nufleet.robot_agent.drivers.crazyflie.robot import Crazyflie
from nufleet.robot_agent.drivers.crazyflie.settings import CrazyflieSettings
from nufleet.sims.crazyflies import firmware
from nufleet.sims.crazyflies.firmware import Firmware
from nufleet.sims.crazyflies.peer import Air, Peer
from nufleet.sims.crazyflies.plant import KnownLoop, LoopSettings

LOOP = LoopSettings(omega_rad_s=25.0, damping_ratio=0.9)
"""A nimble drone, so that tests take little time."""

QUICK: dict[str, Any] = {
    "takeoff_s": 0.3,
    "landing_s": 0.3,
    "settling_time_s": 0.3,
    "omega_min_rad_s": 1.0,
    "omega_max_rad_s": 25.0,
    "limits": {"amplitude_m": 0.2, "velocity_m_s": 2.0, "acceleration_m_s2": 20.0},
    "estimator": "complementary",  # no waiting for its estimate
}


@dataclass
class Bench:
    """A drone, its driver, and the radio between them."""

    peer: Peer
    robot: Crazyflie
    settings: CrazyflieSettings

    @property
    def drone(self) -> Firmware:
        return self.peer.firmware

    def fly(self, samples: int, amplitude_m: float = 0.0, omega_rad_s: float = 8.0) -> np.ndarray:
        """Follow a sinusoid on x; return the outputs that `step` returned."""
        times_s = self.settings.sample_time_s * np.arange(samples)
        references = np.zeros((samples, 2))
        references[:, 0] = amplitude_m * np.sin(omega_rad_s * times_s)
        return self.robot.run(references)


@contextmanager
def bench(
    *,
    air: Air | None = None,
    noise_m: float = 0.0,
    start_m: tuple[float, float, float] = (0.03, -0.02, 0.0),
    sighting: Sighting | None = None,
    patience_s: float | None = 10.0,
    **settings: Any,
) -> Iterator[Bench]:
    """Put a drone on the ground, with its radio on and its driver not yet connected.

    On a machine that is busy with other things, threads rest for parts of a second. `patience_s` is
    for how long neither driver nor drone takes this for a lost link; None for as in the air.
    """
    with pytest.MonkeyPatch.context() as patched:
        if patience_s is not None:
            patched.setattr(flight, "UNMEASURED_MAX_S", patience_s)
            patched.setattr(robot, "UNMEASURED_MAX_S", patience_s)
            patched.setattr(condition, "SILENT_MAX_S", patience_s)
            for limit in ("LEVEL_OUT_S", "SWITCH_OFF_S", "WATCHDOG_S"):
                patched.setattr(firmware, limit, patience_s)
        with _benched(air, noise_m, start_m, sighting, settings) as found:
            yield found


@contextmanager
def _benched(
    air: Air | None,
    noise_m: float,
    start_m: tuple[float, float, float],
    sighting: Sighting | None,
    settings: dict[str, Any],
) -> Iterator[Bench]:
    rng = np.random.default_rng(5)
    drone = Firmware(KnownLoop(LOOP, start_m), rng, now_s=time.monotonic(), noise_m=noise_m)
    with Peer(drone, rng, air) as peer:
        chosen = CrazyflieSettings.model_validate({**QUICK, "uri": peer.uri, **settings})
        driver = Crazyflie("cf", chosen, sighting)
        try:
            yield Bench(peer, driver, chosen)
        finally:
            peer.air = Air()
            driver.disconnect()
