"""Trains the network of an experience with torch.

Here and not beside the robot: a robot flies and records, and needs neither torch nor the seconds of
two processor cores that this takes.
"""

from __future__ import annotations

import copy
import hashlib
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Literal

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.file import Experience
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.experience.manifest import ExperienceManifest

if TYPE_CHECKING:
    import torch

TRAINING_VERSION = "2"
"""Changes whenever the same data and seed would give another network."""

POINTS = 2100
"""Of a source's dataset (paper, Section VI-A)."""

_BLOCKS = 50
_VALIDATION_EVERY = 5
STEPS_MAX = 1500
"""Of descent on batches."""

RIDGES = (1e-6, 1e-5, 1e-4, 1e-3)
"""Of the linear inverse that a network begins as; the one that does best on points held back."""

_BATCH = 128
_EVALUATE_EVERY = 20
_PATIENCE_STEPS = 800
_LEARNING_RATE = 3e-4
_WEIGHT_DECAY = 1e-5


@dataclass(frozen=True, eq=False)
class TrainingData:
    """Pairs of inputs (m, inputs) and γ (m,), in the order they were flown."""

    inputs: FloatArray
    gamma: FloatArray


@dataclass(frozen=True)
class Origin:
    """Where an experience comes from."""

    robot: str
    robot_kind: str
    axes: tuple[str, ...]
    unit: Literal["m", "rad"]
    relative_degree: int


def train(
    data: TrainingData,
    layout: InverseLayout,
    origin: Origin,
    *,
    seed: int,
    points: int = POINTS,
    steps_max: int = STEPS_MAX,
) -> Experience:
    """Train the paper's network, 4 × 128 ReLU, on `points` of the pairs.

    It begins as the linear inverse of the same points, carried by two units of each layer: nearly
    all of a baseline loop is linear, and a network that begins at random needs ten times as long
    to come close to that.

    The points are spread evenly over the flight; every fifth of fifty stretches of it is held back,
    and training stops when these no longer get better. The same data and seed give the same
    network, also when several are trained at once, one thread each.

    Raises:
        InvalidInputError: fewer pairs than points, pairs that are not finite, or inputs that never
            change.
    """
    if len(data.gamma) < points or points < 10 * _BLOCKS:
        raise InvalidInputError(
            f"robot {origin.robot}: {points} points are needed, at least 500; got "
            f"{len(data.gamma)}: let it fly for longer (--duration)"
        )
    if not (np.isfinite(data.inputs).all() and np.isfinite(data.gamma).all()):
        raise InvalidInputError(
            f"robot {origin.robot}: the training data hold a number that is not finite"
        )
    chosen = np.linspace(0, len(data.gamma) - 1, points).round().astype(int)
    inputs, gamma = data.inputs[chosen], data.gamma[chosen]
    held_back = (
        np.arange(points) * _BLOCKS // points
    ) % _VALIDATION_EVERY == _VALIDATION_EVERY // 2
    mean, scale = inputs[~held_back].mean(axis=0), inputs[~held_back].std(axis=0)
    offset, spread = float(gamma[~held_back].mean()), float(gamma[~held_back].std())
    if spread == 0 or (scale == 0).any():
        raise InvalidInputError(
            f"robot {origin.robot}: the training data do not vary: it was not excited"
        )
    network, error = _fit(
        (inputs - mean) / scale, (gamma - offset) / spread, held_back, seed, steps_max
    )
    manifest = ExperienceManifest(
        robot=origin.robot,
        robot_kind=origin.robot_kind,
        axes=origin.axes,
        unit=origin.unit,
        layout=layout,
        inputs=layout.input_names,
        relative_degree=origin.relative_degree,
        input_mean=tuple(mean.tolist()),
        input_scale=tuple(scale.tolist()),
        output_mean=offset,
        output_scale=spread,
        points=points,
        validation_rms=error * spread,
        data_sha256=data_sha256(TrainingData(inputs, gamma)),
        seed=seed,
        training_version=TRAINING_VERSION,
    )
    return Experience(manifest, _arrays(network))


def data_sha256(data: TrainingData) -> str:
    """Return a hash of training pairs."""
    numbers = data.inputs.astype("<f8").tobytes() + data.gamma.astype("<f8").tobytes()
    return hashlib.sha256(numbers).hexdigest()


def ridge(inputs: FloatArray, targets: FloatArray, weight: float) -> FloatArray:
    """Return w of targets ≈ inputs · w, by ridge regression on inputs that have one scale."""
    normal = inputs.T @ inputs / len(inputs) + weight * np.eye(inputs.shape[1])
    return np.asarray(np.linalg.solve(normal, inputs.T @ targets / len(inputs)))


def _fit(
    inputs: FloatArray, targets: FloatArray, held_back: np.ndarray, seed: int, steps_max: int
) -> tuple[torch.nn.Sequential, float]:
    """Return the network that was best on the points held back, and its error there."""
    import torch

    learned, judged = ~held_back, held_back
    linear = min(
        (ridge(inputs[learned], targets[learned], weight) for weight in RIDGES),
        key=lambda w: float(np.mean((inputs[judged] @ w - targets[judged]) ** 2)),
    )
    # Matrices this small gain nothing from more threads, and with one the sums have one order.
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(seed)
    return _descend(
        _network(linear, generator),
        torch.tensor(inputs, dtype=torch.float32),
        torch.tensor(targets, dtype=torch.float32)[:, None],
        torch.tensor(held_back),
        generator,
        steps_max,
    )


def _descend(
    network: torch.nn.Sequential,
    inputs: torch.Tensor,
    targets: torch.Tensor,
    held_back: torch.Tensor,
    generator: torch.Generator,
    steps_max: int,
) -> tuple[torch.nn.Sequential, float]:
    import torch

    optimizer = torch.optim.AdamW(
        network.parameters(), lr=_LEARNING_RATE, weight_decay=_WEIGHT_DECAY
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(1, steps_max))
    learned = inputs[~held_back], targets[~held_back]
    judged = inputs[held_back], targets[held_back]
    best, best_step, best_error = copy.deepcopy(network.state_dict()), 0, float("inf")
    for step in range(steps_max + 1):
        if step % _EVALUATE_EVERY == 0 or step == steps_max:
            with torch.no_grad():
                error = float(torch.mean((network(judged[0]) - judged[1]) ** 2).sqrt())
            if error < best_error:
                best, best_step, best_error = copy.deepcopy(network.state_dict()), step, error
            if step == steps_max or step - best_step > _PATIENCE_STEPS:
                break
        batch = torch.randint(len(learned[0]), (_BATCH,), generator=generator)
        optimizer.zero_grad()
        loss = torch.mean((network(learned[0][batch]) - learned[1][batch]) ** 2)
        loss.backward()  # type: ignore[no-untyped-call]
        optimizer.step()
        schedule.step()
    network.load_state_dict(best)
    return network, best_error


def _network(linear: FloatArray, generator: torch.Generator) -> torch.nn.Sequential:
    """Return a network that computes inputs · linear, its other units drawn from the generator.

    w·x = max(0, w·x) − max(0, −w·x): the first two units of each layer hand these on.
    """
    import torch

    widths = (len(linear), *ExperienceManifest.model_fields["hidden"].default, 1)
    # Without torch's own start, which would draw from its global generator.
    layers: list[torch.nn.Linear] = [
        torch.nn.utils.skip_init(torch.nn.Linear, *pair)  # type: ignore[no-untyped-call]
        for pair in pairwise(widths)
    ]
    first, last = layers[0], layers[-1]
    with torch.no_grad():
        for layer in layers:
            bound = layer.in_features**-0.5  # torch's own choice for a linear layer
            layer.weight.uniform_(-bound, bound, generator=generator)
            layer.bias.uniform_(-bound, bound, generator=generator)
        for layer in layers[:-1]:
            layer.weight[:2] = 0.0
            layer.bias[:2] = 0.0
        for layer in layers[1:-1]:
            layer.weight[0, 0] = layer.weight[1, 1] = 1.0
        first.weight[0] = torch.tensor(linear, dtype=torch.float32)
        first.weight[1] = -first.weight[0]
        last.weight.zero_()
        last.bias.zero_()
        last.weight[0, 0], last.weight[0, 1] = 1.0, -1.0
    modules = [module for layer in layers for module in (layer, torch.nn.ReLU())]
    return torch.nn.Sequential(*modules[:-1])


def _arrays(network: torch.nn.Sequential) -> dict[str, np.ndarray]:
    import torch

    arrays = {}
    linear = [module for module in network if isinstance(module, torch.nn.Linear)]
    for i, module in enumerate(linear):
        arrays[f"weight_{i}"] = np.ascontiguousarray(module.weight.detach().numpy().T)
        arrays[f"bias_{i}"] = module.bias.detach().numpy().copy()
    return arrays
