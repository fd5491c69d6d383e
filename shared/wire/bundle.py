"""Several robots' states in one message: for each its name and its frame, one after the other.

Each begins with the length of the name as a little-endian uint16 and that of the frame as a uint32.
A receiver finds the robots that concern it without decoding the frames of the others.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping

from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.text import is_name

_LENGTHS = struct.Struct("<HI")


def bundled(frames: Mapping[str, bytes], *, most_bytes: int) -> Iterator[bytes]:
    """Yield as few messages as the frames need, in their order.

    Args:
        frames: Frame of each robot, by the robot's name.
        most_bytes: Largest message, unless a single frame needs a larger one.
    """
    message = bytearray()
    for robot, frame in frames.items():
        name = robot.encode()
        if message and len(message) + _LENGTHS.size + len(name) + len(frame) > most_bytes:
            yield bytes(message)
            message.clear()
        message += _LENGTHS.pack(len(name), len(frame)) + name + frame
    if message:
        yield bytes(message)


def unbundled(message: bytes) -> Iterator[tuple[str, bytes]]:
    """Yield each robot's name and frame.

    Args:
        message: Message as `bundled` yields it; what follows a malformed part is not read.

    Raises:
        MalformedMessageError: A length does not fit, or a name is none.
    """
    at = 0
    while at < len(message):
        if len(message) - at < _LENGTHS.size:
            raise MalformedMessageError("a bundle of states ends within a length")
        name_bytes, frame_bytes = _LENGTHS.unpack_from(message, at)
        at += _LENGTHS.size
        frame_at = at + name_bytes
        if frame_at + frame_bytes > len(message):
            raise MalformedMessageError("a length in a bundle of states is larger than the bundle")
        robot = message[at:frame_at].decode(errors="replace")
        if not is_name(robot):
            raise MalformedMessageError("a bundle of states names a robot that none can be called")
        at = frame_at + frame_bytes
        yield robot, message[frame_at:at]
