"""Trains the network of an experience with torch; a linear robot's inverse needs no network.

Training runs in the orchestrator and not in the robot agent: a robot only flies and records, and
needs neither torch nor the seconds that training occupies two processor cores.
"""

from __future__ import annotations

import copy
import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from importlib.util import find_spec
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

Stepped = Callable[[int, int], None]
"""Receives the number of optimizer steps that are done, and how many there are at most."""

TRAINING_VERSION = "3"
"""Version of the training, increased whenever the same data and seed would give another network."""

POINTS = 2100
"""Number of points in a source's dataset (paper, Section VI-A)."""

# One stretch in five is held back for validation. Stretches and not single points: neighbouring
# points are nearly equal, and a point between two learned ones would say little.
_BLOCKS = 50
_VALIDATION_EVERY = 5
STEPS_MAX = 1500
"""Limit on the number of optimizer steps, each on one batch."""

RIDGES = (1e-6, 1e-5, 1e-4, 1e-3)
"""Ridge weights to try for the linear inverse that initializes a network; the one with the smallest
error on the points held back is used."""

LINEAR_ENOUGH = 0.01
"""Largest error of a linear inverse on the points held back, as a share of γ's standard deviation,
at which it is the experience itself.

Less than that separates no two robots: their responses are known to a few hundredths at best. On
simulated linear robots a linear inverse leaves 0.3 %, of which 1500 steps take away a fifth.
"""

_BATCH = 128
_EVALUATE_EVERY = 20
_PATIENCE_STEPS = 800
_LEARNING_RATE = 3e-4
_WEIGHT_DECAY = 1e-5


def check_torch() -> None:
    """Raise InvalidInputError unless networks can be trained here."""
    if find_spec("torch") is None:
        raise InvalidInputError(
            "training needs torch: pip install 'nufleet[learning]' beside the orchestrator"
        )


@dataclass(frozen=True, eq=False)
class TrainingData:
    """Training pairs of an inverse model, in the order in which they were flown."""

    inputs: FloatArray
    """Inputs ξ of the inverse, in the units of its layout, shape (m, inputs)."""
    gamma: FloatArray
    """Outputs γ in the axes' unit per second, shape (m,)."""


@dataclass(frozen=True)
class Origin:
    """The robot that an experience comes from."""

    robot: str
    """Name of the robot."""
    robot_kind: str
    """Kind of the robot, as in its spec."""
    axes: tuple[str, ...]
    """Names of the axes whose data are pooled."""
    unit: Literal["m", "rad"]
    """Unit of these axes."""
    relative_degree: int
    """Delay of the robot in samples, the largest of these axes."""


def train(
    data: TrainingData,
    layout: InverseLayout,
    origin: Origin,
    *,
    seed: int,
    points: int = POINTS,
    steps_max: int = STEPS_MAX,
    stepped: Stepped = lambda done, most: None,
) -> Experience:
    """Train the paper's network, 4 × 128 ReLU (Section VI-A), on `points` of the pairs.

    The network begins as the linear inverse of the same points, carried by two units of each layer:
    nearly all of a baseline loop is linear, and a network with random weights needs ten times as
    long to come close to that. Where the linear inverse leaves no more than `LINEAR_ENOUGH`, no
    network is trained: the linear inverse is the experience, and torch is not even loaded.

    The points are spread evenly over the flight. Every fifth of fifty stretches of it is held back,
    and training stops when the error on these no longer falls. The same data and seed give the same
    network, even when several are trained at once, one thread each.

    Args:
        data: Training pairs, with inputs of shape (m, inputs) and γ of shape (m,).
        layout: Layout of the inverse model.
        origin: Robot and axes that the data come from.
        seed: Seed of the first weights and of the batches.
        points: Number of pairs to train on, at least 500.
        steps_max: Limit on the number of optimizer steps.
        stepped: Callback that receives the number of steps that are done, and the limit; equal to
            the limit in the end, also when training stops before.

    Returns:
        The model with its manifest, whose `validation_rms` is the error on the points held back,
        in the unit of γ; without hidden layers if it is linear.

    Raises:
        InvalidInputError: There are fewer pairs than points, some are not finite, an input or the
            output never changes, or a network has to be trained and torch is not installed.
    """
    if len(data.gamma) < points or points < 10 * _BLOCKS:
        raise InvalidInputError(
            f"robot {origin.robot}: training needs {points} points, and no fewer than 500; there "
            f"are {len(data.gamma)}: let the robot fly for longer (--duration)"
        )
    if not (np.isfinite(data.inputs).all() and np.isfinite(data.gamma).all()):
        raise InvalidInputError(
            f"robot {origin.robot}: the training data contain a number that is not finite"
        )
    chosen = np.linspace(0, len(data.gamma) - 1, points).round().astype(int)
    inputs, gamma = data.inputs[chosen], data.gamma[chosen]
    # The middle one of every five stretches is held back, so that learned ones surround it.
    held_back = (
        np.arange(points) * _BLOCKS // points
    ) % _VALIDATION_EVERY == _VALIDATION_EVERY // 2
    # Standardize with the points learned from alone: those held back must stay unseen.
    mean, scale = inputs[~held_back].mean(axis=0), inputs[~held_back].std(axis=0)
    offset, spread = float(gamma[~held_back].mean()), float(gamma[~held_back].std())
    if spread == 0 or (scale == 0).any():
        raise InvalidInputError(
            f"robot {origin.robot}: the training data do not vary: the robot was not excited"
        )
    scaled, targets = (inputs - mean) / scale, (gamma - offset) / spread
    linear, error = _linear(scaled, targets, held_back)
    hidden: tuple[int, ...] = ()
    arrays = {"weight_0": linear[:, np.newaxis].astype(np.float32), "bias_0": np.zeros(1, "f4")}
    if error > LINEAR_ENOUGH:
        check_torch()
        hidden = ExperienceManifest.model_fields["hidden"].default
        network, error = _fit(linear, scaled, targets, held_back, seed, steps_max, stepped)
        arrays = _arrays(network)
    manifest = ExperienceManifest(
        robot=origin.robot,
        robot_kind=origin.robot_kind,
        axes=origin.axes,
        unit=origin.unit,
        layout=layout,
        inputs=layout.input_names,
        relative_degree=origin.relative_degree,
        hidden=hidden,
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
    return Experience(manifest, arrays)


def data_sha256(data: TrainingData) -> str:
    """Return the SHA-256 of training pairs as little-endian 64-bit numbers, inputs before γ."""
    numbers = data.inputs.astype("<f8").tobytes() + data.gamma.astype("<f8").tobytes()
    return hashlib.sha256(numbers).hexdigest()


def ridge(inputs: FloatArray, targets: FloatArray, weight: float) -> FloatArray:
    """Return the weights of targets ≈ inputs · w by ridge regression (Hoerl and Kennard 1970).

    Solves (XᵀX/m + λ I) w = Xᵀy/m; the division by m makes λ independent of the number of points.

    Args:
        inputs: Inputs X, shape (m, inputs), scaled to a common magnitude.
        targets: Outputs y, shape (m,).
        weight: Regularization weight λ.

    Returns:
        Weights w, shape (inputs,).
    """
    normal = inputs.T @ inputs / len(inputs) + weight * np.eye(inputs.shape[1])
    return np.asarray(np.linalg.solve(normal, inputs.T @ targets / len(inputs)))


def _linear(
    inputs: FloatArray, targets: FloatArray, held_back: np.ndarray
) -> tuple[FloatArray, float]:
    """Return the linear inverse with the smallest error on the points held back, and that error."""
    learned, judged = ~held_back, held_back

    def error(weights: FloatArray) -> float:
        return float(np.sqrt(np.mean((inputs[judged] @ weights - targets[judged]) ** 2)))

    best = min((ridge(inputs[learned], targets[learned], r) for r in RIDGES), key=error)
    return best, error(best)


def _fit(
    linear: FloatArray,
    inputs: FloatArray,
    targets: FloatArray,
    held_back: np.ndarray,
    seed: int,
    steps_max: int,
    stepped: Stepped,
) -> tuple[torch.nn.Sequential, float]:
    """Return the network with the smallest error on the points held back, and that RMS error."""
    import torch

    # Matrices this small gain nothing from more threads, and a single thread adds numbers in one
    # fixed order, which makes the network reproducible.
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(seed)
    return _descend(
        _network(linear, generator),
        torch.tensor(inputs, dtype=torch.float32),
        torch.tensor(targets, dtype=torch.float32)[:, None],
        torch.tensor(held_back),
        generator,
        steps_max,
        stepped,
    )


def _descend(
    network: torch.nn.Sequential,
    inputs: torch.Tensor,
    targets: torch.Tensor,
    held_back: torch.Tensor,
    generator: torch.Generator,
    steps_max: int,
    stepped: Stepped,
) -> tuple[torch.nn.Sequential, float]:
    import torch

    # AdamW with a cosine schedule (Loshchilov and Hutter 2017, 2019). The network with the smallest
    # error on the points held back is kept, whichever step it came from (early stopping).
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=_LEARNING_RATE, weight_decay=_WEIGHT_DECAY
    )
    schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, max(1, steps_max))
    learned = inputs[~held_back], targets[~held_back]
    judged = inputs[held_back], targets[held_back]
    best, best_step, best_error = copy.deepcopy(network.state_dict()), 0, float("inf")
    for step in range(steps_max + 1):
        if step % _EVALUATE_EVERY == 0 or step == steps_max:
            stepped(step, steps_max)
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
    stepped(steps_max, steps_max)
    network.load_state_dict(best)
    return network, best_error


def _network(linear: FloatArray, generator: torch.Generator) -> torch.nn.Sequential:
    """Return a network that computes inputs · linear, its other units drawn from the generator.

    Since w·x = max(0, w·x) − max(0, −w·x), the first two units of each layer carry the two terms
    unchanged through the ReLUs. The last layer subtracts them and ignores all other units.
    """
    import torch

    widths = (len(linear), *ExperienceManifest.model_fields["hidden"].default, 1)
    # Skip torch's own initialization, which would draw from its global generator.
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
        # Units 0 and 1 of each hidden layer pass max(0, w·x) and max(0, −w·x) on: they take nothing
        # from the random units, and ReLU leaves their non-negative values unchanged.
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
