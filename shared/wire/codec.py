"""Encoding of messages to bytes and back: a strict JSON body, followed by its arrays as raw bytes.

`nufleet.shared.wire.frame` describes the layout of a frame. Every length is checked against a cap
and against the payload before anything is allocated, and no part of a frame can name code to run.
"""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Annotated, Literal, TypeVar

import numpy as np
from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PlainSerializer,
    PlainValidator,
    SerializationInfo,
    ValidationInfo,
)

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import (
    DamagedMessageError,
    MalformedMessageError,
    ProtocolVersionError,
)
from nufleet.shared.strict import Strict, validation_errors_as
from nufleet.shared.wire.frame import (
    CHECKSUM,
    LENGTHS,
    MAGIC,
    PREFIX_BYTES,
    PROTOCOL_VERSION,
    framed,
    intact,
)

MAX_MESSAGE_BYTES = 15 * 2**20
"""Default cap on one frame, below the limit of sessions and routers. A test of ten minutes at
100 Hz on one axis takes about 1 MB."""

MAX_BODY_BYTES = 2**20
"""Cap on the JSON of one frame, which takes many times its length in memory once it is parsed. Bulk
data travel as arrays."""

_MAX_HEADER_BYTES = 4096
_HEADERS_KEPT = 256
"""Number of headers that need not be validated again, since those of most frames are alike."""
_ITEM_BYTES = {"<f8": 8, "|u1": 1}
_MAX_DIMENSIONS = 3


class Message(Strict):
    """Base class of everything that crosses the network."""


class _Versioned(BaseModel):
    """The only header field that every version of the protocol has."""

    model_config = ConfigDict(strict=True)
    protocol: Annotated[int, Field(ge=0, lt=2**31)]


class _ArrayHeader(Strict):
    # A length above the frame's cap could overflow NumPy's sizes, even in a shape that contains 0.
    dtype: Literal["<f8", "|u1"]
    shape: Annotated[
        tuple[Annotated[int, Field(ge=0, le=MAX_MESSAGE_BYTES)], ...],
        Field(min_length=1, max_length=_MAX_DIMENSIONS),
    ]

    @property
    def size_bytes(self) -> int:
        # Python integers do not overflow, so a false shape in a header cannot wrap around.
        return math.prod(self.shape) * _ITEM_BYTES[self.dtype]


class _Header(Strict):
    protocol: int
    type: Annotated[str, Field(max_length=64)]
    arrays: Annotated[tuple[_ArrayHeader, ...], Field(max_length=16)] = ()


class _FrameArrays:
    """The arrays of a frame being decoded; each must be claimed by exactly one field."""

    def __init__(self, arrays: list[np.ndarray]) -> None:
        self._left: dict[int, np.ndarray] = dict(enumerate(arrays))

    def take(self, index: int) -> np.ndarray:
        if index not in self._left:
            raise ValueError(f"there is no array {index}, or another field has it")
        return self._left.pop(index)

    @property
    def unclaimed(self) -> bool:
        return bool(self._left)


def _resolve_array(value: object, info: ValidationInfo) -> np.ndarray:
    """Return the value itself if it is an array, else the frame's array that it is the index of."""
    if isinstance(value, np.ndarray):
        array = value
    elif type(value) is int and isinstance(info.context, _FrameArrays):
        array = info.context.take(value)
    else:
        raise ValueError("expected an array")
    if not 1 <= array.ndim <= _MAX_DIMENSIONS:
        raise ValueError(f"an array has {array.ndim} dimensions")
    if array.dtype == np.float64 and not np.isfinite(array).all():
        raise ValueError("an array holds NaN or infinity")
    return array


def _refer_to_array(array: np.ndarray, info: SerializationInfo) -> int:
    if not isinstance(info.context, list):
        raise TypeError("a message with arrays is written by nufleet.shared.wire.codec.encode")
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
"""Type of a field for an array of finite float64 numbers of one to three dimensions, which travels
as raw bytes. A decoded array is read-only."""


def _as_bytes(value: object, info: ValidationInfo) -> bytes:
    if isinstance(value, bytes):
        return value
    array = _resolve_array(value, info)
    if array.dtype != np.uint8 or array.ndim != 1:
        raise ValueError(f"expected bytes, got {array.dtype} of {array.ndim} dimensions")
    return array.tobytes()


Bytes = Annotated[
    bytes,
    PlainValidator(_as_bytes),
    PlainSerializer(
        lambda value, info: _refer_to_array(np.frombuffer(value, dtype=np.uint8), info),
        return_type=int,
    ),
]
"""Type of a field for bytes, which travel unchanged behind the JSON."""

M = TypeVar("M", bound=Message)


def encode(message: Message) -> bytes:
    """Return a message as one frame.

    Args:
        message: Message to encode.

    Raises:
        MalformedMessageError: the message is larger than `decode` accepts.
    """
    arrays: list[np.ndarray] = []
    body = message.model_dump_json(context=arrays).encode()
    raw = [np.ascontiguousarray(a, dtype=a.dtype.newbyteorder("<")) for a in arrays]
    size_bytes = len(body) + sum(a.nbytes for a in raw)
    if len(body) > MAX_BODY_BYTES or size_bytes > MAX_MESSAGE_BYTES - 2 * _MAX_HEADER_BYTES:
        raise MalformedMessageError(
            f"a {type(message).__name__} of {size_bytes} bytes is too large to be sent"
        )
    head = _head(type(message).__name__, tuple((a.dtype.str, a.shape) for a in raw))
    if raw:
        # Pad the JSON with spaces, so that the arrays are aligned to 8 bytes at the receiver.
        body += b" " * (-(PREFIX_BYTES + len(head) + len(body)) % 8)
    return framed(head, body, [a.tobytes() for a in raw])


def decode(payload: bytes, *expected: type[M], max_bytes: int = MAX_MESSAGE_BYTES) -> M:
    """Return the message in a frame, which must be of one of the expected types.

    Args:
        payload: Frame to decode.
        *expected: Types of message to accept.
        max_bytes: Largest accepted frame.

    Raises:
        ProtocolVersionError: the frame was written by another protocol version.
        DamagedMessageError: the frame is not the one that was sent.
        MalformedMessageError: the frame is not a valid message of an expected type for any other
            reason.
    """
    if len(payload) > max_bytes:
        raise MalformedMessageError(f"message of {len(payload)} bytes; at most {max_bytes} allowed")
    if len(payload) < PREFIX_BYTES + CHECKSUM.size or payload[: len(MAGIC)] != MAGIC:
        raise MalformedMessageError("not a nufleet message")
    if not intact(payload):
        _check_version(payload)
        raise DamagedMessageError("the frame was altered on its way: its checksum is wrong")
    raw_header, body_start, arrays_start = _parts(payload)
    header = _parse_header(raw_header)
    message_type = next((t for t in expected if t.__name__ == header.type), None)
    if message_type is None:
        wanted = " or ".join(t.__name__ for t in expected)
        raise MalformedMessageError(f"expected {wanted}, got {header.type!r}")
    arrays = _FrameArrays(_take_arrays(payload, arrays_start, header.arrays))
    with validation_errors_as(MalformedMessageError, header.type):
        message = message_type.model_validate_json(payload[body_start:arrays_start], context=arrays)
    if arrays.unclaimed:
        raise MalformedMessageError(
            f"{header.type}: the frame holds an array that belongs to no field"
        )
    return message


def _parts(payload: bytes) -> tuple[bytes, int, int]:
    """Return the header of a frame, and where its body and its arrays begin."""
    header_bytes, body_bytes = LENGTHS.unpack_from(payload, len(MAGIC))
    if header_bytes > _MAX_HEADER_BYTES or body_bytes > MAX_BODY_BYTES + 8:
        raise MalformedMessageError("a length in the frame is larger than allowed")
    body_start = PREFIX_BYTES + header_bytes
    arrays_start = body_start + body_bytes
    if arrays_start > len(payload) - CHECKSUM.size:
        raise MalformedMessageError("a length in the frame is larger than the frame")
    return payload[PREFIX_BYTES:body_start], body_start, arrays_start


def _check_version(payload: bytes) -> None:
    """Raise a ProtocolVersionError for a frame whose header names another version.

    Such a frame may end in another way.
    """
    try:
        _parse_header(_parts(payload)[0])
    except ProtocolVersionError:
        raise
    except MalformedMessageError:
        return


@lru_cache(_HEADERS_KEPT)
def _head(message_type: str, arrays: tuple[tuple[str, tuple[int, ...]], ...]) -> bytes:
    """Return the header of a frame; the arrays are given by type and shape."""
    of_arrays = (_ArrayHeader.model_validate({"dtype": d, "shape": s}) for d, s in arrays)
    header = _Header(protocol=PROTOCOL_VERSION, type=message_type, arrays=tuple(of_arrays))
    return header.model_dump_json().encode()


@lru_cache(_HEADERS_KEPT)
def _parse_header(raw: bytes) -> _Header:
    with validation_errors_as(MalformedMessageError, "frame header"):
        protocol = _Versioned.model_validate_json(raw).protocol
        if protocol != PROTOCOL_VERSION:
            raise ProtocolVersionError(
                f"the message speaks protocol version {protocol}, this side speaks "
                f"{PROTOCOL_VERSION}; install the same version of nufleet on both"
            )
        return _Header.model_validate_json(raw)


def _take_arrays(payload: bytes, start: int, headers: tuple[_ArrayHeader, ...]) -> list[np.ndarray]:
    if start + sum(header.size_bytes for header in headers) != len(payload) - CHECKSUM.size:
        raise MalformedMessageError("the arrays do not fill the frame exactly")
    arrays = []
    for header in headers:
        count = math.prod(header.shape)
        flat = np.frombuffer(payload, dtype=header.dtype, count=count, offset=start)
        arrays.append(flat.reshape(header.shape))
        start += header.size_bytes
    return arrays
