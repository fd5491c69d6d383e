"""Exact Gaussian processes, zero mean and Matérn 3/2, with hyperparameters of maximum likelihood.

One compiled core serves the surrogates of the experience selection, thousands of small problems at
once, and the online model in a robot's control loop (`nufleet.shared.gaussian_process.online`).
κ(x, x') = σ_f² (1 + s) e^{−s}, s = √3 |x − x'| / ℓ, isotropic; measurement i has the noise variance
σ_n² + v_i, of which v_i is known. Rasmussen & Williams, *Gaussian Processes for Machine Learning*
(2006), ch. 2 and 5.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from nufleet.shared.arrays import FloatArray
from nufleet.shared.gaussian_process.problem import Batch, Bounds, FitStatus, Hyperparameters

__all__ = [
    "Batch",
    "BatchFit",
    "Bounds",
    "FitStatus",
    "Hyperparameters",
    "fit",
    "log_marginal_likelihood",
    "posterior",
    "warm_up",
]

_PROBLEMS_WORTH_A_THREAD = 32


@dataclass(frozen=True, eq=False)
class BatchFit:
    """What was found for each problem; every array has shape (problems,).

    With f the negative log marginal likelihood and θ the log hyperparameters, `projected_gradient`
    is the largest component of θ − clip(θ − ∇f(θ)), clip keeping to the bounds. `jitter` is what
    was added to the diagonal, as a fraction of the signal variance. `evaluations` counts
    likelihoods over all starts; `status` holds `FitStatus` values.
    """

    hyperparameters: Hyperparameters
    log_marginal_likelihood: FloatArray
    projected_gradient: FloatArray
    jitter: FloatArray
    evaluations: NDArray[np.int64]
    status: NDArray[np.int64]


def fit(
    batch: Batch,
    starts: Sequence[Hyperparameters],
    bounds: Bounds,
    *,
    gradient_tolerance: float = 1e-7,
    evaluations_max: int = 500,
    threads: int | None = None,
) -> BatchFit:
    """Maximise the log marginal likelihood of every problem.

    The result is the same for any number of threads.

    Args:
        batch: the problems.
        starts: where to start, at least one; the best maximum is kept, the first of equals.
        bounds: a start outside is moved inside.
        gradient_tolerance: of the projected gradient in log hyperparameters.
        evaluations_max: likelihoods per problem and start.
        threads: at most; one per processor if left out.

    Raises:
        ValueError: no start, or one for another number of problems. Numerics never raise: see
            `FitStatus`.
    """
    if not starts:
        raise ValueError("fit needs at least one start")
    problems = len(batch)
    first_points = np.stack([start.log(problems) for start in starts])
    limits = bounds.log()
    theta, outcomes = np.empty((problems, 3)), np.empty((problems, 3))
    counts = np.empty((problems, 2), dtype=np.int64)

    from nufleet.shared.gaussian_process import core

    def fit_range(first: int, last: int) -> None:
        core.fit_range(
            batch.inputs,
            batch.targets,
            batch.known_noise_variance,
            batch.offsets,
            first,
            last,
            first_points,
            limits,
            gradient_tolerance,
            evaluations_max,
            theta,
            outcomes,
            counts,
        )

    _share_out(fit_range, problems, threads)
    return BatchFit(Hyperparameters.from_log(theta), *outcomes.T.copy(), *counts.T.copy())


def log_marginal_likelihood(
    batch: Batch, hyperparameters: Hyperparameters
) -> tuple[FloatArray, FloatArray]:
    """Return log p(y | x, θ), shape (problems,), and its gradient in θ, (problems, 3).

    θ = (log σ_f², log ℓ, log σ_n²). A covariance that no jitter makes positive definite gives −∞
    and a zero gradient.

    Raises:
        ValueError: hyperparameters for another number of problems.
    """
    from nufleet.shared.gaussian_process import core

    problems = len(batch)
    value, gradient = np.empty(problems), np.empty((problems, 3))
    core.likelihood_range(
        batch.inputs,
        batch.targets,
        batch.known_noise_variance,
        batch.offsets,
        0,
        problems,
        hyperparameters.log(problems),
        value,
        gradient,
    )
    return value, gradient


def posterior(
    batch: Batch,
    hyperparameters: Hyperparameters,
    x_query: FloatArray,
    *,
    threads: int | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the posterior mean and variance of every problem's function, noise not included.

    Args:
        batch: the problems.
        hyperparameters: those of all problems or of each.
        x_query: the same for all problems, shape (queries,) or (queries, d).
        threads: at most; one per processor if left out.

    Returns:
        Mean and variance, shape (problems, queries). A covariance that is not positive definite
        gets the least jitter that makes it so; where none does, the answer is the prior.

    Raises:
        ValueError: queries that are not finite or of another dimension, or hyperparameters for
            another number of problems.
    """
    from nufleet.shared.gaussian_process import core

    problems, dimension = len(batch), batch.inputs.shape[1]
    columns = x_query[:, None] if x_query.ndim == 1 else x_query
    if columns.ndim != 2 or columns.shape[1] != dimension or not np.all(np.isfinite(columns)):
        raise ValueError(f"x_query must be finite, shape (queries, {dimension}): {x_query.shape}")
    queries = np.require(columns.T, np.float64, ["C", "W"])
    theta = hyperparameters.log(problems)
    mean, variance = np.empty((problems, len(columns))), np.empty((problems, len(columns)))

    def posterior_range(first: int, last: int) -> None:
        core.posterior_range(
            batch.inputs,
            batch.targets,
            batch.known_noise_variance,
            batch.offsets,
            first,
            last,
            theta,
            queries,
            mean,
            variance,
        )

    _share_out(posterior_range, problems, threads)
    return mean, variance


def warm_up() -> None:
    """Compile the core, some ten seconds, or load what numba cached, so that no later call waits.

    The cache lies where NUMBA_CACHE_DIR says, else beside the module, else in the user's cache
    folder.
    """
    import_module("nufleet.shared.gaussian_process.core")


def _share_out(work: Callable[[int, int], None], problems: int, threads: int | None) -> None:
    """Run `work` on ranges that cover 0 to `problems`, on several threads where that pays.

    Plain threads rather than numba's: kernels release the interpreter lock, and numba's fallback
    thread layer ends the process when two Python threads enter it at once.
    """
    if threads is None:
        threads = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    workers = min(threads, problems // _PROBLEMS_WORTH_A_THREAD)
    if workers < 2:
        work(0, problems)
        return
    edges = np.linspace(0, problems, 8 * workers + 1).astype(int).tolist()
    with ThreadPoolExecutor(workers) as pool:
        for done in [pool.submit(work, a, b) for a, b in pairwise(edges)]:
            done.result()
