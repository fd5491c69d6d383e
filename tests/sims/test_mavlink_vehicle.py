"""The simulated vehicle: MAVSDK flies it, and its loop answers as the closed form says."""

from __future__ import annotations

import time

import numpy as np
import pytest
from mavsdk.component_type import ComponentType
from mavsdk.mavsdk import Configuration, Mavsdk
from mavsdk.plugins.action.action import Action
from mavsdk.plugins.offboard.offboard import Offboard, OffboardError, PositionNedYaw
from mavsdk.plugins.telemetry.telemetry import Telemetry
from polling import PATIENCE_S, wait_until
from ports import free_port

from nufleet.sims.mavlink_vehicle.loop import Loop, LoopSettings, frequency_response
from nufleet.sims.mavlink_vehicle.udp_vehicle import UdpVehicle
from nufleet.sims.mavlink_vehicle.vehicle import SimulatedVehicle, VehicleSettings


def test_mavsdks_client_finds_arms_flies_lands_and_kills_it() -> None:
    vehicle = SimulatedVehicle(VehicleSettings(), np.random.default_rng(0), time.monotonic())
    port = free_port()
    configuration = Configuration.create_with_component_type(ComponentType.GROUND_STATION)
    client = Mavsdk(configuration)
    try:
        assert client.add_any_connection(f"udpin://127.0.0.1:{port}") == 0
        with UdpVehicle(vehicle, ("127.0.0.1", port)):
            system = client.first_autopilot(PATIENCE_S)
            assert system is not None
            action, offboard, telemetry = Action(system), Offboard(system), Telemetry(system)
            action.arm()
            assert vehicle.armed
            offboard.set_position_ned(PositionNedYaw(0.3, 0.2, -0.6, 0.0))
            started: list[None] = []

            def starts() -> bool:  # refused until set-points have streamed for a while
                try:
                    started.append(offboard.start())
                except OffboardError:
                    return False
                return True

            wait_until(starts)
            assert vehicle.mode == "offboard"
            wait_until(lambda: bool(np.abs(vehicle.position - [0.2, 0.3, 0.6]).max() < 0.01))
            wait_until(lambda: abs(telemetry.position_velocity_ned().position.down_m + 0.6) < 0.05)
            wait_until(telemetry.in_air)
            assert telemetry.battery().remaining_percent == pytest.approx(90, abs=2)
            action.land()
            wait_until(lambda: not vehicle.armed)
            assert vehicle.position[2] == 0.0
            action.arm()
            action.kill()
            assert not vehicle.armed
    finally:
        client.destroy()


@pytest.mark.parametrize("feed_forward", [False, True])
def test_the_closed_form_is_the_response_of_the_loop(feed_forward: bool) -> None:
    settings, step_s, omega = LoopSettings(delay_s=0.03), 0.02, 4.0
    loop = Loop(settings, np.zeros(3))
    times_s = step_s * np.arange(2000)
    reference, outputs, before = np.sin(omega * times_s), np.empty(2000), 0.0
    held = [(0.0, 0.0)]
    for k, place in enumerate(reference):
        outputs[k] = loop.position[0]
        # The reference of 0.03 s ago begins to act in the middle of the sample.
        held.append((place, (place - before) / step_s if feed_forward else 0.0))
        before = place
        loop.advance(step_s / 2)
        late = held[max(0, len(held) - 2)]
        loop.aim(np.array([late[0], 0, 0]), np.array([late[1], 0, 0]))
        loop.advance(step_s / 2)
    last = slice(1000, 2000)
    kernel = np.hanning(1000) * np.exp(-1j * omega * times_s[last])
    measured = (kernel @ outputs[last]) / (kernel @ reference[last])
    truth = frequency_response(settings, np.array([omega]), step_s, feed_forward=feed_forward)[0]
    assert measured == pytest.approx(truth, abs=2e-4)
    late_truth = frequency_response(
        settings,
        np.array([omega]),
        step_s,
        feed_forward=feed_forward,
        link_delay_s=0.01,
        link_jitter_s=1e-6,
    )[0]
    shifted = settings.model_copy(update={"delay_s": 0.04})
    exact = frequency_response(shifted, np.array([omega]), step_s, feed_forward=feed_forward)[0]
    assert late_truth == pytest.approx(exact, abs=2e-3)
