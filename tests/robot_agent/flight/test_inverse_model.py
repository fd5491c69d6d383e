"""Inverse models as the robot computes them."""

from __future__ import annotations

import numpy as np

from nufleet.robot_agent.flight.inverse_model import NetworkInverse
from nufleet.shared.experience.file import Experience
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.experience.manifest import ExperienceManifest

LAYOUT = InverseLayout(
    architecture="state", states=("position",), sample_time_s=0.02, horizon_samples=5
)


def test_a_network_by_hand_computes_what_it_says() -> None:
    """γ = 3 |(ξ₀ − 1) / 2| + 0.5: two ReLU units make an absolute value."""
    manifest = ExperienceManifest(
        robot="r",
        robot_kind="k",
        axes=("x",),
        unit="m",
        layout=LAYOUT,
        inputs=LAYOUT.input_names,
        relative_degree=1,
        hidden=(2,),
        input_mean=(1.0, 0.0),
        input_scale=(2.0, 1.0),
        output_mean=0.5,
        output_scale=3.0,
        points=1,
        validation_rms=0.0,
        data_sha256="0" * 64,
        seed=0,
        training_version="1",
    )
    arrays = {
        "weight_0": np.array([[1.0, -1.0], [0.0, 0.0]], np.float32),
        "bias_0": np.zeros(2, np.float32),
        "weight_1": np.ones((2, 1), np.float32),
        "bias_1": np.zeros(1, np.float32),
    }
    inputs = np.array([[-3.0, 9.0], [1.0, 9.0], [2.0, 9.0]])
    np.testing.assert_allclose(
        NetworkInverse(Experience(manifest, arrays))(inputs), [6.5, 0.5, 2.0], rtol=1e-12
    )
