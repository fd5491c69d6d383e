"""The outer layout of every message, and the one that must not wait for heavy imports: a stop.

A frame consists of `NUF1`, the lengths of header and body as two little-endian uint32, the header
(protocol version, message type, dtype and shape of each array), the body, and the arrays one after
another.
"""

from __future__ import annotations

import json
import os
import struct

from nufleet.shared.text import as_reason

PROTOCOL_VERSION = 7
MAGIC = b"NUF1"
LENGTHS = struct.Struct("<II")
PREFIX_BYTES = len(MAGIC) + LENGTHS.size


def framed(head: bytes, body: bytes) -> bytes:
    """Return a frame up to its arrays.

    Args:
        head: Header, encoded as JSON.
        body: Message, encoded as JSON.
    """
    return b"".join([MAGIC, LENGTHS.pack(len(head), len(body)), head, body])


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
