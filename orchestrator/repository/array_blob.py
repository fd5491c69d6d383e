"""Converts arrays to bytes for a database and back, bit for bit, with full validation.

A blob is `NUA1`, the dtype's code, the number of dimensions, each length as a little-endian uint64,
the CRC-32 of the data, and the data. NaN and infinity are preserved, because failed estimates
contain them.
"""

from __future__ import annotations

import math
import struct
import zlib

import numpy as np

from nufleet.orchestrator.repository.errors import DamagedRecordError
from nufleet.shared.arrays import ComplexArray, FloatArray

_MAGIC = b"NUA1"
_HEAD = struct.Struct("<4s4sB")
_LENGTH = struct.Struct("<Q")
_CRC = struct.Struct("<I")
_FLOAT = b"<f8\0"
_COMPLEX = b"<c16"
_ITEM_BYTES = {_FLOAT: 8, _COMPLEX: 16}


def pack_array(array: FloatArray | ComplexArray) -> bytes:
    """Return an array of float64 or complex128, of any shape, as a blob."""
    code = _COMPLEX if np.iscomplexobj(array) else _FLOAT
    data = np.ascontiguousarray(array, dtype=code.rstrip(b"\0").decode()).tobytes()
    lengths = b"".join(_LENGTH.pack(length) for length in array.shape)
    head = _HEAD.pack(_MAGIC, code, array.ndim) + lengths
    return head + _CRC.pack(zlib.crc32(data, zlib.crc32(head))) + data


def unpack_floats(blob: bytes, shape: tuple[int, ...], what: str) -> FloatArray:
    """Return the float64 array in a blob.

    Args:
        blob: Bytes made by `pack_array`.
        shape: Expected shape.
        what: Name of the array in the error message.

    Raises:
        DamagedRecordError: The blob does not hold exactly such an array.
    """
    return np.frombuffer(_data(blob, _FLOAT, shape, what), dtype="<f8").reshape(shape)


def unpack_complex(blob: bytes, shape: tuple[int, ...], what: str) -> ComplexArray:
    """Return the complex128 array of a shape in a blob; see `unpack_floats`."""
    return np.frombuffer(_data(blob, _COMPLEX, shape, what), dtype="<c16").reshape(shape)


def _data(blob: bytes, code: bytes, shape: tuple[int, ...], what: str) -> bytes:
    """Return the data of a blob with the expected dtype and shape; raises DamagedRecordError."""
    head = _HEAD.pack(_MAGIC, code, len(shape)) + b"".join(_LENGTH.pack(n) for n in shape)
    start = len(head) + _CRC.size
    size_bytes = math.prod(shape) * _ITEM_BYTES[code]
    if blob[: len(head)] != head or len(blob) != start + size_bytes:
        raise DamagedRecordError(
            f"{what}: expected {code.rstrip(bytes(1)).decode()} of shape {shape}, "
            f"found {len(blob)} bytes of different content"
        )
    (crc,) = _CRC.unpack_from(blob, len(head))
    if zlib.crc32(blob[start:], zlib.crc32(head)) != crc:
        raise DamagedRecordError(f"{what}: the data do not match their checksum")
    return blob[start:]
