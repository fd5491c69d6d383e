"""Which format a log has, which signals are meant if none are named, and how it is read."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from nufleet.orchestrator.logs import ardupilot, rosbag, table, ulog
from nufleet.orchestrator.logs.signals import (
    Channel,
    LogError,
    Signal,
    SignalNames,
    UnknownSignalError,
    check_file,
)

ULOG_BYTES_MAX = 2 * 2**30
"""Largest ULog, whose parser reads all messages of a topic at once."""


@dataclass(frozen=True)
class Format:
    """A format of logs."""

    name: str
    """Name for people."""
    endings: tuple[str, ...]
    """Endings of its files, in lower case."""
    library: str | None
    """Library that reads it; None if none is needed."""
    channels: Callable[[Path], tuple[Channel, ...]]
    """Lists the signals of a file."""
    read: Callable[[Path, Sequence[str]], dict[str, Signal]]
    """Reads signals of a file by name."""
    defaults: Mapping[str, tuple[tuple[str, str], ...]]
    """Names of reference and output that an axis has where the format says so, most usual first."""


_PX4 = {
    axis: (
        (f"trajectory_setpoint.position[{n}]", f"vehicle_local_position.{axis}"),
        (f"vehicle_local_position_setpoint.{axis}", f"vehicle_local_position.{axis}"),
    )
    for n, axis in enumerate("xyz")
}
_DATAFLASH = {
    axis: ((f"PSC{letter}.TP{letter}", f"PSC{letter}.P{letter}"),)
    for axis, letter in zip("xyz", "NED", strict=True)
}
_TELEMETRY = {
    axis: ((f"POSITION_TARGET_LOCAL_NED.{axis}", f"LOCAL_POSITION_NED.{axis}"),) for axis in "xyz"
}
_COLUMNS = {
    axis: ((f"reference_{axis}", f"output_{axis}"), (f"{axis}_reference", f"{axis}_output"))
    for axis in "xyz"
}
_ROSBAG = Format("rosbag2", (".mcap", ".db3"), "rosbags", rosbag.channels, rosbag.read, defaults={})


def format_of(path: Path, time: str | None = None) -> Format:
    """Return the format of a log, by its ending; a folder is a rosbag2.

    Args:
        path: The log; it need not exist.
        time: Column of times of a table, see `table.read`.

    Raises:
        LogError: No format has that ending, or the library that reads it is not installed.
    """
    formats = (
        _ROSBAG,
        Format("ULog", (".ulg", ".ulog"), "pyulog", ulog.channels, ulog.read, _PX4),
        Format(
            "DataFlash",
            (".bin", ".log"),
            "pymavlink",
            ardupilot.channels,
            ardupilot.read,
            _DATAFLASH,
        ),
        Format(
            "telemetry log", (".tlog",), "pymavlink", ardupilot.channels, ardupilot.read, _TELEMETRY
        ),
        Format(
            "table",
            (".csv", ".tsv", ".txt"),
            None,
            table.channels,
            lambda file, names: table.read(file, names, time),
            _COLUMNS,
        ),
    )
    ending = path.suffix.lower()
    found = next((one for one in formats if ending in one.endings), None)
    if path.is_dir():
        found = _ROSBAG
    if found is None:
        known = ", ".join(ending for one in formats for ending in one.endings)
        raise LogError(f"{path}: a log is a rosbag2 folder, or a file that ends with {known}")
    if found.library is not None and find_spec(found.library) is None:
        raise LogError(
            f"{path}: a {found.name} is read with {found.library}: pip install 'nufleet[logs]'"
        )
    if time is not None and found.library is not None:
        raise LogError(f"{path}: --time names a column of a table, and this is a {found.name}")
    return found


def list_channels(path: Path) -> tuple[Channel, ...]:
    """Return the signals that a log offers; raises LogError."""
    check_file(path)
    reader = format_of(path)
    with _damage(path, reader):
        return reader.channels(path)


def read_signals(
    path: Path,
    axis: str,
    reference: str | None = None,
    output: str | None = None,
    time: str | None = None,
) -> tuple[Signal, Signal]:
    """Read reference and output of an axis from a log.

    Args:
        path: Path of the log.
        axis: Name of the axis, which decides what is read where no signals are named.
        reference: Name of the reference; None takes the format's usual one.
        output: Name of the output; None takes the format's usual one.
        time: Column of times of a table.

    Raises:
        LogError: The log cannot be read or does not hold these signals.
    """
    check_file(path)
    reader = format_of(path, time)
    if reader.name == "ULog" and path.stat().st_size > ULOG_BYTES_MAX:
        raise LogError(f"{path}: larger than {ULOG_BYTES_MAX / 2**30:.0f} GiB: cut the log")
    usual = reader.defaults.get(axis, ())
    if not usual and (reference is None or output is None):
        raise LogError(
            f"{path}: a {reader.name} does not say which signals axis {axis} has: name them with "
            "--reference and --output (`nufleet import FILE --list` shows all)"
        )
    pairs = [
        SignalNames(reference=reference or first, output=output or second)
        for first, second in usual or (("", ""),)
    ]
    missing: list[UnknownSignalError] = []
    for names in pairs:
        try:
            with _damage(path, reader):
                found = reader.read(path, (names.reference, names.output))
        except UnknownSignalError as error:
            missing.append(error)
        else:
            return found[names.reference], found[names.output]
    raise missing[0]


@contextmanager
def _damage(path: Path, reader: Format) -> Iterator[None]:
    """Turn any exception of a library about a damaged file into an error that names the file."""
    try:
        yield
    except LogError:
        raise
    except Exception as error:
        said = " ".join(str(error).split())[:200] or type(error).__name__
        raise LogError(f"{path}: cannot be read as a {reader.name}: {said}") from error
