"""Messages as bytes and back: a strict JSON body with its arrays as raw bytes behind it.

A frame is `NUF1`, the lengths of header and body as two little-endian uint32, the header (protocol
version, message type, dtype and shape of each array), the body, and the arrays one after another.
Every length is checked against a cap and against the payload before anything is allocated, and no
part of a frame can name code to run.
"""

from __future__ import annotations

import math
import struct
from typing import Annotated, Literal, TypeVar

import numpy as np
from pydantic import (
    Field,
    PlainSerializer,
    PlainValidator,
    SerializationInfo,
    ValidationError,
    ValidationInfo,
)

from shared.arrays import FloatArray
from shared.errors import MalformedMessageError, ProtocolVersionError
from shared.strict import Strict

PROTOCOL_VERSION = 1
MAX_MESSAGE_BYTES = 64 * 2**20
"""Default cap on one frame; a test of ten minutes at 100 Hz on one axis is about 1 MB."""

_MAGIC = b"NUF1"
_LENGTHS = struct.Struct("<II")
_PREFIX_BYTES = len(_MAGIC) + _LENGTHS.size
_MAX_HEADER_BYTES = 4096
_ITEM_BYTES = {"<f8": 8, "|u1": 1}


class Message(Strict):
    """Base of everything that crosses the network."""


class _ArrayHeader(Strict):
    dtype: Literal["<f8", "|u1"]
    shape: Annotated[tuple[Annotated[int, Field(ge=0)], ...], Field(min_length=1, max_length=3)]

    @property
    def size_bytes(self) -> int:
        # Python integers do not overflow, so a header that lies about its shape cannot wrap round.
        return math.prod(self.shape) * _ITEM_BYTES[self.dtype]


class _Header(Strict):
    protocol: int
    type: Annotated[str, Field(max_length=64)]
    arrays: Annotated[tuple[_ArrayHeader, ...], Field(max_length=16)] = ()


def _resolve_array(value: object, info: ValidationInfo) -> np.ndarray:
    """Take an array as it is, or the one of the frame that the body refers to by its index."""
    if isinstance(value, np.ndarray):
        array = value
    elif isinstance(value, int) and isinstance(info.context, list):
        if not 0 <= value < len(info.context):
            raise ValueError(f"there is no array {value} in this message")
        array = info.context[value]
    else:
        raise ValueError("expected an array")  # noqa: TRY004 - pydantic reports ValueError
    if array.dtype == np.float64 and not np.isfinite(array).all():
        raise ValueError("an array holds NaN or infinity")
    return array


def _refer_to_array(array: np.ndarray, info: SerializationInfo) -> int:
    if not isinstance(info.context, list):
        raise TypeError("a message with arrays is written by shared.codec.encode")
    info.context.append(array)
    return len(info.context) - 1


def _float64_only(array: np.ndarray) -> np.ndarray:
    if array.dtype != np.float64:
        raise ValueError(f"expected float64, got {array.dtype}")
    return array


Float64Array = Annotated[
    FloatArray,
    PlainValidator(lambda value, info: _float64_only(_resolve_array(value, info))),
    PlainSerializer(_refer_to_array, return_type=int),
]
"""A field of finite float64 numbers that travels as raw bytes."""

M = TypeVar("M", bound=Message)


def encode(message: Message) -> bytes:
    """Return a message as one frame."""
    arrays: list[np.ndarray] = []
    body = message.model_dump_json(context=arrays).encode()
    raw = [np.ascontiguousarray(a, dtype=a.dtype.newbyteorder("<")) for a in arrays]
    header = _Header(
        protocol=PROTOCOL_VERSION,
        type=type(message).__name__,
        arrays=tuple(
            _ArrayHeader.model_validate({"dtype": a.dtype.str, "shape": a.shape}) for a in raw
        ),
    )
    head = header.model_dump_json().encode()
    lengths = _LENGTHS.pack(len(head), len(body))
    return b"".join([_MAGIC, lengths, head, body, *(a.tobytes() for a in raw)])


def decode(payload: bytes, *expected: type[M], max_bytes: int = MAX_MESSAGE_BYTES) -> M:
    """Return the message in a frame, which must be of one of the expected types.

    Raises:
        ProtocolVersionError: the frame was written by another protocol version.
        MalformedMessageError: it is anything else but a valid message of an expected type.
    """
    if len(payload) > max_bytes:
        raise MalformedMessageError(f"message of {len(payload)} bytes; at most {max_bytes} allowed")
    if len(payload) < _PREFIX_BYTES or payload[: len(_MAGIC)] != _MAGIC:
        raise MalformedMessageError("not a nufleet message")
    header_bytes, body_bytes = _LENGTHS.unpack_from(payload, len(_MAGIC))
    body_start = _PREFIX_BYTES + header_bytes
    arrays_start = body_start + body_bytes
    if header_bytes > _MAX_HEADER_BYTES or arrays_start > len(payload):
        raise MalformedMessageError("a length in the frame is larger than the frame")
    header = _parse_header(payload[_PREFIX_BYTES:body_start])
    message_type = next((t for t in expected if t.__name__ == header.type), None)
    if message_type is None:
        wanted = " or ".join(t.__name__ for t in expected)
        raise MalformedMessageError(f"expected {wanted}, got {header.type!r}")
    arrays = _take_arrays(payload, arrays_start, header.arrays)
    try:
        return message_type.model_validate_json(payload[body_start:arrays_start], context=arrays)
    except ValidationError as error:
        raise MalformedMessageError(f"{header.type}: {describe_validation(error)}") from error


def describe_validation(error: ValidationError) -> str:
    """Say in one line which fields were wrong and what was expected."""
    problems = [
        f"{'.'.join(str(part) for part in item['loc']) or 'message'}: {item['msg']}"
        for item in error.errors(include_url=False, include_context=False, include_input=False)
    ]
    more = f" (and {len(problems) - 4} more)" if len(problems) > 4 else ""
    return "; ".join(problems[:4]) + more


def _parse_header(raw: bytes) -> _Header:
    try:
        header = _Header.model_validate_json(raw)
    except ValidationError as error:
        raise MalformedMessageError(f"frame header: {describe_validation(error)}") from error
    if header.protocol != PROTOCOL_VERSION:
        raise ProtocolVersionError(
            f"the message speaks protocol version {header.protocol}, this side speaks "
            f"{PROTOCOL_VERSION}; install the same nufleet on both"
        )
    return header


def _take_arrays(payload: bytes, start: int, headers: tuple[_ArrayHeader, ...]) -> list[np.ndarray]:
    if start + sum(header.size_bytes for header in headers) != len(payload):
        raise MalformedMessageError("the arrays do not fill the frame exactly")
    arrays = []
    for header in headers:
        count = math.prod(header.shape)
        flat = np.frombuffer(payload, dtype=header.dtype, count=count, offset=start)
        arrays.append(flat.reshape(header.shape))
        start += header.size_bytes
    return arrays
