"""An experience survives storage unchanged, and nothing else is taken for one."""

from __future__ import annotations

import contextlib
import json
import struct

import numpy as np
import pytest
import safetensors.numpy
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError

from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.experience.file import (
    EXPERIENCE_BYTES_MAX,
    Experience,
    decode_experience,
    digest,
    encode_experience,
)
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.experience.manifest import ExperienceManifest, misfit
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

LAYOUT = InverseLayout(
    architecture="state",
    states=("position", "velocity"),
    sample_time_s=0.02,
    horizon_samples=20,
)
STATES = ("position", "velocity", "tilt")


def manifest(**changes: object) -> ExperienceManifest:
    fields: dict[str, object] = {
        "robot": "source-1",
        "robot_kind": "quadrotor",
        "axes": ("x", "y"),
        "unit": "m",
        "layout": LAYOUT,
        "inputs": LAYOUT.input_names,
        "relative_degree": 3,
        "hidden": (5, 4),
        "input_mean": (0.0,) * 4,
        "input_scale": (1.0,) * 4,
        "output_mean": 0.1,
        "output_scale": 0.5,
        "points": 2100,
        "validation_rms": 0.01,
        "data_sha256": "0" * 64,
        "seed": 0,
        "training_version": "1",
    }
    return ExperienceManifest.model_validate(fields | changes)


def experience(seed: int = 0) -> Experience:
    rng = np.random.default_rng(seed)
    shapes = manifest().shapes
    arrays = {name: rng.standard_normal(shape).astype(np.float32) for name, shape in shapes.items()}
    return Experience(manifest(), arrays)


def spec(**changes: object) -> RobotSpec:
    axes = tuple(
        AxisSpec(name=name, unit="m", amplitude_max=1.0, velocity_max=1.0, acceleration_max=1.0)
        for name in ("x", "y", "z")
    )
    fields: dict[str, object] = {
        "kind": "quadrotor",
        "axes": axes,
        "sample_time_s": 0.02,
        "omega_min_rad_s": 0.1,
        "omega_max_rad_s": 5.4,
        "duration_max_s": 100.0,
        "settling_time_s": 4.0,
        "simulated": True,
    }
    return RobotSpec.model_validate(fields | changes)


PAYLOAD = encode_experience(experience())


def with_header(change: dict[str, object]) -> bytes:
    """Return the payload with another header, its length right."""
    (length,) = struct.unpack_from("<Q", PAYLOAD)
    header = json.loads(PAYLOAD[8 : 8 + length]) | change
    raw = json.dumps(header).encode()
    return struct.pack("<Q", len(raw)) + raw + PAYLOAD[8 + length :]


def test_what_is_stored_is_read_back() -> None:
    first, back = experience(), decode_experience(PAYLOAD, digest(PAYLOAD))
    assert back.manifest == first.manifest
    for name, array in first.arrays.items():
        np.testing.assert_array_equal(back.arrays[name], array)
    assert encode_experience(back) == PAYLOAD


@settings(max_examples=100, deadline=None)
@given(st.integers(0, len(PAYLOAD) - 1))
def test_a_truncated_file_is_refused(length: int) -> None:
    with pytest.raises(MalformedMessageError):
        decode_experience(PAYLOAD[:length])


@settings(max_examples=200, deadline=None)
@given(st.integers(0, len(PAYLOAD) - 1), st.integers(1, 255))
def test_an_altered_file_is_refused_by_its_digest_and_never_crashes_without(
    at: int, change: int
) -> None:
    altered = bytearray(PAYLOAD)
    altered[at] ^= change
    with pytest.raises(MalformedMessageError, match="sha256"):
        decode_experience(bytes(altered), digest(PAYLOAD))
    with contextlib.suppress(MalformedMessageError):
        decode_experience(bytes(altered))


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=300))
def test_other_bytes_are_refused(payload: bytes) -> None:
    with pytest.raises(MalformedMessageError):
        decode_experience(payload)


def test_a_header_that_lies_about_its_length_is_refused_before_anything_is_allocated() -> None:
    for length in (2**63, 2**40, len(PAYLOAD), 65 * 2**10):
        with pytest.raises(MalformedMessageError, match="header of"):
            decode_experience(struct.pack("<Q", length) + PAYLOAD[8:])


def test_a_header_that_lies_about_an_array_is_refused() -> None:
    lie = {"dtype": "F32", "shape": [2**40, 2**20], "data_offsets": [0, 16]}
    with pytest.raises(MalformedMessageError, match="not a safetensors file"):
        decode_experience(with_header({"bias_1": lie}))


def test_a_file_that_is_too_large_is_refused() -> None:
    with pytest.raises(MalformedMessageError, match="at most"):
        decode_experience(bytes(EXPERIENCE_BYTES_MAX + 1))


def test_a_safetensors_file_of_something_else_is_refused() -> None:
    other = safetensors.numpy.save({"a": np.zeros(3, np.float32)})
    with pytest.raises(MalformedMessageError, match="no manifest of an experience"):
        decode_experience(other)


def test_a_manifest_with_a_wrong_field_is_refused_by_its_name() -> None:
    for key, value in [("points", -1), ("unit", "ft"), ("surprise", 1), ("output_scale", 0.0)]:
        fields = json.loads(manifest().model_dump_json()) | {key: value}
        payload = with_header({"__metadata__": {"nufleet.experience": json.dumps(fields)}})
        with pytest.raises(MalformedMessageError, match=key):
            decode_experience(payload)


def test_a_network_that_is_not_the_one_of_its_manifest_is_refused() -> None:
    good = experience()
    for name, array, message in [
        ("bias_0", np.zeros(6, np.float32), "shape"),
        ("bias_0", np.zeros(5), "float64"),
        ("bias_0", np.full(5, np.nan, np.float32), "not finite"),
        ("more", np.zeros(5, np.float32), "do not match its manifest"),
    ]:
        payload = safetensors.numpy.save(
            {**good.arrays, name: np.asarray(array)},
            metadata={"nufleet.experience": good.manifest.model_dump_json()},
        )
        with pytest.raises(MalformedMessageError, match=message):
            decode_experience(payload)


@pytest.mark.parametrize(
    "changes",
    [
        {"inputs": ("velocity", "output-ahead", "velocity-ahead", "tilt")},
        {"input_mean": (0.0,) * 3},
        {"axes": ("x", "x")},
        {"hidden": (4,) * 9},
        {"input_scale": (1.0, 1.0, 0.0, 1.0)},
        {"validation_rms": float("nan")},
    ],
)
def test_a_manifest_that_contradicts_itself_is_refused(changes: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        manifest(**changes)


def test_an_experience_of_the_same_kind_fits() -> None:
    assert misfit(manifest(), spec(), STATES, "y") is None


@pytest.mark.parametrize(
    ("robot", "states", "axis", "reason"),
    [
        (spec(kind="arm"), STATES, "x", "learned on a quadrotor, this robot is a arm"),
        (spec(), STATES, "z", "learned on x, y, not on axis 'z'"),
        (spec(), STATES, "w", "has no axis 'w'"),
        (spec(sample_time_s=0.015), STATES, "x", "sample time is 0.02 s, the robot's 0.015 s"),
        (spec(), ("position",), "x", "needs the states position, velocity"),
        (spec(), (), "x", "the robot measures none"),
    ],
)
def test_an_experience_that_does_not_fit_is_refused_with_the_reason(
    robot: RobotSpec, states: tuple[str, ...], axis: str, reason: str
) -> None:
    found = misfit(manifest(), robot, states, axis)
    assert found is not None
    assert reason in found


def test_an_axis_in_another_unit_is_refused() -> None:
    found = misfit(manifest(unit="rad"), spec(), STATES, "x")
    assert found == "it is in rad, axis 'x' is in m"
