"""PX4's logs (ULog), read with pyulog."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from nufleet.orchestrator.logs.signals import Channel, Signal, signal, unknown_signal

_STAMPS = ("timestamp_sample", "timestamp")


def channels(path: Path) -> tuple[Channel, ...]:
    """Return the fields of all topics."""
    return tuple(
        Channel(name=f"{_topic(data)}.{field}", samples=len(data.data[field]))
        for data in _parsed(path, None).data_list
        for field in data.data
    )


def read(path: Path, names: Sequence[str]) -> dict[str, Signal]:
    """Read fields of topics, named as in `trajectory_setpoint.position[0]`.

    Further instances of a topic are named `TOPIC#1` and so on. A sample has the time of its
    measurement (`timestamp_sample`) if the topic records it, otherwise that of its publication.
    """
    wanted = {name: name.partition(".") for name in names}
    # The parser keeps the topics of this list alone; the rest of the file is skipped.
    topics = sorted({topic.partition("#")[0] for topic, _, _ in wanted.values()})
    log = _parsed(path, topics)
    there = {_topic(data): data for data in log.data_list}
    found = {}
    for name, (topic, _, field) in wanted.items():
        if topic not in there or field not in there[topic].data:
            raise unknown_signal(path, name, [channel.name for channel in channels(path)])
        data = there[topic].data
        stamp = next(stamp for stamp in _STAMPS if stamp in data and np.any(data[stamp]))
        time_s = np.asarray(data[stamp], dtype=np.float64) * 1e-6
        found[name] = signal(path, name, time_s, np.asarray(data[field], np.float64), "device")
    return found


def _parsed(path: Path, topics: list[str] | None) -> Any:
    from pyulog import ULog

    # A damaged log would leave a file open that pyulog opened itself.
    with path.open("rb") as file:
        return ULog(file, message_name_filter_list=topics)


def _topic(data: Any) -> str:
    name: str = data.name
    return name if data.multi_id == 0 else f"{name}#{data.multi_id}"
