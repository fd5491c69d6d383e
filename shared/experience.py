"""A stored experience: the manifest of an inverse model and its network, one safetensors file."""

from __future__ import annotations

import hashlib
import json
import struct
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
import safetensors
import safetensors.numpy
from numpy.typing import NDArray
from pydantic import Field, ValidationError, model_validator

from shared.errors import MalformedMessageError
from shared.inverse_layout import InverseLayout
from shared.robot_spec import RobotSpec
from shared.strict import Name, NonNegative, Positive, Strict

EXPERIENCE_BYTES_MAX = 4 * 2**20
"""Ten times what the paper's network (4 × 128) takes."""

_HEADER_BYTES_MAX = 64 * 2**10
_LENGTH = struct.Struct("<Q")
_MANIFEST_KEY = "nufleet.experience"

Weights = NDArray[np.float32]
Digest = Annotated[str, Field(pattern=r"^[0-9a-f]{64}$")]
_Numbers = Annotated[tuple[float, ...], Field(min_length=1, max_length=64)]
_Scales = Annotated[tuple[Positive, ...], Field(min_length=1, max_length=64)]


class ExperienceManifest(Strict):
    """What an inverse model was learned from and what it may be used for.

    `axes` are those whose flights it learned; they share `unit`. Inputs are (ξ − input_mean) /
    input_scale; the network's output times `output_scale` plus `output_mean` is γ in unit/s.
    `validation_rms` is the error of γ on points held back, in unit/s.
    """

    schema_version: Literal[1] = 1
    robot: Name
    robot_kind: Name
    axes: Annotated[tuple[Name, ...], Field(min_length=1, max_length=16)]
    unit: Literal["m", "rad"]
    layout: InverseLayout
    inputs: Annotated[tuple[str, ...], Field(min_length=1, max_length=64)]
    output: Literal["reference-speed"] = "reference-speed"
    relative_degree: Annotated[int, Field(ge=1, le=1000)]
    hidden: Annotated[tuple[Annotated[int, Field(ge=1, le=256)], ...], Field(min_length=1)] = (
        128,
        128,
        128,
        128,
    )
    input_mean: _Numbers
    input_scale: _Scales
    output_mean: float
    output_scale: Positive
    points: Annotated[int, Field(ge=1)]
    validation_rms: NonNegative
    data_sha256: Digest
    seed: Annotated[int, Field(ge=0)]
    training_version: Annotated[str, Field(max_length=100)]

    @model_validator(mode="after")
    def _consistent(self) -> ExperienceManifest:
        if self.inputs != self.layout.input_names:
            raise ValueError(f"inputs must be those of the layout: {self.layout.input_names}")
        if not len(self.inputs) == len(self.input_mean) == len(self.input_scale):
            raise ValueError("input_mean and input_scale need one number per input")
        if len(set(self.axes)) != len(self.axes):
            raise ValueError(f"axis names must differ, got {self.axes}")
        if len(self.hidden) > 8:
            raise ValueError(f"at most 8 hidden layers, got {len(self.hidden)}")
        return self

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """The name and shape of every array of the network; a weight maps rows to columns."""
        widths = (len(self.inputs), *self.hidden, 1)
        shapes: dict[str, tuple[int, ...]] = {}
        for layer, (before, after) in enumerate(pairwise(widths)):
            shapes[f"weight_{layer}"] = (before, after)
            shapes[f"bias_{layer}"] = (after,)
        return shapes


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


def misfit(
    manifest: ExperienceManifest, spec: RobotSpec, state_names: tuple[str, ...], axis: str
) -> str | None:
    """Return why an experience cannot serve an axis of a robot; None when it can.

    Args:
        manifest: of the experience.
        spec: of the robot that would use it.
        state_names: what that robot's `observe` measures.
        axis: the axis to be driven.
    """
    layout = manifest.layout
    mine = next((a for a in spec.axes if a.name == axis), None)
    needed = layout.states if layout.architecture == "state" else layout.states[:1]
    if mine is None:
        return f"the robot has no axis {axis!r}"
    if manifest.robot_kind != spec.kind:
        return f"it was learned on a {manifest.robot_kind}, this robot is a {spec.kind}"
    if axis not in manifest.axes:
        return f"it was learned on {', '.join(manifest.axes)}, not on axis {axis!r}"
    if mine.unit != manifest.unit:
        return f"it is in {manifest.unit}, axis {axis!r} is in {mine.unit}"
    if abs(layout.sample_time_s - spec.sample_time_s) > 1e-9 * spec.sample_time_s:
        return (
            f"its sample time is {layout.sample_time_s:g} s, the robot's {spec.sample_time_s:g} s"
        )
    if state_names[: len(needed)] != needed:
        return (
            f"it needs the states {', '.join(needed)}, the robot measures {state_names or 'none'}"
        )
    return None


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
