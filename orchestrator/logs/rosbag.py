"""ROS 2's logs: rosbag2 folders, and single MCAP or SQLite files, read with rosbags."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nufleet.orchestrator.logs.signals import Channel, LogError, Samples, Signal, unknown_signal

DEPTH_MAX = 6
ELEMENTS_MAX = 32
"""Deepest field, and longest array of numbers, that are listed."""


def channels(path: Path) -> tuple[Channel, ...]:
    """Return the numeric fields of every topic, as its first message shows them."""
    from rosbags.highlevel import AnyReader

    found = []
    with AnyReader([path]) as bag:
        for connection in bag.connections:
            for _, _, raw in bag.messages([connection]):
                message = bag.deserialize(raw, connection.msgtype)
                found += [
                    Channel(name=f"{connection.topic}.{field}", samples=connection.msgcount)
                    for field in _fields(message)
                ]
                break
    return tuple(found)


def read(path: Path, names: Sequence[str]) -> dict[str, Signal]:
    """Read fields of messages, named as in `/odom.pose.pose.position.x` or `/joint.position[0]`.

    A message has the time in its header; without a header, the time at which it was recorded.
    """
    from rosbags.highlevel import AnyReader

    wanted = {name: name.partition(".") for name in names}
    samples = {name: Samples(path, name) for name in names}
    topics = {topic for topic, _, _ in wanted.values()}
    with AnyReader([path]) as bag:
        chosen = [one for one in bag.connections if one.topic in topics]
        for name, (topic, _, _) in wanted.items():
            if all(one.topic != topic for one in chosen):
                raise unknown_signal(path, name, [channel.name for channel in channels(path)])
        for connection, received_ns, raw in bag.messages(chosen):
            message = bag.deserialize(raw, connection.msgtype)
            stamp_s = _stamp_s(message)
            for name, (topic, _, field) in wanted.items():
                if connection.topic == topic:
                    value = _value(message, field)
                    if value is None:
                        offered = [channel.name for channel in channels(path)]
                        raise unknown_signal(path, name, offered)
                    at_s = received_ns * 1e-9 if stamp_s is None else stamp_s
                    samples[name].add(at_s, value, stamped=stamp_s is not None)
    return {name: samples[name].signal() for name in names}


def _stamp_s(message: Any) -> float | None:
    """Return the time in a message's header; None without one, or if it was left empty."""
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    if stamp is None or (stamp.sec == 0 and stamp.nanosec == 0):
        return None
    return float(stamp.sec) + 1e-9 * float(stamp.nanosec)


def _value(message: Any, field: str) -> float | None:
    """Return the number at a path such as `pose.position.x` or `position[2]`; None if not there."""
    value: Any = message
    for part in field.split("."):
        name, bracket, index = part.partition("[")
        value = getattr(value, name, None)
        if bracket:
            if not (index.endswith("]") and index[:-1].isdecimal()) or not hasattr(
                value, "__len__"
            ):
                return None
            if int(index[:-1]) >= len(value):
                raise LogError(f"field {field} of a message has only {len(value)} elements")
            value = value[int(index[:-1])]
    number = isinstance(value, int | float | np.number) and not isinstance(value, bool)
    return float(value) if number else None


def _fields(message: Any, depth: int = 0) -> list[str]:
    found: list[str] = []
    for name in getattr(message, "__dataclass_fields__", ()):
        value = getattr(message, name)
        if isinstance(value, int | float | np.number) and not isinstance(value, bool):
            found.append(name)
        elif isinstance(value, np.ndarray) and value.size <= ELEMENTS_MAX:
            found += [f"{name}[{index}]" for index in range(value.size)]
        elif depth < DEPTH_MAX and hasattr(value, "__dataclass_fields__"):
            found += [f"{name}.{inner}" for inner in _fields(value, depth + 1)]
    return found
