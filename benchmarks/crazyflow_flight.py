"""crazyflow's Crazyflie, flown by the driver of real ones, beside crazyflow flown directly.

The vehicle flies behind a simulated firmware over UDP, through cflib, in real time. A set-point
acts from the next sample of the simulation on, 10 ms later on average.

    SCIPY_ARRAY_API=1 python -m benchmarks.crazyflow_flight
"""

from __future__ import annotations

import time

import numpy as np

from nufleet.robot_agent.drivers.crazyflie.robot import Crazyflie
from nufleet.robot_agent.drivers.crazyflie.settings import CrazyflieSettings
from nufleet.robot_agent.motion.resampling import outputs_at_samples
from nufleet.shared.arrays import FloatArray
from nufleet.shared.robots.drivers import settings_of
from nufleet.shared.robots.fleet_file import find_fleet_file, read_fleet_file
from nufleet.sims.crazyflies.firmware import Firmware
from nufleet.sims.crazyflies.peer import Peer
from nufleet.sims.crazyflies.quadrotor_plant import QuadrotorPlant
from nufleet.sims.quadrotors.driver import DRIVER
from nufleet.sims.quadrotors.robot import Quadrotor

VEHICLE = "target"
OMEGA_RAD_S, AMPLITUDE_M, SAMPLES, SETTLING = 2.0, 0.1, 600, 150


def response(outputs: FloatArray, references: FloatArray, times_s: FloatArray) -> complex:
    """Return output over reference at the tone, after the transient."""
    phase = OMEGA_RAD_S * times_s[SETTLING:]
    basis = np.stack([np.cos(phase), np.sin(phase), np.ones(len(phase))], axis=1)
    signals = np.stack([outputs, references], axis=1)[SETTLING:]
    cosine, sine, _ = np.linalg.lstsq(basis, signals, rcond=None)[0]
    return complex((cosine[0] - 1j * sine[0]) / (cosine[1] - 1j * sine[1]))


def main() -> None:
    """Fly both, and print how they differ."""
    path = find_fleet_file("paper_quadrotors")
    rng = np.random.default_rng(0)
    settings = settings_of(read_fleet_file(path), path, (VEHICLE,), DRIVER)
    simulated = DRIVER.build(settings, rng)[VEHICLE]
    simulated.connect()
    if not isinstance(simulated, Quadrotor):
        raise TypeError(f"{VEHICLE} is no quadrotor")
    even_s = simulated.spec.sample_time_s * np.arange(SAMPLES)
    references = np.zeros((SAMPLES, 2))
    references[:, 0] = AMPLITUDE_M * np.sin(OMEGA_RAD_S * even_s)
    plant = QuadrotorPlant(*simulated.flown_by)
    direct = response(simulated.run(references)[:, 0], references[:, 0], even_s)
    firmware = Firmware(plant, rng, now_s=time.monotonic(), noise_m=0.001)
    with Peer(firmware, rng) as peer:
        drone = Crazyflie("drone", CrazyflieSettings(uri=peer.uri))
        drone.connect()
        drone.begin()
        drone.run(references)
        record = drone.record()
        drone.rest()
        drone.end()
        drone.disconnect()
    outputs, _ = outputs_at_samples(record, SAMPLES, drone.spec)
    flown = response(outputs[:, 0], references[:, 0], record.sample_s - record.sample_s[0])
    later_ms = -1e3 * np.angle(flown / direct) / OMEGA_RAD_S
    print(f"directly {direct:.4f}, through the driver {flown:.4f}:")
    print(f"gain {100 * (abs(flown / direct) - 1):+.2f} %, {later_ms:.1f} ms later")


if __name__ == "__main__":
    main()
