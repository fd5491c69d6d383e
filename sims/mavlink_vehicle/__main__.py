"""`python -m nufleet.sims.mavlink_vehicle`: a vehicle to try the driver `mavlink` without one."""

from __future__ import annotations

import time

import click
import numpy as np


@click.command()
@click.option("--to", default="127.0.0.1:14540", show_default=True, help="Where it sends to.")
@click.option("--system", type=click.IntRange(1, 255), default=1, show_default=True)
@click.option("--profile", type=click.Choice(["px4", "ardupilot"]), default="px4")
@click.option("--omega", type=float, default=6.0, show_default=True, help="ω₀ of its loop, rad/s.")
@click.option("--damping", type=float, default=0.7, show_default=True, help="ζ of its loop.")
def main(to: str, system: int, profile: str, omega: float, damping: float) -> None:
    """Simulate a multicopter that speaks MAVLink over UDP, until it is interrupted."""
    from nufleet.shared.strict import validation_errors_as
    from nufleet.sims.mavlink_vehicle.udp_vehicle import UdpVehicle
    from nufleet.sims.mavlink_vehicle.vehicle import SimulatedVehicle, VehicleSettings

    host, _, port = to.rpartition(":")
    if not host or not port.isdecimal():
        raise click.BadParameter(f"{to!r} is not HOST:PORT", param_hint="--to")
    with validation_errors_as(click.UsageError, "the vehicle"):
        settings = VehicleSettings.model_validate(
            {
                "profile": profile,
                "system_id": system,
                "loop": {"omega_rad_s": omega, "damping": damping},
            }
        )
    vehicle = SimulatedVehicle(settings, np.random.default_rng(system), time.monotonic())
    with UdpVehicle(vehicle, (host, int(port))):
        click.echo(f"system {system} sends to {to}; Ctrl-C ends it")
        try:
            while True:
                time.sleep(3600.0)
        except KeyboardInterrupt:
            click.echo("ended")


if __name__ == "__main__":
    main()
