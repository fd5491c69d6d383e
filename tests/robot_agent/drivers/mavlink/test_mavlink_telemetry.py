"""What is taken from a vehicle's messages, one by one."""

from __future__ import annotations

from typing import Any

import pytest
from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.robot_agent.drivers.mavlink.profiles import PX4
from nufleet.robot_agent.drivers.mavlink.telemetry import Telemetry


def taken(*messages: tuple[int, Any], measured_by: str = "LOCAL_POSITION_NED") -> Telemetry:
    """What is known after messages, each with its number on the link."""
    telemetry = Telemetry(PX4, 1, 245, measured_by)
    packer, parser = dialect.MAVLink(None, srcSystem=1, srcComponent=1), dialect.MAVLink(None)
    for at, (number, message) in enumerate(messages):
        packer.seq = number % 256
        (received,) = parser.parse_buffer(message.pack(packer))
        telemetry.receive(received, "vehicle", 0.02 * at)
    return telemetry


def placed(at_ms: int) -> Any:
    return dialect.MAVLink_local_position_ned_message(at_ms, 1.0, 2.0, -3.0, 0.1, 0.2, -0.3)


def answer(result: int, to: int) -> Any:
    return dialect.MAVLink_command_ack_message(400, result, 0, 0, to, 0)


def test_answers_to_other_ground_stations_are_not_ours() -> None:
    assert taken((0, answer(4, 255))).acknowledged == {}
    assert taken((0, answer(0, 245)), (1, answer(4, 7))).acknowledged == {400: 0}
    assert taken((0, answer(2, 0))).acknowledged == {400: 2}


def test_positions_are_dated_in_the_middle_of_a_millisecond_and_the_latest_is_the_newest() -> None:
    telemetry = taken((0, placed(1000)))
    late = taken((0, placed(1000)), (2, placed(1040)), (1, placed(1020)), (3, placed(1060)))
    assert telemetry.newest is not None
    assert telemetry.newest.vehicle_s == 1.0005
    assert telemetry.newest.position.tolist() == [2.0, 1.0, 3.0]
    assert telemetry.newest.velocity.tolist() == pytest.approx([0.2, 0.1, 0.3])
    assert late.newest is not None
    assert late.newest.vehicle_s == 1.0605
    assert late.trouble == ""


@pytest.mark.parametrize(
    ("stamps_ms", "says"),
    [
        ((1000, 1020, 1040), ""),
        ((1000, 1900, 1920), ""),  # they waited, and arrive together
        ((2000, 1020), ""),
        ((3000, 1020), "went back by 1.98 s"),
        ((1000, 3020), "jumped 2 s ahead"),
    ],
)
def test_time_stamps_that_jump_are_no_dates(stamps_ms: tuple[int, ...], says: str) -> None:
    telemetry = taken(*((k, placed(at_ms)) for k, at_ms in enumerate(stamps_ms)))
    assert says in telemetry.trouble
    assert bool(says) == bool(telemetry.trouble)


@pytest.mark.parametrize(("frame", "known"), [(1, True), (20, True), (4, False), (21, False)])
def test_an_odometry_in_another_frame_is_no_position(frame: int, known: bool) -> None:
    pose = (1.0, 2.0, -3.0, [1.0, 0.0, 0.0, 0.0])
    message = dialect.MAVLink_odometry_message(
        1_000_000, frame, 12, *pose, *(0.0,) * 6, [0.0] * 21, [0.0] * 21
    )
    telemetry = taken((0, message), measured_by="ODOMETRY")
    assert (telemetry.newest is not None, telemetry.trouble == "") == (known, known)


@pytest.mark.parametrize(("every", "share"), [(1, 1.0), (2, 0.5), (10, 0.1)])
def test_the_share_of_packets_that_arrive_is_told_by_their_numbers(
    every: int, share: float
) -> None:
    telemetry = taken(*((every * k, placed(1000 + 20 * k)) for k in range(400)))
    assert telemetry.arriving == pytest.approx(share, rel=0.05)


def test_packets_that_overtake_each_other_are_not_lost() -> None:
    order = [k + (1 if k % 4 == 1 else -1 if k % 4 == 2 else 0) for k in range(400)]
    telemetry = taken(*((k, placed(1000 + 20 * k)) for k in order))
    assert telemetry.arriving == pytest.approx(1.0, abs=0.03)


def test_a_battery_without_an_estimate_of_its_charge_has_none() -> None:
    unknown = (0, 0, 0, 0, [4000, 4100, *[0xFFFF] * 8], -1, -1, -1, -1)
    telemetry = taken((0, dialect.MAVLink_battery_status_message(*unknown)))
    assert telemetry.charge is None
    assert telemetry.voltage_v == pytest.approx(8.1)
