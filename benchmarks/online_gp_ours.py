"""Other ways for us to search: from the paper's start in every step, and from two starts."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from benchmarks.online_gp_peers import Answer, Peer
from nufleet.robot_agent.flight.online_gp import BOUNDS, START
from nufleet.shared.arrays import FloatArray
from nufleet.shared.gaussian_process.exact import fit, posterior
from nufleet.shared.gaussian_process.problem import Batch, Hyperparameters

NEARLY_LINEAR = Hyperparameters(0.01, BOUNDS.lengthscale[1], BOUNDS.noise_variance[0])
"""Second starting point: of several tried on recorded windows, it left the fewest local maxima."""


def papers_start(dimension: int, points: int) -> Peer:  # noqa: ARG001
    """Search from the paper's start."""
    return lambda x, y, q, start: _searched(x, y, q, [START])


def two_starts(dimension: int, points: int) -> Peer:  # noqa: ARG001
    """Search from the last maximum and from a nearly linear function; keep the better."""
    last = [START]

    def step(x: FloatArray, y: FloatArray, q: FloatArray, start: FloatArray) -> Answer:  # noqa: ARG001
        answer = _searched(x, y, q, [last[0], NEARLY_LINEAR])
        last[0] = Hyperparameters.from_log(answer.theta)
        return answer

    return step


def _searched(
    inputs: FloatArray, targets: FloatArray, queries: FloatArray, starts: list[Hyperparameters]
) -> Answer:
    batch = Batch.ragged(list(inputs), list(targets))
    found = fit(batch, starts, BOUNDS, evaluations_max=100, threads=1)
    means, _ = posterior(batch, found.hyperparameters, queries, threads=1)
    return Answer(
        found.hyperparameters.log(len(batch)), np.diag(means), found.log_marginal_likelihood
    )


OURS: dict[str, Callable[[int, int], Peer]] = {
    "nufleet, cold": papers_start,
    "nufleet, two starts": two_starts,
}
