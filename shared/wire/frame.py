"""The outer layout of every message, and the one that must not wait for heavy imports: a stop.

A frame consists of `NUF1`, the lengths of header and body as two little-endian uint32, the header
(protocol version, message type, dtype and shape of each array), the body, the arrays one after
another, and the CRC-32 of all that as a little-endian uint32. A sample that was altered on its way
is as a rule a valid number, and would be believed.
"""

from __future__ import annotations

import json
import os
import struct
import zlib
from collections.abc import Sequence

from nufleet.shared.text import as_reason

PROTOCOL_VERSION = 8
MAGIC = b"NUF1"
LENGTHS = struct.Struct("<II")
PREFIX_BYTES = len(MAGIC) + LENGTHS.size
CHECKSUM = struct.Struct("<I")


NOT_KILLED = "not-killed"
"""Code of the answer of a robot that is stopped, and whose motors could not be cut."""


def framed(head: bytes, body: bytes, arrays: Sequence[bytes] = ()) -> bytes:
    """Return a frame.

    Args:
        head: Header, encoded as JSON.
        body: Message, encoded as JSON.
        arrays: Arrays of the message, as raw bytes.
    """
    return sealed(b"".join([MAGIC, LENGTHS.pack(len(head), len(body)), head, body, *arrays]))


def sealed(frame: bytes) -> bytes:
    """Return a frame with the checksum that it lacks."""
    return frame + CHECKSUM.pack(zlib.crc32(frame))


def intact(frame: bytes) -> bool:
    """Return whether a frame, of at least the length of its checksum, is the one that was sent."""
    end = len(frame) - CHECKSUM.size
    return (zlib.crc32(memoryview(frame)[:end]),) == CHECKSUM.unpack_from(frame, end)


def new_order_id() -> str:
    """Return a unique id of an order, by which a robot knows another copy of it."""
    return os.urandom(8).hex()


def stop_frame(sender: str, reason: str, *, order_id: str, kill: bool = False) -> bytes:
    """Return a StopRequest as `nufleet.shared.wire.codec.encode` would encode it.

    It is made without pydantic and NumPy, because importing them takes longer than all other steps
    from a person's command to the robot's stop.

    Args:
        sender: Identifier of the person or program that stops the robot.
        reason: Why it is stopped; any text is made printable and cut to length.
        order_id: Id of the order, the same in every copy of it; see `new_order_id`.
        kill: Whether to cut its motors instead of bringing it to rest.
    """
    head = {"protocol": PROTOCOL_VERSION, "type": "StopRequest", "arrays": []}
    body = {"sender": sender, "reason": as_reason(reason), "kill": kill, "order_id": order_id}
    return framed(_json(head), _json(body))


def _json(value: object) -> bytes:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode()
