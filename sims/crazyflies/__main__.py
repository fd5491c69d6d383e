"""`python -m nufleet.sims.crazyflies`: a simulated Crazyflie at a UDP port, until interrupted."""

from __future__ import annotations

import threading
import time

import click
import numpy as np

from nufleet.sims.crazyflies.firmware import Firmware
from nufleet.sims.crazyflies.peer import Air, Peer
from nufleet.sims.crazyflies.plant import KnownLoop, LoopSettings


@click.command()
@click.option("--port", default=19850, show_default=True, help="UDP port to listen on.")
@click.option("--omega", default=6.0, show_default=True, help="Natural frequency in rad/s.")
@click.option("--damping", default=0.7, show_default=True, help="Damping ratio.")
@click.option("--jitter", default=0.0, show_default=True, help="Mean delay of packets in s.")
@click.option("--loss", default=0.0, show_default=True, help="Share of packets that are lost.")
def serve(port: int, omega: float, damping: float, jitter: float, loss: float) -> None:
    """Serve a simulated Crazyflie at a UDP port until it is interrupted."""
    rng = np.random.default_rng()
    plant = KnownLoop(LoopSettings(omega_rad_s=omega, damping_ratio=damping), (0.0, 0.0, 0.0))
    firmware = Firmware(plant, rng, now_s=time.monotonic(), noise_m=0.001)
    with Peer(firmware, rng, Air(jitter_s=jitter, loss=loss), port) as peer:
        click.echo(f"a simulated Crazyflie answers at {peer.uri}", err=True)
        threading.Event().wait()


if __name__ == "__main__":
    serve()
