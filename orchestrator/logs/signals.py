"""The signals that every reader of logs returns, and the limits on what it reads."""

from __future__ import annotations

from collections.abc import Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, StringConstraints, model_validator

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError, system_errors_as
from nufleet.shared.strict import Strict, validation_errors_as
from nufleet.shared.wire.codec import Float64Array

FILE_BYTES_MAX = 8 * 2**30
"""Largest file that is opened. Readers stream it, so that it need not fit into memory."""

SAMPLES_MAX = 4_000_000
"""Largest number of samples of one signal: eleven hours at 100 Hz, 64 MB with their times."""

_SHOWN = 40

SignalName = Annotated[str, StringConstraints(min_length=1, max_length=400)]
"""Name of a signal, `TOPIC.FIELD`, or the name of a column."""


Clock = Literal["device", "receipt"]
"""Whether a sample was stamped where it was measured, or where it was received and logged."""


class LogError(InvalidInputError):
    """A log that cannot be read, or does not hold what is asked of it."""


class UnknownSignalError(LogError):
    """A log that does not hold a signal."""


class SignalNames(Strict):
    """The two signals of one axis."""

    reference: SignalName
    """Name of the position that the robot was sent."""
    output: SignalName
    """Name of the position that was measured."""

    @model_validator(mode="after")
    def _differ(self) -> SignalNames:
        if self.reference == self.output:
            raise ValueError(f"reference and output are the same signal, {self.reference}")
        return self


class Signal(Strict):
    """One signal of a log: samples with the time stamp of each."""

    name: SignalName
    """Name of the signal in its log."""
    time_s: Float64Array
    """Time stamp of each sample in s, shape (samples,), in the order of the log."""
    value: Float64Array
    """Samples in the signal's own unit, shape (samples,)."""
    clock: Clock
    """Whether a sample was stamped where it was measured, or where it was received and logged."""

    @model_validator(mode="after")
    def _samples(self) -> Signal:
        if self.time_s.ndim != 1 or self.time_s.shape != self.value.shape:
            raise ValueError("expected a time stamp for every sample")
        if not 2 <= len(self.value) <= SAMPLES_MAX:
            raise ValueError(f"expected 2 to {SAMPLES_MAX} samples, got {len(self.value)}")
        return self


def signal(
    path: Path,
    name: str,
    time_s: FloatArray,
    value: FloatArray,
    clock: Clock,
) -> Signal:
    """Return a signal, checked; samples that are not finite are left out.

    Args:
        path: File that the samples are from, for messages.
        name: Name of the signal.
        time_s: Time stamps in s, shape (samples,).
        value: Samples, shape (samples,).
        clock: Where the samples were stamped.

    Raises:
        LogError: There are too few samples, or too many.
    """
    times, values = (np.ascontiguousarray(part, dtype=np.float64) for part in (time_s, value))
    known = np.isfinite(times) & np.isfinite(values)
    with validation_errors_as(LogError, f"{path}: signal {name}"):
        return Signal(name=name, time_s=times[known], value=values[known], clock=clock)


class Samples:
    """Samples of one signal while a log is read: grows, and refuses to grow beyond the limit."""

    def __init__(self, path: Path, name: str) -> None:
        self._path, self._name = path, name
        self._time_s: list[FloatArray] = []
        self._value: list[FloatArray] = []
        self._block = np.empty((2, 4096))
        self._used = self._full = 0
        self._stamped = True

    def add(self, time_s: float, value: float, *, stamped: bool = True) -> None:
        """Append one sample; raises LogError when there are too many.

        Args:
            time_s: Time of the sample in s.
            value: Value of the sample.
            stamped: Whether the device stamped it where it was measured.
        """
        self._stamped &= stamped
        if self._used == self._block.shape[1]:
            self._flush()
        self._block[:, self._used] = time_s, value
        self._used += 1

    def __len__(self) -> int:
        return self._full + self._used

    def signal(self) -> Signal:
        """Return all of them as a signal; raises LogError when there are too few."""
        self._flush()
        times, values = (
            np.concatenate([np.empty(0), *part]) for part in (self._time_s, self._value)
        )
        clock: Clock = "device" if self._stamped else "receipt"
        return signal(self._path, self._name, times, values, clock)

    def _flush(self) -> None:
        self._full += self._used
        if self._full > SAMPLES_MAX:
            raise LogError(
                f"{self._path}: signal {self._name} has more than {SAMPLES_MAX} samples: cut the "
                "log, or import a part of it"
            )
        self._time_s.append(self._block[0, : self._used].copy())
        self._value.append(self._block[1, : self._used].copy())
        self._used = 0


class Channel(Strict):
    """A signal that a log offers."""

    name: SignalName
    """Name to ask for it by."""
    samples: Annotated[int, Field(ge=0)] | None
    """Number of its samples; None where only reading the whole log would tell."""


def check_file(path: Path) -> None:
    """Check that a log is there and not too large; raises LogError."""
    with system_errors_as(LogError, f"{path} cannot be read"):
        size = path.stat().st_size
        if path.is_dir():
            size = sum(part.stat().st_size for part in path.iterdir())
    if size == 0:
        raise LogError(f"{path} is empty")
    if size > FILE_BYTES_MAX:
        raise LogError(
            f"{path}: {size / 2**30:.1f} GiB, more than the {FILE_BYTES_MAX / 2**30:.0f} GiB that "
            "are read: cut the log"
        )


def unknown_signal(path: Path, wanted: str, offered: Sequence[str]) -> UnknownSignalError:
    """Return the error that a log does not hold a signal, with those that it does."""
    near = get_close_matches(wanted, offered, n=5, cutoff=0.5)
    names = near or sorted(offered)[:_SHOWN]
    more = "" if near or len(offered) <= _SHOWN else f" and {len(offered) - _SHOWN} more"
    there = ", ".join(names) or "nothing"
    return UnknownSignalError(
        f"{path} holds no signal {wanted}; {'nearest to it is' if near else 'it holds'} {there}"
        f"{more} (`nufleet import FILE --list` shows all)"
    )
