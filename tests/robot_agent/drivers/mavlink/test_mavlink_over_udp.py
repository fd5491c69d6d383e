"""The driver over real ports: against MAVSDK's vehicle side, and against the simulated vehicle."""

from __future__ import annotations

import json
import socket
import threading
import time
from contextlib import closing

import numpy as np
import pytest
from mavlink_air import settings
from mavsdk_vehicle import MavsdkVehicle
from polling import PATIENCE_S, wait_until
from ports import free_port

from nufleet.robot_agent.drivers.mavlink import opening, telemetry
from nufleet.robot_agent.drivers.mavlink import vehicle as vehicle_module
from nufleet.robot_agent.drivers.mavlink.driver import DRIVER
from nufleet.robot_agent.drivers.mavlink.robot import MavlinkRobot
from nufleet.shared.errors import RobotDownError, RobotError
from nufleet.sims.mavlink_vehicle.udp_vehicle import UdpVehicle
from nufleet.sims.mavlink_vehicle.vehicle import SimulatedVehicle, VehicleSettings

PATIENT = {"delay_uncertainty_s": 0.1, "height_m": 0.4, "climb_m_s": 2.0}
"""A busy machine answers late; the response is not what these tests are about."""


@pytest.fixture(autouse=True)
def patience(monkeypatch: pytest.MonkeyPatch) -> None:
    """How long the driver waits for a vehicle is stated on the virtual clock.

    On a busy machine these vehicles themselves answer late, and send a position long after they
    have dated it.
    """
    for name in ("FOUND_S", "SILENT_S", "LOST_S", "HEARTBEATS_S", "CUT_ANSWER_S"):
        monkeypatch.setattr(vehicle_module, name, PATIENCE_S)
    monkeypatch.setattr(vehicle_module, "ANSWER_S", 10.0)
    monkeypatch.setattr(opening, "FOUND_S", PATIENCE_S)
    monkeypatch.setattr(telemetry, "BACK_MAX_S", PATIENCE_S)


def robots(**systems: dict[str, object]) -> dict[str, MavlinkRobot]:
    own = {name: settings(**PATIENT, **changes) for name, changes in systems.items()}
    return dict(DRIVER.build(own, np.random.default_rng(0)))


def vehicle(system_id: int = 1) -> SimulatedVehicle:
    own = VehicleSettings(system_id=system_id)
    return SimulatedVehicle(own, np.random.default_rng(system_id), time.monotonic())


def test_mavsdks_vehicle_side_understands_the_driver() -> None:
    port = free_port()
    robot = robots(drone={"url": f"udpin://127.0.0.1:{port}"})["drone"]
    with closing(MavsdkVehicle(port)) as other:
        robot.connect()
        assert robot.health().ready
        robot.begin()
        assert set(other.armed_as) == {(True, False)}, "asked again if the answer came late"
        output = [robot.step(np.array([0.1 * k, -0.2])) for k in range(3)]
        assert np.shape(output) == (3, 2)
        last = other.set_points[-1]
        wait_until(lambda: other.set_points[-1] != last)
        # x to the east and y to the north here are y and x there, and up is −z.
        flown = {(round(one["y"], 3), round(one["x"], 3)) for one in other.set_points}
        assert {(0.0, -0.2), (0.1, -0.2), (0.2, -0.2)} <= flown
        assert other.set_points[-1]["z"] == pytest.approx(-0.4)
        assert other.set_points[-1]["type_mask"] == 0b1101_1100_0000
        record = robot.record()
        assert record is not None
        assert np.ptp(record.measured_s - record.sample_s[0]) < 60.0
        robot.rest()
        robot.kill()
        wait_until(lambda: (False, True) in other.armed_as)
        with pytest.raises(RobotDownError):
            robot.rest()
        robot.disconnect()
    assert not [one for one in threading.enumerate() if one.name.startswith("mavlink-")]


def test_two_vehicles_on_one_port_are_two_robots_and_a_third_that_is_silent_is_said(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    port = free_port()
    url = f"udpin://127.0.0.1:{port}"
    pair = robots(a={"url": url}, b={"url": url, "system_id": 2}, c={"url": url, "system_id": 3})
    with (
        UdpVehicle(vehicle(1), ("127.0.0.1", port)) as one,
        UdpVehicle(vehicle(2), ("127.0.0.1", port)) as two,
    ):
        pair["a"].connect()
        pair["b"].connect()
        pair["b"].begin()
        assert (one.vehicle.armed, two.vehicle.mode) == (False, "offboard")
        assert one.vehicle.set_points == 0
        pair["b"].disconnect()
        assert not two.vehicle.armed
        monkeypatch.setattr(opening, "FOUND_S", 1.5)
        with pytest.raises(RobotError, match=r"no heartbeat of system 3 .* heard: system 1"):
            pair["c"].connect()
        assert pair["a"].measure_output().shape == (2,)
        pair["a"].disconnect()
    assert not [one for one in threading.enumerate() if one.name.startswith("mavlink-")]


def test_an_address_that_cannot_be_opened_is_one_sentence() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
        taken.bind(("127.0.0.1", 0))
        port = taken.getsockname()[1]
        cases = {
            f"udpin://127.0.0.1:{port}": "another program may wait on this port",
            f"tcpout://127.0.0.1:{free_port()}": "check that the vehicle or its router listens",
            "serial:///dev/does-not-exist:57600": "check the cable, and that this user may open",
            "udpout://no-such-host.invalid:14550": "check the host name",
        }
        for url, says in cases.items():
            with pytest.raises(RobotError, match=says) as caught:
                robots(drone={"url": url})["drone"].connect()
            assert str(caught.value).startswith(f"{url} cannot be opened: ")


def test_a_driver_that_reaches_out_finds_a_vehicle_that_waits() -> None:
    with UdpVehicle(vehicle(), None) as far:
        robot = robots(drone={"url": f"udpout://127.0.0.1:{far.port}"})["drone"]
        robot.connect()
        assert json.loads(robot.health().model_dump_json())["ready"] is True
        robot.disconnect()
