"""Malformed payloads, and a check that every receiver refuses them with a typed error.

Valid payloads are cut, flipped, repeated, spliced and mixed with input that parsers often handle
wrongly; some payloads are entirely random.
"""

from __future__ import annotations

import base64
import struct
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
import psutil

TOKENS = (
    *(b"", b"\0", b"\xff", b"\xff\xfe", b"\xed\xa0\x80", b"\x00" * 64, b"\xff" * 64),
    *(b"[" * 2000, b'{"a":' * 2000, b"[" * 200_000, b'"' + b"\\u0000" * 300 + b'"'),
    *(b"NaN", b"-Infinity", b"1e999", b"-1e-999", b"1" * 5000, b"0x10", b"-0", b"1e308", b"null"),
    *(struct.pack("<I", n) for n in (0, 1, 2**31 - 1, 2**31, 2**32 - 1)),
    *(struct.pack("<Q", n) for n in (2**31, 2**32, 2**63 - 1, 2**63, 2**64 - 1)),
    *(b"18446744073709551616", b"9223372036854775807", b"[4294967296,4294967296]", b"[0,1,2]"),
    *(b"true", b"{}", b"[]", b'""', b'"a/../*/**"', b"__proto__", b"'''", b"$(reboot)", b"%s%n"),
)
"""What is inserted: nesting, numbers beyond every type, lengths that lie, broken UTF-8."""

SHOWN_BYTES = 300


class Mutator:
    """Makes payloads out of valid ones; all it does comes from its generator."""

    def __init__(self, rng: np.random.Generator, seeds: Sequence[bytes]) -> None:
        self._rng = rng
        self._seeds = list(seeds)

    def payload(self) -> bytes:
        """Return the next one."""
        rng = self._rng
        if rng.random() < 0.1:
            return rng.bytes(int(rng.integers(0, 300)))
        data = bytearray(self._seeds[rng.integers(len(self._seeds))])
        for _ in range(int(rng.integers(0, 5))):
            data = self._changed(data)
        return bytes(data)

    def _changed(self, data: bytearray) -> bytearray:
        rng = self._rng
        start = int(rng.integers(0, len(data) + 1))
        # Most of what matters comes first: lengths, headers, names.
        if rng.random() < 0.3:
            start = min(start, int(rng.integers(0, 64)))
        end = min(len(data), start + int(rng.geometric(0.1)))
        changes = (_cut, _without, _repeated, _flipped, _noise, _other_signs, self._spliced)
        if rng.random() < 0.2:
            token = TOKENS[rng.integers(len(TOKENS))]
            return data[:start] + token + data[start if rng.random() < 0.5 else end :]
        return changes[rng.integers(len(changes))](rng, data, start, end)

    def _spliced(
        self, rng: np.random.Generator, data: bytearray, start: int, end: int
    ) -> bytearray:
        del end
        other = self._seeds[rng.integers(len(self._seeds))]
        return data[:start] + other[int(rng.integers(0, len(other) + 1)) :]


def _cut(rng: np.random.Generator, data: bytearray, start: int, end: int) -> bytearray:
    del rng, end
    return data[:start]


def _without(rng: np.random.Generator, data: bytearray, start: int, end: int) -> bytearray:
    del rng
    return data[:start] + data[end:]


def _repeated(rng: np.random.Generator, data: bytearray, start: int, end: int) -> bytearray:
    return data[:end] + data[start:end] * int(rng.integers(1, 50)) + data[end:]


def _flipped(rng: np.random.Generator, data: bytearray, start: int, end: int) -> bytearray:
    for place in range(start, end):
        data[place] ^= 1 << int(rng.integers(0, 8))
    return data


def _noise(rng: np.random.Generator, data: bytearray, start: int, end: int) -> bytearray:
    return data[:start] + rng.bytes(end - start) + data[end:]


def _other_signs(rng: np.random.Generator, data: bytearray, start: int, end: int) -> bytearray:
    """Another digit, quote or bracket for each, so that it often still parses."""
    for place in range(start, end):
        if data[place] in b'0123456789.,:"[]{}-':
            data[place] = int(rng.choice(list(b'0189.,:"[]{}-e')))
    return data


@dataclass(frozen=True)
class Target:
    """Something that takes payloads from outside, and the errors with which it may refuse."""

    name: str
    seeds: Sequence[bytes]
    take: Callable[[bytes], object]
    refusals: tuple[type[Exception], ...]


@dataclass
class Tally:
    """What became of the payloads of one target."""

    target: str
    payloads: int = 0
    accepted: int = 0
    slowest_s: float = 0.0
    refusals: Counter[str] = field(default_factory=Counter)


class EscapedError(AssertionError):
    """A payload caused an error that is not documented."""


def fuzz(target: Target, count: int, rng: np.random.Generator) -> Tally:
    """Give a target `count` malformed payloads.

    Raises:
        EscapedError: An error other than the target's refusals escaped; it holds the payload.
    """
    mutator, tally = Mutator(rng, target.seeds), Tally(target.name)
    for seed in target.seeds:
        target.take(seed)  # else everything would be refused for a reason of its own
    for _ in range(count):
        payload = mutator.payload()
        began_s = time.thread_time()  # a busy machine is not the target's fault
        try:
            target.take(payload)
        except target.refusals as error:
            tally.refusals[type(error).__name__] += 1
        except BaseException as error:
            shown = base64.b64encode(payload[:SHOWN_BYTES]).decode()
            raise EscapedError(
                f"{target.name}: {len(payload)} bytes escaped as {error!r:.300}; "
                f"base64 of the first: {shown}"
            ) from error
        else:
            tally.accepted += 1
        tally.payloads += 1
        tally.slowest_s = max(tally.slowest_s, time.thread_time() - began_s)
    return tally


def resident_bytes(pid: int | None = None) -> int:
    """Return the memory that a process (this one by default) holds in RAM."""
    return int(psutil.Process(pid).memory_info().rss)
