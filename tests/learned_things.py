"""Experiences and layouts that the tests of a robot's memory and flights share."""

from __future__ import annotations

import numpy as np

from nufleet.robot_agent.flight.own_model import evidence_in
from nufleet.shared.experience.file import Experience, encode_experience
from nufleet.shared.experience.layout import Architecture, InverseLayout
from nufleet.shared.experience.manifest import ExperienceManifest
from nufleet.shared.models.evidence import Evidence
from nufleet.shared.robots.spec import RobotSpec


def flown_before(spec: RobotSpec, *axes: str) -> dict[str, Evidence]:
    """The evidence of a motion of some axes, all by default, that lags by three samples."""
    rng, moved = np.random.default_rng(0), axes or tuple(axis.name for axis in spec.axes)
    walk = np.cumsum(rng.standard_normal((600, len(spec.axes))), axis=0)
    walk = np.array([axis.name in moved for axis in spec.axes]) * (walk - walk[0])
    late = np.concatenate([np.zeros((3, len(spec.axes))), walk[:-3]])
    return evidence_in(spec, walk, late + 1e-3 * rng.standard_normal(late.shape))


def layout(architecture: Architecture = "preview", **changes: object) -> InverseLayout:
    fields: dict[str, object] = {
        "architecture": architecture,
        "states": ("position", "velocity") if architecture == "state" else ("position",),
        "sample_time_s": 0.015,
        "horizon_samples": 20,
    }
    return InverseLayout.model_validate(fields | changes)


def experience(
    robot: str = "source", architecture: Architecture = "preview", seed: int = 0, **changes: object
) -> bytes:
    """A linear inverse with weights drawn from a seed, as a file."""
    known = changes.pop("layout", layout(architecture))
    assert isinstance(known, InverseLayout)
    names = known.input_names
    fields: dict[str, object] = {
        "robot": robot,
        "robot_kind": "double-integrator",
        "axes": ("x",),
        "unit": "m",
        "layout": known,
        "inputs": names,
        "relative_degree": 1,
        "hidden": (),
        "input_mean": (0.0,) * len(names),
        "input_scale": (1.0,) * len(names),
        "output_mean": 0.0,
        "output_scale": 1.0,
        "points": 100,
        "validation_rms": 0.01,
        "data_sha256": "0" * 64,
        "seed": seed,
        "training_version": "linear",
    }
    manifest = ExperienceManifest.model_validate(fields | changes)
    rng = np.random.default_rng(seed)
    arrays = {
        name: 0.01 * rng.standard_normal(shape).astype(np.float32)
        for name, shape in manifest.shapes.items()
    }
    return encode_experience(Experience(manifest, arrays))
