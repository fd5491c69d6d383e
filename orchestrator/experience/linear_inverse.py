"""A linear inverse as an experience, fitted to a flight at once without training a network."""

from __future__ import annotations

import numpy as np

from nufleet.orchestrator.experience.training import Origin, TrainingData, data_sha256, ridge
from nufleet.shared.experience.file import Experience
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.experience.manifest import ExperienceManifest

_RIDGE = 1e-4


def linear_experience(
    data: TrainingData, layout: InverseLayout, origin: Origin, *, gain: float = 1.0
) -> Experience:
    """Fit γ = gain · inputs · w by ridge regression on inputs scaled by their standard deviation.

    The manifest's `validation_rms` is the error on the data themselves with a gain of one, since
    there are too few weights to overfit.

    Args:
        data: Training pairs, with inputs of shape (m, inputs) and γ of shape (m,).
        layout: Layout of the inverse model.
        origin: Robot and axes that the data come from.
        gain: Factor on the output, other than 1 only to test the margin of stability.

    Returns:
        An experience with a single linear layer.
    """
    # The floor avoids a division by zero for an input that never changes.
    scale = np.maximum(data.inputs.std(axis=0), 1e-12)
    scaled = data.inputs / scale
    weights = ridge(scaled, data.gamma, _RIDGE)
    left = data.gamma - scaled @ weights
    manifest = ExperienceManifest(
        **vars(origin),
        layout=layout,
        inputs=layout.input_names,
        hidden=(),
        input_mean=(0.0,) * len(scale),
        input_scale=tuple(scale.tolist()),
        output_mean=0.0,
        output_scale=1.0,
        points=len(data.gamma),
        validation_rms=float(np.sqrt(np.mean(left**2))),
        data_sha256=data_sha256(data),
        seed=0,
        training_version="linear",
    )
    # The manifest's input_scale divides the inputs again, so the weights fit scaled inputs.
    arrays = {
        "weight_0": (gain * weights[:, np.newaxis]).astype(np.float32),
        "bias_0": np.zeros(1, np.float32),
    }
    return Experience(manifest, arrays)
