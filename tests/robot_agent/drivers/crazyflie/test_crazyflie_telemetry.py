"""What a Crazyflie logs, and what follows of its condition."""

from __future__ import annotations

import struct
from collections.abc import Mapping

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.robot_agent.drivers.crazyflie.condition import condition, misplaced
from nufleet.robot_agent.drivers.crazyflie.glide import glide
from nufleet.robot_agent.drivers.crazyflie.settings import CrazyflieSettings, spec_of
from nufleet.robot_agent.drivers.crazyflie.supervisor import Supervisor, why_down
from nufleet.robot_agent.drivers.crazyflie.telemetry import (
    STATE_VARIABLES,
    Telemetry,
    quaternion_of,
)
from nufleet.robot_agent.motion.resampling import outputs_at_samples
from nufleet.robot_agent.robot import Record
from nufleet.sims.crazyflies.firmware import Firmware, compressed
from nufleet.sims.crazyflies.plant import KnownLoop, LoopSettings
from nufleet.sims.crazyflies.tables import LOGGED

SETTINGS = CrazyflieSettings(uri="udp://127.0.0.1:19850")
STATE = {
    **{f"stateEstimate.{name}": 0.0 for name in ("x", "y", "z", "vx", "vy", "vz")},
    "stateEstimateZ.quat": float(compressed([0.0, 0.0, 0.0, 1.0])),
}


def status(volt: float, variance_m2: float = 1e-4) -> Mapping[str, float]:
    variances = {f"kalman.var{name}": variance_m2 for name in ("PX", "PY", "PZ")}
    return {"pm.vbat": volt, "supervisor.info": 1.0, **variances}


def heard(volt: float = 3.7, variance_m2: float = 1e-4) -> Telemetry:
    telemetry = Telemetry(0.01)
    telemetry.take_status(status(volt, variance_m2), 0.0)
    return telemetry


def test_the_charge_and_the_time_in_the_air_follow_from_the_voltage() -> None:
    health = condition(SETTINGS, heard(3.7), None, None, 0.1)
    assert health.ready
    assert health.battery == pytest.approx(0.5)
    assert health.endurance_s == pytest.approx(300 * (0.5 - 0.15))


@pytest.mark.parametrize(
    ("telemetry", "down", "blind", "now_s", "says"),
    [
        (heard(3.2), None, None, 0.1, "its battery is empty: 3.20 V, below 3.3 V"),
        (heard(3.7, 4.0), None, None, 0.1, "it does not know its position"),
        (heard(3.7, float("nan")), None, None, 0.1, "it does not know its position"),
        (heard(float("nan")), None, None, 0.1, "its battery is empty: nan V"),
        (heard(), None, None, 1.5, "it has sent nothing for 1.5 s"),
        (heard(), None, "motion capture is off", 0.1, "motion capture is off"),
        (heard(3.2), "it has crashed", None, 0.1, "it has crashed"),
        (Telemetry(0.01), None, None, 0.1, "it has sent nothing"),
    ],
)
def test_a_drone_that_cannot_fly_says_why(
    telemetry: Telemetry, down: str | None, blind: str | None, now_s: float, says: str
) -> None:
    health = condition(SETTINGS, telemetry, down, blind, now_s)
    assert not health.ready
    assert health.reason.startswith(says)


def test_one_variance_that_is_no_number_counts_as_much_as_all_three() -> None:
    telemetry = Telemetry(0.01)
    telemetry.take_status({**status(3.7), "kalman.varPY": float("nan")}, 0.0)
    assert not condition(SETTINGS, telemetry, None, None, 0.1).ready


@pytest.mark.parametrize(("stands_m", "may"), [(0.1, True), (0.25, False), (0.6, False)])
def test_a_drone_that_stands_too_near_below_its_origin_does_not_take_off(
    stands_m: float, may: bool
) -> None:
    telemetry = heard()
    telemetry.take_state(0, {**STATE, "stateEstimate.z": stands_m}, 0.0)
    assert telemetry.newest is not None
    why = misplaced(SETTINGS, telemetry.newest)
    assert why is None if may else "motion may lead 0.3 m lower (limits.height_" in str(why)


@pytest.mark.parametrize(
    ("yaw_rad", "turned"), [(0.5, None), (-0.5, None), (0.6, 34), (-3.0, -172)]
)
def test_a_drone_whose_front_points_away_from_the_x_axis_does_not_take_off(
    yaw_rad: float, turned: int | None
) -> None:
    telemetry, half_rad = heard(), yaw_rad / 2
    attitude = compressed([0.0, 0.0, np.sin(half_rad), np.cos(half_rad)])
    telemetry.take_state(0, {**STATE, "stateEstimateZ.quat": float(attitude)}, 0.0)
    assert telemetry.newest is not None
    why = misplaced(SETTINGS, telemetry.newest)
    assert why is None if turned is None else f"is turned by {turned} degrees" in str(why)


def test_the_share_of_measurements_that_arrive_is_counted() -> None:
    telemetry = heard()
    assert telemetry.arriving is None
    for k in range(400):
        if k % 10:
            telemetry.take_state(10 * k, STATE, 0.01 * k)
    assert condition(SETTINGS, telemetry, None, None, 0.1).link == pytest.approx(0.9, abs=0.01)


def test_measurements_are_kept_in_the_order_in_which_they_were_taken_and_once() -> None:
    telemetry = heard()
    telemetry.begin_recording()
    for stamp_ms in (0, 20, 10, 30, 30, 40):
        telemetry.take_state(stamp_ms, {**STATE, "stateEstimate.x": stamp_ms}, 0.001 * stamp_ms)
    _, positions = telemetry.dated()
    assert positions[:, 0].tolist() == [0, 10, 20, 30, 40]
    assert telemetry.newest is not None
    assert telemetry.newest.position_m[0] == 40


def test_a_value_that_is_no_number_is_no_measurement() -> None:
    telemetry = heard()
    telemetry.take_state(0, {**STATE, "stateEstimate.x": float("nan")}, 0.0)
    assert telemetry.newest is None


def test_an_estimate_has_settled_when_its_variance_has() -> None:
    telemetry = Telemetry(0.01)
    for k in range(30):
        if k < 20:
            assert not telemetry.steady
        telemetry.take_status(status(3.9, 100.0 * 0.5**k), 0.1 * k)
    assert telemetry.steady
    for k in range(10):  # it stays put, but far too large
        telemetry.take_status(status(3.9, 1.0), 3.0 + 0.1 * k)
    assert not telemetry.steady


def test_what_takes_a_drone_down_is_said_in_words() -> None:
    assert why_down(Supervisor.ARMED | Supervisor.CAN_FLY | Supervisor.FLYING) is None
    assert "switch it off and on" in str(why_down(Supervisor.LOCKED | Supervisor.TUMBLED))


@given(st.lists(st.floats(-1, 1), min_size=4, max_size=4).filter(lambda q: np.hypot(*q[:2]) > 0.1))
def test_attitudes_are_unpacked_as_bitcraze_packs_them(values: list[float]) -> None:
    encoding = pytest.importorskip("cflib.utils.encoding")
    unit = np.array(values) / np.linalg.norm(values)
    packed = encoding.compress_quaternion(unit)
    assert compressed(unit.tolist()) == packed
    assert np.array(quaternion_of(packed)) == pytest.approx(encoding.decompress_quaternion(packed))
    assert abs(np.dot(quaternion_of(packed), unit)) == pytest.approx(1.0, abs=1e-4)


@given(
    st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3),
    st.lists(st.floats(-0.6, 0.6), min_size=3, max_size=3),
)
def test_a_glide_joins_the_motion_and_ends_at_rest_without_a_jump(
    start: list[float], velocity: list[float]
) -> None:
    position, speed = glide(
        np.array(start),
        np.array(velocity),
        velocity_max=0.3,
        acceleration_max=0.8,
        sample_time_s=0.02,
    )
    assert np.abs(position[-1]).max() < 1e-9
    assert np.abs(speed[-1]).max() < 1e-9
    whole = np.vstack([start, position])
    slopes = np.diff(whole, axis=0) / 0.02
    assert (
        np.abs(
            slopes - (np.vstack([velocity, speed])[1:] + np.vstack([velocity, speed])[:-1]) / 2
        ).max()
        < 0.02
    )
    assert np.linalg.norm(slopes, axis=1).max() < 0.3 + 1.05 * np.linalg.norm(velocity) + 1e-9


LOOP = LoopSettings(omega_rad_s=8.0, damping_ratio=0.7)


def test_late_and_lost_packets_and_irregular_samples_leave_the_response_right() -> None:
    rng = np.random.default_rng(3)
    samples, omega = 2000, 4.0
    drone = Firmware(KnownLoop(LOOP, (0.0, 0.0, 0.5)), rng, now_s=0.0, noise_m=0.001)
    telemetry = heard()
    names = list(LOGGED)
    kinds = ({"float": 7, "FP16": 8, "uint32_t": 3}[kind or ""] for _, kind in STATE_VARIABLES)
    asked = zip(kinds, (names.index(name) for name, _ in STATE_VARIABLES), strict=True)
    block = b"".join(struct.pack("<BH", kind, place) for kind, place in asked)
    packets = [(0.1, b"\x91\x01\x01"), (0.1, b"\x51\x06\x00" + block), (0.2, b"\x51\x03\x00\x01")]
    sent_s = 1.0 + 0.02 * np.arange(samples) + 0.003 * rng.random(samples)
    references = 0.1 * np.sin(omega * (sent_s - 1.0))
    for at_s, reference in zip(sent_s.tolist(), references.tolist(), strict=True):
        if rng.random() > 0.01:
            packet = b"\x70\x07" + struct.pack("<ffff", reference, 0.0, 0.5, 0.0)
            packets.append((at_s + 0.016 * rng.random(), packet))
    arrivals = []
    for at_s, packet in packets:
        for logged_s, logged in drone.take(packet, at_s):
            if logged[0] == 0x52 and rng.random() > 0.01:
                values = struct.unpack("<fffeeeI", logged[5:])
                state = dict(zip((name for name, _ in STATE_VARIABLES), values, strict=True))
                stamp_ms = int.from_bytes(logged[2:5], "little")
                arrivals.append((logged_s + rng.exponential(0.008), stamp_ms, state))
    telemetry.begin_recording()
    newest, next_sample = np.zeros(samples), 0
    for arrived_s, stamp_ms, state in sorted(arrivals, key=lambda one: one[0]):
        while next_sample < samples and sent_s[next_sample] < arrived_s:
            newest[next_sample] = telemetry.newest.position_m[0] if telemetry.newest else 0.0
            next_sample += 1
        telemetry.take_state(stamp_ms, state, arrived_s)
    measured_s, positions = telemetry.dated()
    recorded, _ = outputs_at_samples(
        Record(sent_s, measured_s, positions[:, :2]), samples, spec_of(SETTINGS)
    )
    late = [LOOP.response(omega, 0.02, 0.016 * (k + 0.5) / 20) for k in range(20)]
    truth = np.mean(late) * 0.99 / (1 - 0.01 * np.exp(-1j * omega * 0.02))
    turns = np.exp(-1j * omega * sent_s)[200:1984]
    basis = np.stack([turns.real, turns.imag, np.ones(len(turns))], axis=1)
    signals = np.stack([references, recorded[:, 0], newest], axis=1)[200:1984]
    cosine, sine, _ = np.linalg.lstsq(basis, signals, rcond=None)[0]
    _, by_stamps, as_they_come = (cosine + 1j * sine) / (cosine[0] + 1j * sine[0])
    assert abs(by_stamps - truth) < 0.004
    assert abs(as_they_come - truth) > 0.03
