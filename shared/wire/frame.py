"""The outside of every message, and the one message that must not wait for heavy imports: a stop.

A frame is `NUF1`, the lengths of header and body as two little-endian uint32, the header (protocol
version, message type, dtype and shape of each array), the body, and the arrays one after another.
"""

from __future__ import annotations

import json
import struct

from nufleet.shared.text import as_reason

PROTOCOL_VERSION = 1
MAGIC = b"NUF1"
LENGTHS = struct.Struct("<II")
PREFIX_BYTES = len(MAGIC) + LENGTHS.size


def framed(head: bytes, body: bytes) -> bytes:
    """Return a frame up to its arrays."""
    return b"".join([MAGIC, LENGTHS.pack(len(head), len(body)), head, body])


def stop_frame(sender: str, reason: str) -> bytes:
    """Return what `nufleet.shared.wire.codec.encode` makes of a StopRequest, without pydantic and
    NumPy.

    Their imports take longer than everything else between a person and a robot that is to stop.
    """
    head = {"protocol": PROTOCOL_VERSION, "type": "StopRequest", "arrays": []}
    return framed(_json(head), _json({"sender": sender, "reason": as_reason(reason)}))


def _json(value: object) -> bytes:
    return json.dumps(value, ensure_ascii=False, separators=(",", ":")).encode()
