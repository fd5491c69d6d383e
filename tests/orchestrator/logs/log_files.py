"""Logs as other programs write them, made with those programs' own libraries."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from pymavlink import DFReader
from pymavlink.dialects.v20 import common
from pyulog import ULog
from scipy.signal import cont2discrete, lfilter

from nufleet.shared.arrays import ComplexArray, FloatArray

STEP_S = 0.02
BEGAN_S = 1_700_000_000.0


@dataclass(frozen=True, eq=False)
class Flown:
    """A flight of a second-order loop: times from 0, reference and output."""

    time_s: FloatArray
    reference: FloatArray
    output: FloatArray
    num: FloatArray
    den: FloatArray

    def response(self, omega_rad_s: FloatArray) -> ComplexArray:
        z = np.exp(-1j * omega_rad_s * STEP_S)
        return np.asarray(np.polyval(self.num[::-1], z) / np.polyval(self.den[::-1], z))


def flown(
    seconds: float = 30.0, seed: int = 0, *, omega_0_rad_s: float = 3.0, amplitude: float = 1.0
) -> Flown:
    rng = np.random.default_rng(seed)
    time_s = np.arange(round(seconds / STEP_S)) * STEP_S
    omega, phase = rng.uniform(0.2, 5.0, 40), rng.uniform(0, 2 * np.pi, 40)
    reference = np.sin(np.outer(time_s, omega) + phase) @ (0.08 / np.sqrt(omega))
    reference = amplitude * reference * np.minimum(1.0, time_s / 2) ** 2
    num, den, _ = cont2discrete(
        ([omega_0_rad_s**2], [1.0, 1.2 * omega_0_rad_s, omega_0_rad_s**2]), STEP_S
    )
    delayed = np.concatenate([np.zeros(3), num.ravel()])
    output = lfilter(delayed, den, reference) + 0.002 * rng.standard_normal(len(time_s))
    return Flown(time_s, np.asarray(reference), np.asarray(output), delayed, np.asarray(den))


def write_rosbag(path: Path, flight: Flown, *, storage: str) -> None:
    """Write a rosbag2 folder with PoseStamped references and Odometry, by rosbags."""
    from rosbags.rosbag2 import StoragePlugin, Writer
    from rosbags.typesys import Stores, get_typestore

    types = get_typestore(Stores.ROS2_JAZZY)
    msg: Any = types.types
    plugin = StoragePlugin.MCAP if storage == "mcap" else StoragePlugin.SQLITE3
    with Writer(path, version=9, storage_plugin=plugin) as bag:
        topics = {"/cmd": "geometry_msgs/msg/PoseStamped", "/odom": "nav_msgs/msg/Odometry"}
        opened = {
            topic: bag.add_connection(topic, kind, typestore=types)
            for topic, kind in topics.items()
        }
        for t_s, u, y in zip(flight.time_s, flight.reference, flight.output, strict=True):
            stamp_ns = round((BEGAN_S + t_s) * 1e9)
            header = msg["std_msgs/msg/Header"](
                stamp=msg["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9),
                frame_id="world",
            )

            def pose(x: float) -> Any:
                return msg["geometry_msgs/msg/Pose"](
                    position=msg["geometry_msgs/msg/Point"](x, 0.0, 1.0),
                    orientation=msg["geometry_msgs/msg/Quaternion"](0.0, 0.0, 0.0, 1.0),
                )

            zero = msg["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
            messages = {
                "/cmd": msg[topics["/cmd"]](header=header, pose=pose(float(u))),
                "/odom": msg[topics["/odom"]](
                    header=header,
                    child_frame_id="base",
                    pose=msg["geometry_msgs/msg/PoseWithCovariance"](
                        pose=pose(float(y)), covariance=np.zeros(36)
                    ),
                    twist=msg["geometry_msgs/msg/TwistWithCovariance"](
                        twist=msg["geometry_msgs/msg/Twist"](linear=zero, angular=zero),
                        covariance=np.zeros(36),
                    ),
                ),
            }
            for topic, message in messages.items():
                raw = types.serialize_cdr(message, topics[topic])
                # Received 7 ms later than it was stamped, which must not matter.
                bag.write(opened[topic], stamp_ns + 7_000_000, raw)


def write_mcap(path: Path, flight: Flown) -> None:
    """Write a single MCAP file as Foxglove's library does, of messages without a header."""
    from mcap_ros2.writer import Writer

    point = "float64 x\nfloat64 y\nfloat64 z\n"
    with path.open("wb") as file:
        writer = Writer(file)
        schema = writer.register_msgdef("geometry_msgs/msg/Point", point)
        for t_s, u, y in zip(flight.time_s, flight.reference, flight.output, strict=True):
            at_ns = round((BEGAN_S + t_s) * 1e9)
            for topic, x in (("/setpoint", u), ("/position", y)):
                writer.write_message(
                    topic=topic,
                    schema=schema,
                    message={"x": float(x), "y": 0.0, "z": 0.0},
                    log_time=at_ns,
                    publish_time=at_ns,
                )
        writer.finish()


def write_ulog(path: Path, flight: Flown, *, setpoint: str = "trajectory_setpoint") -> None:
    """Write a PX4 log: its definitions by hand, its data section by pyulog's own writer."""
    fields = {
        "trajectory_setpoint": "uint64_t timestamp;float[3] position;",
        "vehicle_local_position_setpoint": "uint64_t timestamp;float x;",
        "vehicle_local_position": "uint64_t timestamp;uint64_t timestamp_sample;float x;",
    }

    def message(kind: bytes, body: bytes) -> bytes:
        return struct.pack("<HB", len(body), kind[0]) + body

    time_us = np.round(flight.time_s * 1e6).astype(np.uint64) + np.uint64(5_000_000)
    raw = b"ULog\x01\x12\x35\x01" + struct.pack("<Q", 5_000_000)
    raw += message(b"B", bytes(40))
    for name in (setpoint, "vehicle_local_position"):
        raw += message(b"F", f"{name}:{fields[name]}".encode())
    for number, name in enumerate((setpoint, "vehicle_local_position")):
        raw += message(b"A", struct.pack("<BH", 0, number) + name.encode())
    for t_us, u, y in zip(time_us.tolist(), flight.reference, flight.output, strict=True):
        if setpoint == "trajectory_setpoint":
            raw += message(b"D", struct.pack("<HQ3f", 0, t_us, u, 0.0, -1.0))
        else:
            raw += message(b"D", struct.pack("<HQf", 0, t_us, u))
        # Published 4 ms after it was measured, which timestamp_sample says.
        raw += message(b"D", struct.pack("<HQQf", 1, t_us + 4000, t_us, y))
    first = path.with_suffix(".first.ulg")
    first.write_bytes(raw)
    ULog(str(first)).write_ulog(str(path))
    first.unlink()


def write_dataflash(path: Path, flight: Flown) -> None:
    """Write an ArduPilot log, every message packed by pymavlink."""
    kinds = {
        0x80: DFReader.DFFormat(0x80, "FMT", 89, "BBnNZ", "Type,Length,Name,Format,Columns"),
        0x90: DFReader.DFFormat(0x90, "PSCN", 19, "Qff", "TimeUS,TPN,PN"),
        0x91: DFReader.DFFormat(0x91, "GPS", 30, "QBIHLLe", "TimeUS,Status,GMS,GWk,Lat,Lng,Alt"),
    }

    def packed(kind: int, *values: object) -> bytes:
        made = DFReader.DFMessage(kinds[kind], list(values), False, SimpleNamespace())
        buffer: bytes = made.get_msgbuf()
        return buffer

    raw = b"".join(
        struct.pack(
            "<BBBBB4s16s64s",
            *(0xA3, 0x95, 0x80, kind, one.len),
            *(one.name.encode(), one.format.encode(), ",".join(one.columns).encode()),
        )
        for kind, one in kinds.items()
    )
    for t_s, u, y in zip(flight.time_s, flight.reference, flight.output, strict=True):
        raw += packed(0x90, round((t_s + 3) * 1e6), float(u), float(y))
    path.write_bytes(raw)


def write_tlog(path: Path, flight: Flown) -> None:
    """Write a telemetry log, every message packed by pymavlink's MAVLink 2 encoder."""
    mavlink = common.MAVLink(None, srcSystem=1, srcComponent=1)
    with path.open("wb") as file:
        for t_s, u, y in zip(flight.time_s, flight.reference, flight.output, strict=True):
            boot_ms = round(1000 * t_s) + 3000
            zeros = (0.0,) * 8
            messages = (
                common.MAVLink_position_target_local_ned_message(
                    boot_ms, 1, 0xDF8, float(u), 0.0, -1.0, *zeros
                ),
                common.MAVLink_local_position_ned_message(
                    boot_ms, float(y), 0.0, -1.0, 0.0, 0.0, 0.0
                ),
            )
            for message in messages:
                file.write(struct.pack(">Q", round((BEGAN_S + t_s + 0.05) * 1e6)))
                file.write(message.pack(mavlink))


def write_table(
    path: Path, flight: Flown, *, separator: str = ",", decimal: str = ".", time: str = "time_s"
) -> None:
    unit = 1e3 if time.endswith("ms") else 1.0
    lines = [separator.join((time, "reference_x", "output_x"))]
    lines += [
        separator.join(f"{number:.9f}".replace(".", decimal) for number in row)
        for row in zip(flight.time_s * unit, flight.reference, flight.output, strict=True)
    ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
