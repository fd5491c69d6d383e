"""Exact Gaussian processes, zero mean and Matérn 3/2, with hyperparameters of maximum likelihood.

One compiled core serves two uses: the surrogates of the experience selection, thousands of small
problems at once, and the online model in a robot's control loop
(`nufleet.shared.gaussian_process.online`). The kernel is isotropic,
κ(x, x') = σ_f² (1 + s) e^{−s} with s = √3 |x − x'| / ℓ. Measurement i has the noise variance
σ_n² + v_i, of which v_i is known. See Rasmussen & Williams, *Gaussian Processes for Machine
Learning* (2006), ch. 2 and 5.
"""

from __future__ import annotations

import math
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
from nufleet.shared.gaussian_process.problem import (
    GRADIENT_TOLERANCE,
    Batch,
    Bounds,
    Hyperparameters,
)

_PROBLEMS_WORTH_A_THREAD = 32
"""Number of problems per thread below which starting another thread costs more than it saves."""


@dataclass(frozen=True, eq=False)
class BatchFit:
    """The result of fitting each problem of a batch; every array has shape (problems,)."""

    hyperparameters: Hyperparameters
    """The hyperparameters at the best maximum, one of each per problem."""
    log_marginal_likelihood: FloatArray
    """log p(y | x, θ) at that maximum."""
    projected_gradient: FloatArray
    """Largest component of |θ − clip(θ − ∇f(θ))|, where f is the negative log marginal likelihood,
    θ the log hyperparameters, and clip restricts to the bounds; it is zero at a stationary point.
    """
    jitter: FloatArray
    """Addition to the diagonal of the covariance, as a fraction of the signal variance."""
    evaluations: NDArray[np.int64]
    """Number of likelihood evaluations, summed over all starts."""
    status: NDArray[np.int64]
    """`FitStatus` of the start that gave the best maximum."""


def fit(
    batch: Batch,
    starts: Sequence[Hyperparameters],
    bounds: Bounds,
    *,
    evaluations_max: int = 500,
    threads: int | None = None,
) -> BatchFit:
    """Maximise the log marginal likelihood of every problem (Rasmussen & Williams, section 5.4.1).

    The result is the same for any number of threads.

    Args:
        batch: Problems to fit.
        starts: Hyperparameters to start the search from, at least one set. The best maximum found
            is kept, and the first one if several are equal.
        bounds: Bounds on the hyperparameters; a start outside is moved to the nearest bound.
        evaluations_max: Limit on likelihood evaluations per problem and start.
        threads: Largest number of threads; None means one per processor.

    Returns:
        The best maximum of each problem and how its search ended, arrays of shape (problems,).

    Raises:
        ValueError: `starts` is empty, or holds values for another number of problems. Numerical
            trouble never raises; it is reported as a `FitStatus`.
    """
    if not starts:
        raise ValueError("fit needs at least one start")
    problems = len(batch)
    first_points = np.stack([start.log(problems) for start in starts])
    theta, outcomes = np.empty((problems, 3)), np.empty((problems, 3))
    counts = np.empty((problems, 2), dtype=np.int64)
    search = (first_points, bounds.log(), GRADIENT_TOLERANCE, evaluations_max)

    from nufleet.shared.gaussian_process import core

    def fit_range(first: int, last: int) -> None:
        core.fit_range(*batch.columns, first, last, *search, theta, outcomes, counts)

    _share_out(fit_range, problems, threads)
    return BatchFit(Hyperparameters.from_log(theta), *outcomes.T.copy(), *counts.T.copy())


def log_marginal_likelihood(
    batch: Batch, hyperparameters: Hyperparameters
) -> tuple[FloatArray, FloatArray]:
    """Return the log marginal likelihood of every problem and its gradient.

    It implements Rasmussen & Williams, eq. 2.30 and 5.9, with θ = (log σ_f², log ℓ, log σ_n²).

    Args:
        batch: Problems to evaluate.
        hyperparameters: One set for all problems, or one per problem.

    Returns:
        log p(y | x, θ), shape (problems,), and its gradient in θ, shape (problems, 3). If no jitter
        makes a covariance positive definite, the value is −∞ and the gradient zero.

    Raises:
        ValueError: the hyperparameters are given for another number of problems.
    """
    from nufleet.shared.gaussian_process import core

    problems = len(batch)
    value, gradient = np.empty(problems), np.empty((problems, 3))
    theta = hyperparameters.log(problems)
    core.likelihood_range(*batch.columns, 0, problems, theta, value, gradient)
    return value, gradient


def posterior(
    batch: Batch,
    hyperparameters: Hyperparameters,
    x_query: FloatArray,
    *,
    threads: int | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Return the posterior mean and variance of every problem's function, without noise.

    It implements Rasmussen & Williams, eq. 2.25 and 2.26, which is the paper's eq. (2) with a prior
    mean of zero.

    Args:
        batch: Problems to predict.
        hyperparameters: One set for all problems, or one per problem.
        x_query: Points to predict at, the same for all problems, shape (queries,) or (queries, d),
            in the inputs' unit.
        threads: Largest number of threads; None means one per processor.

    Returns:
        Mean and variance, each of shape (problems, queries), in the targets' unit and its square.
        A covariance that is not positive definite gets the smallest jitter that makes it so; if
        none does, the result is the prior.

    Raises:
        ValueError: `x_query` is not finite or has another dimension, or the hyperparameters are
            given for another number of problems.
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
        core.posterior_range(*batch.columns, first, last, theta, queries, mean, variance)

    _share_out(posterior_range, problems, threads)
    return mean, variance


def posterior_weights(
    inputs: FloatArray, hyperparameters: Hyperparameters, query: FloatArray
) -> tuple[FloatArray, float]:
    """Return how the posterior mean at one point is made up of the targets of one problem.

    The mean is aᵀy with a = K⁻¹k (Rasmussen & Williams, eq. 2.25), so that one factorisation serves
    any number of targets at the same inputs.

    Args:
        inputs: Inputs of the problem, shape (n, d).
        hyperparameters: One set, with a noise variance above 0.
        query: Point to predict at, shape (d,), in the inputs' unit.

    Returns:
        The weights a, shape (n,), and the variance at the point without noise.
    """
    signal, lengthscale, noise = (
        float(np.ravel(value)[0])
        for value in (
            hyperparameters.signal_variance,
            hyperparameters.lengthscale,
            hyperparameters.noise_variance,
        )
    )
    points = np.concatenate([inputs, query[np.newaxis]])
    # |x − x'|² = |x|² + |x'|² − 2 x·x', from the query, so that near points lose few digits.
    apart = (points - query) * (math.sqrt(3.0) / lengthscale)
    squares = np.einsum("ij,ij->i", apart, apart)
    products = apart[:-1] @ apart.T
    scaled = np.sqrt(np.maximum(squares[:-1, np.newaxis] + squares - 2.0 * products, 0.0))
    covariance = signal * (1.0 + scaled) * np.exp(-scaled)
    between = covariance[:, -1]
    known = covariance[:, :-1]
    known[np.diag_indices(len(inputs))] += noise
    weights = np.linalg.solve(known, between)
    return weights, max(0.0, signal - float(between @ weights))


def warm_up() -> None:
    """Load the compiled core ahead of time, so that no later call has to wait for it.

    Compilation takes some ten seconds; afterwards numba's cache is used. The cache is kept in
    NUMBA_CACHE_DIR if that is set, otherwise next to the module, or in the user's cache folder if
    the module's folder cannot be written.
    """
    import_module("nufleet.shared.gaussian_process.core")


def _share_out(work: Callable[[int, int], None], problems: int, threads: int | None) -> None:
    """Run `work` on ranges that cover 0 to `problems`, on several threads where that pays off.

    The threads are Python's rather than numba's: the kernels release the interpreter lock, and
    numba's fallback thread layer ends the process when two Python threads enter it at once.
    """
    if threads is None:
        threads = len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1
    workers = min(threads, problems // _PROBLEMS_WORTH_A_THREAD)
    if workers < 2:
        work(0, problems)
        return
    # Eight ranges per thread even out problems that take longer than others.
    edges = np.linspace(0, problems, 8 * workers + 1).astype(int).tolist()
    with ThreadPoolExecutor(workers) as pool:
        for done in [pool.submit(work, a, b) for a, b in pairwise(edges)]:
            done.result()
