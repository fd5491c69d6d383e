"""A stored experience: the manifest of an inverse model and its network, one safetensors file."""

from __future__ import annotations

import hashlib
import json
import struct
from dataclasses import dataclass

import numpy as np
import safetensors
import safetensors.numpy
from numpy.typing import NDArray
from pydantic import ValidationError

from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.experience.manifest import ExperienceManifest

EXPERIENCE_BYTES_MAX = 4 * 2**20
"""Ten times what the paper's network (4 × 128) takes."""

_HEADER_BYTES_MAX = 64 * 2**10
_LENGTH = struct.Struct("<Q")
_MANIFEST_KEY = "nufleet.experience"

Weights = NDArray[np.float32]


@dataclass(frozen=True, eq=False)
class Experience:
    """A manifest and the arrays that it describes, float32."""

    manifest: ExperienceManifest
    arrays: dict[str, Weights]


def encode_experience(experience: Experience) -> bytes:
    """Return an experience as one safetensors file; the same experience gives the same bytes."""
    arrays = {
        name: np.ascontiguousarray(experience.arrays[name]) for name in experience.manifest.shapes
    }
    _check_arrays(experience.manifest, arrays)
    manifest = experience.manifest.model_dump_json()
    return bytes(safetensors.numpy.save(arrays, metadata={_MANIFEST_KEY: manifest}))


def decode_experience(payload: bytes, sha256: str | None = None) -> Experience:
    """Read an experience that came from outside.

    Args:
        payload: the file.
        sha256: of the file as it was offered; not compared if left out.

    Raises:
        MalformedMessageError: too large, truncated, altered, of another type, or a network that is
            not the one its manifest describes.
    """
    if len(payload) > EXPERIENCE_BYTES_MAX:
        raise MalformedMessageError(
            f"an experience of {len(payload)} bytes, at most {EXPERIENCE_BYTES_MAX} are taken"
        )
    if sha256 is not None and digest(payload) != sha256:
        raise MalformedMessageError(
            "the experience is not the one that was offered: its sha256 differs"
        )
    manifest = _manifest(payload)
    try:
        arrays = safetensors.numpy.load(payload)
    except (safetensors.SafetensorError, KeyError, ValueError, TypeError) as error:
        raise MalformedMessageError(f"not a safetensors file: {error}") from error
    _check_arrays(manifest, arrays)
    return Experience(manifest, arrays)


def digest(payload: bytes) -> str:
    """Return the sha256 of a stored experience, in hexadecimal."""
    return hashlib.sha256(payload).hexdigest()


def _manifest(payload: bytes) -> ExperienceManifest:
    if len(payload) < _LENGTH.size:
        raise MalformedMessageError("the experience is truncated: it has no header")
    (length,) = _LENGTH.unpack_from(payload)
    if length > _HEADER_BYTES_MAX or length > len(payload) - _LENGTH.size:
        raise MalformedMessageError(
            f"not an experience, or truncated: {len(payload)} bytes with a header of {length}"
        )
    try:
        header = json.loads(payload[_LENGTH.size : _LENGTH.size + length])
        text = header["__metadata__"][_MANIFEST_KEY]
        if not isinstance(text, str):
            raise MalformedMessageError("the experience's manifest is not text")
        return ExperienceManifest.model_validate_json(text)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise MalformedMessageError(
            f"the experience's manifest: {where}: {first['msg']}"
        ) from error
    except (ValueError, KeyError, TypeError, RecursionError) as error:
        raise MalformedMessageError("a file without an experience's manifest") from error


def _check_arrays(manifest: ExperienceManifest, arrays: dict[str, Weights]) -> None:
    expected = manifest.shapes
    if set(arrays) != set(expected):
        raise MalformedMessageError("the network's arrays are not those of its manifest")
    for name, shape in expected.items():
        array = arrays[name]
        if array.dtype != np.float32 or array.shape != shape:
            raise MalformedMessageError(
                f"{name} must be float32 of shape {shape}, got {array.dtype} {array.shape}"
            )
        if not np.isfinite(array).all():
            raise MalformedMessageError(f"{name} holds a number that is not finite")
