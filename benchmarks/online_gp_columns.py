"""Runs one library over windows, step by step, and compares what it found with the product."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product as combinations

import numpy as np

from benchmarks.online_gp_peers import Answer, Peer
from benchmarks.online_gp_windows import Windows
from nufleet.robot_agent.flight.online_gp import BOUNDS, START, OnlineGp
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.gaussian_process.exact import fit, log_marginal_likelihood
from nufleet.shared.gaussian_process.problem import Batch, Hyperparameters

EQUAL = 1e-6
STATES = {4: ("position", "velocity"), 5: ("position", "velocity", "tilt")}
"""Names of the states, by the number of inputs that they give."""


@dataclass(frozen=True, eq=False)
class Column:
    """What one way of fitting found in each of some steps.

    theta (steps, axes, 3), mean (steps, axes); `formula_difference` is the largest between the
    likelihoods that the library reports and ours at its hyperparameters. Times are of each step.
    """

    name: str
    start: str
    steps: np.ndarray
    theta: FloatArray
    mean: FloatArray
    formula_difference: float
    wall_s: FloatArray
    processor_s: FloatArray

    def at(self, steps: np.ndarray) -> Column:
        """Return some of its steps, which must be among them."""
        rows = np.searchsorted(self.steps, steps)
        if not np.array_equal(self.steps[rows], steps):
            raise ValueError("the column does not have all of these steps")
        return Column(
            self.name,
            self.start,
            steps,
            self.theta[rows],
            self.mean[rows],
            self.formula_difference,
            self.wall_s[rows],
            self.processor_s[rows],
        )


@dataclass(frozen=True)
class Comparison:
    """Log likelihoods less the product's, over all fits.

    `higher_found_from_papers_start` counts those of the `higher` ones that our own search reaches
    from the paper's start. The lower ones either `stopped_short` of a maximum as high as ours or
    are at `another_maximum`. `mean_difference` is the median of |Δ mean| over equal likelihoods.
    """

    fits: int
    higher: int
    highest: float
    higher_found_from_papers_start: int
    lower: int
    lowest: float
    lower_median: float
    stopped_short: int
    another_maximum: int
    below_best: int
    furthest_below_best: float
    mean_difference: float
    formula_difference: float


def run_product(windows: Windows) -> Column:
    """Run `OnlineGp` as a control loop does; the timed step takes one pair per axis and answers."""
    axes, points, dimension = windows.inputs.shape[1:]
    layout = InverseLayout(
        architecture="state", states=STATES[dimension], sample_time_s=0.02, horizon_samples=20
    )
    process = OnlineGp(layout, (None,) * axes, window=points)
    theta, mean = np.empty((len(windows), axes, 3)), np.empty((len(windows), axes))
    wall_s, processor_s = np.empty(len(windows)), np.empty(len(windows))
    for step in range(len(windows)):
        inputs, targets = windows.inputs[step], windows.targets[step]
        for row in range(points - int(windows.new[step]), points - 1):
            for axis in range(axes):
                process.learn(axis, inputs[axis, row], float(targets[axis, row]))
        began_s, processor_began_s = time.perf_counter(), time.thread_time()
        for axis in range(axes):
            process.learn(axis, inputs[axis, -1], float(targets[axis, -1]))
        correction = process.correct(windows.queries[step])
        processor_s[step] = time.thread_time() - processor_began_s
        wall_s[step] = time.perf_counter() - began_s
        mean[step] = correction.mean
        theta[step] = [found.log(1)[0] for found in process.hyperparameters]
    steps = np.arange(len(windows))
    return Column("nufleet", "warm", steps, theta, mean, 0.0, wall_s, processor_s)


def run(
    name: str,
    make: Callable[[int, int], Peer],
    windows: Windows,
    steps: np.ndarray,
    *,
    warm: bool = False,
) -> Column:
    """Run a peer on some steps; warm, it starts where its last search ended, if that was just now.

    The first step is taken once before, untimed: libraries load and compile on their first call.
    """
    axes, points, dimension = windows.inputs.shape[1:]
    cold = START.log(axes)
    peer = make(dimension, points)
    data = [(windows.inputs[k], windows.targets[k], windows.queries[k]) for k in steps]
    peer(*data[0], cold)
    found: list[Answer] = []
    wall_s, processor_s = np.empty(len(steps)), np.empty(len(steps))
    for i, step in enumerate(steps):
        follows = warm and i > 0 and steps[i - 1] == step - 1
        start = found[-1].theta if follows else cold
        began_s, processor_began_s = time.perf_counter(), time.thread_time()
        found.append(peer(*data[i], start))
        processor_s[i] = time.thread_time() - processor_began_s
        wall_s[i] = time.perf_counter() - began_s
    theta = np.array([answer.theta for answer in found])
    reported = np.array([answer.log_likelihood for answer in found])
    return Column(
        name,
        "warm" if warm else "paper's",
        steps,
        theta,
        np.array([answer.mean for answer in found]),
        float(np.abs(reported - likelihoods(windows.part(steps), theta)).max()),
        wall_s,
        processor_s,
    )


def batch_of(windows: Windows) -> Batch:
    """Return all windows of all axes as one batch, the axes of a step one after another."""
    points, dimension = windows.inputs.shape[2:]
    return Batch.stacked(
        windows.inputs.reshape(-1, points, dimension), windows.targets.reshape(-1, points)
    )


def likelihoods(windows: Windows, theta: FloatArray) -> FloatArray:
    """Return the log marginal likelihoods of all windows, shape (steps, axes), by our formula."""
    at = Hyperparameters.from_log(theta.reshape(-1, 3))
    return log_marginal_likelihood(batch_of(windows), at)[0].reshape(theta.shape[:2])


def searched(windows: Windows, theta: FloatArray) -> FloatArray:
    """Return the maxima that our search reaches from θ (steps, axes, 3), shape (steps, axes)."""
    start = Hyperparameters.from_log(theta.reshape(-1, 3))
    return fit(batch_of(windows), [start], BOUNDS).log_marginal_likelihood.reshape(theta.shape[:2])


def best_known(windows: Windows, columns: list[Column]) -> FloatArray:
    """Return the highest likelihoods found by any column or from 24 starts, (steps, axes)."""
    starts = [
        Hyperparameters(*values)
        for values in combinations((1e-3, 0.03, 0.5), (0.6, 2.5, 12.0, 80.0), (0.002, 0.05))
    ]
    found = fit(batch_of(windows), starts, BOUNDS).log_marginal_likelihood
    best = found.reshape(windows.targets.shape[:2]).copy()
    for column in columns:
        value = likelihoods(windows.part(column.steps), column.theta)
        best[column.steps] = np.maximum(best[column.steps], value)
    return best


def compare(column: Column, product: Column, windows: Windows, best: FloatArray) -> Comparison:
    """Compare a column with the product.

    Args:
        column: on some steps.
        product: on the same steps.
        windows: of these steps.
        best: the highest likelihoods known, shape (steps, axes).
    """
    theirs, ours = likelihoods(windows, column.theta), likelihoods(windows, product.theta)
    gain = theirs - ours
    higher, lower = gain > EQUAL, gain < -EQUAL
    from_papers_start = searched(windows, np.broadcast_to(START.log(1), column.theta.shape))
    onwards = searched(windows, column.theta)
    differences = np.abs(column.mean - product.mean)[~(higher | lower)]
    return Comparison(
        fits=gain.size,
        higher=int(higher.sum()),
        highest=float(max(0.0, gain.max())),
        higher_found_from_papers_start=int((higher & (from_papers_start > theirs - EQUAL)).sum()),
        lower=int(lower.sum()),
        lowest=float(min(0.0, gain.min())),
        lower_median=float(np.median(gain[lower])) if lower.any() else 0.0,
        stopped_short=int((lower & (onwards >= ours - EQUAL)).sum()),
        another_maximum=int((lower & (onwards < ours - EQUAL)).sum()),
        below_best=int((theirs < best - EQUAL).sum()),
        furthest_below_best=float((best - theirs).max()),
        mean_difference=float(np.median(differences)) if differences.size else 0.0,
        formula_difference=column.formula_difference,
    )
