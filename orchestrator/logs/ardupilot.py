"""ArduPilot's logs: DataFlash (.bin, .log) and telemetry (.tlog), read with pymavlink."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

from nufleet.orchestrator.logs.signals import Channel, Samples, Signal, unknown_signal

_STAMPS = {"TimeUS": 1e-6, "TimeMS": 1e-3, "time_usec": 1e-6, "time_boot_ms": 1e-3}
"""Fields that hold the device's own time, and their units in s."""

_NOT_DATA = frozenset({"BAD_DATA", "FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG"})


def channels(path: Path) -> tuple[Channel, ...]:
    """Return the numeric fields of all messages."""
    counts: dict[str, int] = {}
    for message in _messages(path, None):
        kind = message.get_type()
        if kind not in _NOT_DATA and not kind.startswith("UNKNOWN"):
            for field, value in message.to_dict().items():
                if isinstance(value, int | float):
                    name = f"{kind}.{field}"
                    counts[name] = counts.get(name, 0) + 1
    return tuple(Channel(name=name, samples=count) for name, count in sorted(counts.items()))


def read(path: Path, names: Sequence[str]) -> dict[str, Signal]:
    """Read fields of messages, named as in `PSCN.TPN` or `LOCAL_POSITION_NED.x`.

    A message has the time of the device if it holds one, otherwise that of the ground station.
    """
    wanted = {name: name.partition(".") for name in names}
    samples = {name: Samples(path, name) for name in names}
    for message in _messages(path, sorted({kind for kind, _, _ in wanted.values()})):
        there = message.to_dict()
        stamp = next((field for field in _STAMPS if field in there), None)
        for name, (kind, _, field) in wanted.items():
            if message.get_type() == kind and field in there:
                at_s = message._timestamp if stamp is None else there[stamp] * _STAMPS[stamp]  # noqa: SLF001 - pymavlink has no other name for it
                samples[name].add(at_s, float(there[field]), stamped=stamp is not None)
    for name in names:
        if not samples[name]:
            raise unknown_signal(path, name, [channel.name for channel in channels(path)])
    return {name: samples[name].signal() for name in names}


def _messages(path: Path, kinds: list[str] | None) -> Iterator[Any]:
    """Yield the messages of some kinds, or all of them, in the order of the log."""
    import sys

    from pymavlink import mavutil

    # What pymavlink has to say of a damaged log would spoil the document on stdout.
    with redirect_stdout(sys.stderr):
        log = mavutil.mavlink_connection(str(path))
        try:
            while (message := log.recv_match(type=kinds)) is not None:
                yield message
        finally:
            close = getattr(log, "close", None)
            if close is not None:
                close()
