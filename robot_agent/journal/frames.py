"""The byte format of a robot's journal, which distinguishes a torn end from altered bytes.

The file begins with `NUJ1` and 16 random bytes. These key every checksum of the file, so that no
bytes from elsewhere (another journal, or the reason in a received stop) can pass for a record. The
frames follow, each consisting of a mark, a number that rises by one, the payload's length, a
checksum of these three, the payload, and a checksum of everything.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass

SALT_BYTES = 16
MAX_PAYLOAD_BYTES = 64 * 1024

_FILE_MARK = b"NUJ1"
_MARK = b"\xf5NUR"
_HEAD = struct.Struct("<4sQI")
_HEAD_CHECK_BYTES = 8
_CHECK_BYTES = 16
_HEAD_BYTES = _HEAD.size + _HEAD_CHECK_BYTES
FILE_HEAD_BYTES = len(_FILE_MARK) + SALT_BYTES + _HEAD_CHECK_BYTES


@dataclass(frozen=True)
class Scan:
    """The content found in a journal's bytes."""

    salt: bytes
    """Salt of the file, the key of its checksums; empty when the beginning is damaged."""

    payloads: tuple[bytes, ...]
    """Payloads of all whole frames, in order."""

    last_number: int
    """Number of the last whole frame; 0 without any."""

    sound_bytes: int
    """Offset at which the unbroken sequence of frames from the beginning ends."""

    torn_bytes: int
    """Length of a frame behind that offset that was never written to its end; 0 without one."""

    damage: str | None
    """Description of altered bytes; None when there are none."""


def file_head(salt: bytes) -> bytes:
    """Return the first bytes of a journal's file: mark, salt and checksum."""
    return _FILE_MARK + salt + _check(salt, _FILE_MARK, _HEAD_CHECK_BYTES)


def encode_frame(salt: bytes, number: int, payload: bytes) -> bytes:
    """Return the frame of one record.

    Args:
        salt: Salt of the file.
        number: Number of the frame, one more than that of the frame before.
        payload: Encoded record.

    Raises:
        ValueError: The payload is too long.
    """
    if len(payload) > MAX_PAYLOAD_BYTES:
        raise ValueError(
            f"the record has {len(payload)} bytes; at most {MAX_PAYLOAD_BYTES} are possible"
        )
    head = _HEAD.pack(_MARK, number, len(payload))
    head += _check(salt, head, _HEAD_CHECK_BYTES)
    return head + payload + _check(salt, head + payload, _CHECK_BYTES)


def scan(data: bytes) -> Scan:
    """Return the records in a journal's bytes, sound or not.

    A frame that is cut off by the end of the file (or followed by zeros, as some file systems leave
    them after a crash) was never acknowledged, since writing it did not return. Any other fault
    means that the file was altered after it was written; records behind the fault are found again
    by their marks.
    """
    salt = data[len(_FILE_MARK) : len(_FILE_MARK) + SALT_BYTES]
    if data[:FILE_HEAD_BYTES] != file_head(salt) or len(salt) < SALT_BYTES:
        return Scan(b"", (), 0, 0, 0, "the beginning of the file is damaged")
    payloads: list[bytes] = []
    position = sound_bytes = FILE_HEAD_BYTES
    number, torn_bytes, sound = 0, 0, True
    while position < len(data):
        found = _frame_at(salt, data, position)
        if found is not None and found.number > number:
            sound = sound and found.number == number + 1
            payloads.append(found.payload)
            number, position = found.number, found.end
            if sound:
                sound_bytes = position
            continue
        following = _next_frame(salt, data, position + 1)
        if following is None:
            if sound and _is_torn(salt, data[position:], number + 1):
                torn_bytes = len(data) - position
            else:
                sound = False
            break
        sound, position = False, following
    damage = None if sound else f"the content after byte {sound_bytes} was altered"
    return Scan(salt, tuple(payloads), number, sound_bytes, torn_bytes, damage)


@dataclass(frozen=True)
class _Frame:
    number: int
    payload: bytes
    end: int


def _frame_at(salt: bytes, data: bytes, start: int) -> _Frame | None:
    """Return the whole frame that begins at `start`; None if there is none."""
    length = _payload_bytes(salt, data[start : start + _HEAD_BYTES])
    if length is None:
        return None
    body, end = start + _HEAD_BYTES + length, start + _HEAD_BYTES + length + _CHECK_BYTES
    if len(data) < end or data[body:end] != _check(salt, data[start:body], _CHECK_BYTES):
        return None
    return _Frame(_HEAD.unpack_from(data, start)[1], data[start + _HEAD_BYTES : body], end)


def _next_frame(salt: bytes, data: bytes, start: int) -> int | None:
    """Return the offset of the first whole frame at or after `start`; None if there is none."""
    place = data.find(_MARK, start)
    while place >= 0 and _frame_at(salt, data, place) is None:
        place = data.find(_MARK, place + 1)
    return place if place >= 0 else None


def _payload_bytes(salt: bytes, head: bytes) -> int | None:
    """Return the payload length in a frame's head; None unless the head is whole and valid."""
    if len(head) < _HEAD_BYTES:
        return None
    mark, _, length = _HEAD.unpack_from(head)
    right = _check(salt, head[: _HEAD.size], _HEAD_CHECK_BYTES) == head[_HEAD.size :]
    return int(length) if right and mark == _MARK and length <= MAX_PAYLOAD_BYTES else None


def _is_torn(salt: bytes, rest: bytes, number: int) -> bool:
    """Return whether the rest of a file is the beginning of the frame with this number."""
    if not rest.strip(b"\0"):
        return True
    if len(rest) < _HEAD_BYTES:
        begins = _MARK + number.to_bytes(8, "little")
        return rest[: len(begins)] == begins[: len(rest)]
    length = _payload_bytes(salt, rest[:_HEAD_BYTES])
    is_next = _HEAD.unpack_from(rest)[1] == number
    return length is not None and is_next and len(rest) < _HEAD_BYTES + length + _CHECK_BYTES


def _check(salt: bytes, data: bytes, size_bytes: int) -> bytes:
    return hashlib.blake2b(data, key=salt, digest_size=size_bytes).digest()
