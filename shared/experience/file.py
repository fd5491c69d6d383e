"""The file of an experience: an inverse model's manifest and network as one safetensors file."""

from __future__ import annotations

import hashlib
import json
import struct
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import safetensors
import safetensors.numpy
from numpy.typing import NDArray

from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.experience.manifest import ExperienceManifest
from nufleet.shared.experience.signature import Signature
from nufleet.shared.strict import Strict, validation_errors_as

EXPERIENCE_BYTES_MAX = 4 * 2**20
"""Largest accepted file: ten times the size of the paper's network (4 × 128)."""

_HEADER_BYTES_MAX = 64 * 2**10
_LENGTH = struct.Struct("<Q")
_MANIFEST_KEY, _SIGNATURE_KEY = "nufleet.experience", "nufleet.signature"

Weights = NDArray[np.float32]
S = TypeVar("S", bound=Strict)


@dataclass(frozen=True, eq=False)
class Experience:
    """An inverse model: the paper's f_S, learned on a source robot."""

    manifest: ExperienceManifest
    """Origin, inputs, output and layers of the model."""
    arrays: dict[str, Weights]
    """Weights and biases of the network, with the names and shapes of `ExperienceManifest.shapes`.
    """
    signature: Signature | None = None
    """Signature of `signed_content` by the robot that learned it; None in an open fleet."""


def encode_experience(experience: Experience) -> bytes:
    """Return an experience as one safetensors file; equal experiences give equal bytes.

    Args:
        experience: Experience to encode.

    Raises:
        MalformedMessageError: the arrays are not those that the manifest describes.
    """
    arrays = {
        name: np.ascontiguousarray(experience.arrays[name]) for name in experience.manifest.shapes
    }
    _check_arrays(experience.manifest, arrays)
    manifest = experience.manifest.model_dump_json()
    return bytes(safetensors.numpy.save(arrays, metadata={_MANIFEST_KEY: manifest}))


def decode_experience(payload: bytes, sha256: str | None = None) -> Experience:
    """Read and check an experience that came from outside.

    Args:
        payload: Contents of the file.
        sha256: SHA-256 of the file as it was offered, in hexadecimal; None skips the comparison.

    Raises:
        MalformedMessageError: the file is too large, truncated, altered or of another type, or its
            network is not the one that its manifest describes.
    """
    if len(payload) > EXPERIENCE_BYTES_MAX:
        raise MalformedMessageError(
            f"an experience of {len(payload)} bytes; at most {EXPERIENCE_BYTES_MAX} are accepted"
        )
    if sha256 is not None and digest(payload) != sha256:
        raise MalformedMessageError(
            "the experience is not the one that was offered: its sha256 differs"
        )
    metadata = _metadata(payload)
    manifest = _read(ExperienceManifest, metadata, _MANIFEST_KEY, "manifest")
    signature = (
        _read(Signature, metadata, _SIGNATURE_KEY, "signature")
        if _SIGNATURE_KEY in metadata
        else None
    )
    try:
        arrays = safetensors.numpy.load(payload)
    except (safetensors.SafetensorError, KeyError, ValueError, TypeError) as error:
        raise MalformedMessageError(f"not a safetensors file: {error}") from error
    _check_arrays(manifest, arrays)
    return Experience(manifest, arrays, signature)


def signed_content(payload: bytes) -> bytes:
    """Return what a signature covers: digests of the manifest as it is written, and of the weights.

    Two files with the same content differ in their signature at most.

    Args:
        payload: Contents of the file of an experience.

    Raises:
        MalformedMessageError: It is not an experience.
    """
    experience, manifest = decode_experience(payload), _metadata(payload)[_MANIFEST_KEY]
    weights = hashlib.sha256()
    for name in experience.manifest.shapes:
        weights.update(experience.arrays[name].astype("<f4").tobytes())
    return b"nufleet experience" + hashlib.sha256(manifest.encode()).digest() + weights.digest()


def with_signature(payload: bytes, signature: Signature) -> bytes:
    """Return the file of an experience with a signature, in place of the one that it may have.

    Args:
        payload: Contents of the file.
        signature: Signature of its `signed_content`.
    """
    metadata = {
        _MANIFEST_KEY: _metadata(payload)[_MANIFEST_KEY],
        _SIGNATURE_KEY: signature.model_dump_json(),
    }
    return bytes(safetensors.numpy.save(decode_experience(payload).arrays, metadata=metadata))


def digest(payload: bytes) -> str:
    """Return the SHA-256 of the contents of an experience's file, in hexadecimal."""
    return hashlib.sha256(payload).hexdigest()


def _metadata(payload: bytes) -> dict[str, str]:
    if len(payload) < _LENGTH.size:
        raise MalformedMessageError("the experience is truncated: it has no header")
    (length,) = _LENGTH.unpack_from(payload)
    if length > _HEADER_BYTES_MAX or length > len(payload) - _LENGTH.size:
        raise MalformedMessageError(
            f"not an experience, or truncated: {len(payload)} bytes with a header of {length}"
        )
    try:
        metadata = json.loads(payload[_LENGTH.size : _LENGTH.size + length])["__metadata__"]
        for text in (metadata[_MANIFEST_KEY], *metadata.values()):
            text.encode()
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise MalformedMessageError("the file has no manifest of an experience") from error
    return dict(metadata)


def _read(kind: type[S], metadata: dict[str, str], key: str, what: str) -> S:
    with validation_errors_as(MalformedMessageError, f"the experience's {what}"):
        return kind.model_validate_json(metadata[key])


def _check_arrays(manifest: ExperienceManifest, arrays: dict[str, Weights]) -> None:
    expected = manifest.shapes
    if set(arrays) != set(expected):
        raise MalformedMessageError("the arrays of the network do not match its manifest")
    for name, shape in expected.items():
        array = arrays[name]
        if array.dtype != np.float32 or array.shape != shape:
            raise MalformedMessageError(
                f"{name} must be float32 of shape {shape}, got {array.dtype} {array.shape}"
            )
        if not np.isfinite(array).all():
            raise MalformedMessageError(f"{name} contains a value that is not finite")
