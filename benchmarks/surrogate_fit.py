"""The cost of fitting the surrogates of one iteration, compared with scikit-learn and BoTorch.

Every robot is a random second-order loop with a delay; the data of a pair are noisy chordal
distances at M frequencies. All libraries get the same data, start and bounds, and maximise the
marginal likelihood without priors. Their results are compared by the likelihood, with the same
formula for all. Processor time is summed over all threads; it is more meaningful than wall time on
a shared machine. The BLAS and torch of the other libraries get one thread by default: with matrices
this small, more threads made scikit-learn several times slower.

    python -m benchmarks.surrogate_fit --pairs 100 1000 10000 --points 5 10 20
"""

from __future__ import annotations

import argparse
import json
import os
import time
import warnings
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from threadpoolctl import threadpool_limits  # type: ignore[import-untyped]

from nufleet.shared.arrays import FloatArray
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.gaussian_process.exact import (
    BatchFit,
    fit,
    log_marginal_likelihood,
    posterior,
    warm_up,
)
from nufleet.shared.gaussian_process.problem import Batch, Bounds, FitStatus, Hyperparameters

BAND_RAD_S = (0.1, 10.0)
NOISE = 0.02
START = Hyperparameters(0.1, 0.5, 0.002)
BOUNDS = Bounds((1e-4, 1e2), (1e-2, 1e3), (1e-6, 1.0))
EQUAL = 1e-6

_Result = TypeVar("_Result")


def loops(omega_rad_s: FloatArray, rng: np.random.Generator) -> Any:
    """Return the responses of random loops, one per row of frequencies (pairs, points)."""
    pairs = (len(omega_rad_s), 1)
    natural = np.exp(rng.uniform(np.log(1.0), np.log(6.0), pairs))
    damping, delay_s = rng.uniform(0.2, 1.2, pairs), rng.uniform(0.0, 0.2, pairs)
    s = 1j * omega_rad_s
    return natural**2 / (s * s + 2 * damping * natural * s + natural**2) * np.exp(-s * delay_s)


def measured_pairs(pairs: int, points: int, rng: np.random.Generator) -> Batch:
    """Return chordal distances with noise, at frequencies spread over the band, other per pair."""
    low, high = BAND_RAD_S
    cells = np.arange(points) + rng.uniform(0.0, 1.0, (pairs, points))
    omega = low + (high - low) * cells / points
    psi = chordal_distance(loops(omega, rng), loops(omega, rng))
    return Batch.stacked(omega[:, :, None], psi + NOISE * rng.standard_normal(psi.shape))


@dataclass(frozen=True)
class Cost:
    """Seconds on the clock and of all processors."""

    wall_s: float
    processor_s: float

    def scaled(self, factor: float) -> Cost:
        """Return the cost of `factor` times as much work."""
        return Cost(factor * self.wall_s, factor * self.processor_s)

    def over(self, other: Cost) -> str:
        """Say how many times as much this is."""
        wall, processor = self.wall_s / other.wall_s, self.processor_s / other.processor_s
        return f"{wall:6.0f} × (processor {processor:.0f} ×)"


def timed(action: Callable[[], _Result], repeats: int = 1) -> tuple[Cost, _Result]:
    """Return the least cost of calling `action`, and what it returned."""
    costs = []
    for _ in range(repeats):
        began, processor_began = time.perf_counter(), time.process_time()
        result = action()
        costs.append(Cost(time.perf_counter() - began, time.process_time() - processor_began))
    return Cost(min(c.wall_s for c in costs), min(c.processor_s for c in costs)), result


def part(batch: Batch, problems: int) -> Batch:
    """Return the first problems of a batch whose problems are equally large."""
    rows = batch.offsets[problems]
    return Batch(
        batch.inputs[:rows],
        batch.targets[:rows],
        batch.known_noise_variance[:rows],
        batch.offsets[: problems + 1],
    )


def compare(batch: Batch, ours: BatchFit, theirs: Hyperparameters) -> dict[str, float]:
    """Compare the likelihood at a peer's hyperparameters with ours, on the problems it fitted."""
    value, _ = log_marginal_likelihood(batch, theirs)
    gain = ours.log_marginal_likelihood[: len(batch)] - value
    return {
        "equal": float(np.mean(np.abs(gain) <= EQUAL)),
        "ours_higher": float(np.mean(gain > EQUAL)),
        "ours_lower": float(np.mean(gain < -EQUAL)),
        "least_gain": float(gain.min()),
        "median_gain": float(np.median(gain)),
        "greatest_gain": float(gain.max()),
    }


def scikit_learn(batch: Batch, grid: FloatArray) -> tuple[Cost, Cost, Hyperparameters]:
    """Fit and predict one problem after the other; return both times and what was found."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    kernel = ConstantKernel(float(START.signal_variance), BOUNDS.signal_variance) * Matern(
        float(START.lengthscale), BOUNDS.lengthscale, nu=1.5
    ) + WhiteKernel(float(START.noise_variance), BOUNDS.noise_variance)
    problems = [
        (batch.inputs[a:b], batch.targets[a:b])
        for a, b in zip(batch.offsets[:-1], batch.offsets[1:], strict=True)
    ]
    fit_cost, models = timed(
        lambda: [GaussianProcessRegressor(kernel, alpha=0.0).fit(x, y) for x, y in problems]
    )
    posterior_cost, _ = timed(
        lambda: [model.predict(grid[:, None], return_std=True) for model in models]
    )
    theta = np.array([model.kernel_.theta for model in models])
    return fit_cost, posterior_cost, Hyperparameters.from_log(theta)


def botorch(batch: Batch, grid: FloatArray) -> tuple[Cost, Cost, Hyperparameters]:
    """Fit one batched SingleTaskGP by `fit_gpytorch_mll`; return both times and what was found.

    Constraints have no transform, so that L-BFGS-B gets the bounds themselves. The posterior is
    asked for a few queries at a time, since it makes their joint covariance.
    """
    import torch
    from botorch.fit import fit_gpytorch_mll
    from botorch.models import SingleTaskGP
    from gpytorch.constraints import Interval
    from gpytorch.kernels import MaternKernel, ScaleKernel
    from gpytorch.likelihoods import GaussianLikelihood
    from gpytorch.means import ZeroMean
    from gpytorch.mlls import ExactMarginalLogLikelihood

    count = len(batch)
    shape = torch.Size([count])

    def constraint(bounds: tuple[float, float], start: FloatArray) -> Any:
        return Interval(*bounds, transform=None, initial_value=float(start))

    def train() -> Any:
        likelihood = GaussianLikelihood(
            noise_constraint=constraint(BOUNDS.noise_variance, START.noise_variance),
            batch_shape=shape,
        )
        matern = MaternKernel(
            nu=1.5,
            batch_shape=shape,
            lengthscale_constraint=constraint(BOUNDS.lengthscale, START.lengthscale),
        )
        covariance = ScaleKernel(
            matern,
            batch_shape=shape,
            outputscale_constraint=constraint(BOUNDS.signal_variance, START.signal_variance),
        )
        model = SingleTaskGP(
            torch.from_numpy(batch.inputs.reshape(count, -1, 1)),
            torch.from_numpy(batch.targets.reshape(count, -1, 1)),
            likelihood=likelihood,
            covar_module=covariance,
            mean_module=ZeroMean(batch_shape=shape),
            outcome_transform=None,
        )
        fit_gpytorch_mll(ExactMarginalLogLikelihood(model.likelihood, model))
        return model

    def predict(model: Any) -> Any:
        queries = torch.from_numpy(grid)[:, None]
        with torch.no_grad():
            found = [
                model.posterior(queries[start : start + 20].expand(count, -1, 1))
                for start in range(0, len(queries), 20)
            ]
            return [(some.mean, some.variance) for some in found]

    fit_cost, model = timed(train)
    posterior_cost, _ = timed(lambda: predict(model))
    values = (
        model.covar_module.outputscale,
        model.covar_module.base_kernel.lengthscale,
        model.likelihood.noise,
    )
    return (
        fit_cost,
        posterior_cost,
        Hyperparameters(*(v.detach().numpy().reshape(-1) for v in values)),
    )


PEERS: dict[str, Callable[[Batch, FloatArray], tuple[Cost, Cost, Hyperparameters]]] = {
    "scikit-learn": scikit_learn,
    "BoTorch": botorch,
}


def measure(pairs: int, points: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Measure one size; print its block of the table."""
    batch = measured_pairs(pairs, points, np.random.default_rng(arguments.seed))
    grid = np.linspace(*BAND_RAD_S, arguments.grid)
    starts = BOUNDS.starts(START, arguments.starts - 1)
    one_cost, one = timed(lambda: fit(batch, [START], BOUNDS), arguments.repeats)
    all_cost, best = timed(lambda: fit(batch, starts, BOUNDS), arguments.repeats)
    warm_cost, _ = timed(lambda: fit(batch, [one.hyperparameters], BOUNDS), arguments.repeats)
    posterior_cost, _ = timed(
        lambda: posterior(batch, one.hyperparameters, grid), arguments.repeats
    )
    converged = float(np.mean(one.status == FitStatus.CONVERGED))
    print(f"\n{pairs} pairs × {points} points, posterior at {arguments.grid} frequencies")
    print(
        f"  nufleet, one start      fit {one_cost.wall_s:8.3f} s  "
        f"posterior {posterior_cost.wall_s:8.3f} s  "
        f"{1e6 * one_cost.processor_s / pairs:.0f} µs of processor and "
        f"{one.evaluations.mean():.1f} likelihoods each, {100 * converged:.2f} % converged"
    )
    print(f"  nufleet, {len(starts)} starts       fit {all_cost.wall_s:8.3f} s")
    print(f"  nufleet, at the optimum fit {warm_cost.wall_s:8.3f} s")
    row: dict[str, Any] = {
        "pairs": pairs,
        "points": points,
        "grid": arguments.grid,
        "nufleet": {
            "one_start": asdict(one_cost),
            "starts": len(starts),
            "all_starts": asdict(all_cost),
            "at_optimum": asdict(warm_cost),
            "posterior": asdict(posterior_cost),
            "converged": converged,
            "likelihoods_per_pair": float(one.evaluations.mean()),
        },
    }
    for name, limit in zip(PEERS, arguments.subset, strict=True):
        if name not in arguments.peers:
            continue
        some = part(batch, min(pairs, limit))
        scale = pairs / len(some)
        with threadpool_limits(arguments.peer_threads):
            costs = PEERS[name](some, grid)
        peer_fit, peer_posterior = costs[0].scaled(scale), costs[1].scaled(scale)
        how = "all measured" if scale == 1 else f"MEASURED ON {len(some)} PAIRS, × {scale:g}"
        print(
            f"  {name:<23} fit {peer_fit.wall_s:8.3f} s  posterior {peer_posterior.wall_s:8.3f} s  "
            f"({how})"
        )
        print(f"    fit / ours from one start {peer_fit.over(one_cost)}, ", end="")
        print(f"from {len(starts)} {peer_fit.over(all_cost)}, ", end="")
        print(f"posterior {peer_posterior.over(posterior_cost)}")
        row[name] = {
            "measured_on": len(some),
            "scaled_by": scale,
            "fit": asdict(peer_fit),
            "posterior": asdict(peer_posterior),
            "fit_over_one_start": peer_fit.wall_s / one_cost.wall_s,
            "fit_over_all_starts": peer_fit.wall_s / all_cost.wall_s,
        }
        for label, ours in (("one start", one), (f"{len(starts)} starts", best)):
            row[name][f"likelihood, {label}"] = optimum = compare(some, ours, costs[2])
            print(
                f"    log likelihood from {label:<9} less theirs: median "
                f"{optimum['median_gain']:.1e}, {optimum['least_gain']:.1e} to "
                f"{optimum['greatest_gain']:.1e}; equal {100 * optimum['equal']:.2f} %, "
                f"ours higher {100 * optimum['ours_higher']:.2f} %, "
                f"lower {100 * optimum['ours_lower']:.2f} %"
            )
    return row


def main() -> None:
    """Parse the command line, measure every size, print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--pairs", type=int, nargs="+", default=[100, 1000, 10000], help="N")
    parser.add_argument("--points", type=int, nargs="+", default=[5, 10, 20], help="M")
    parser.add_argument("--grid", type=int, default=1000, help="frequencies of the posterior")
    parser.add_argument(
        "--starts", type=int, default=3, help="starts of our second fit, apart in ℓ"
    )
    parser.add_argument("--repeats", type=int, default=3, help="of our timings; the best counts")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--peers", nargs="*", choices=list(PEERS), default=list(PEERS))
    parser.add_argument("--peer-threads", type=int, default=1)
    parser.add_argument(
        "--subset",
        type=int,
        nargs=2,
        default=[200, 10000],
        metavar=("SKLEARN", "BOTORCH"),
        help="largest number of problems to fit with a peer, whose times are then scaled",
    )
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    arguments = parser.parse_args()
    warm_up()
    if "BoTorch" in arguments.peers:
        import torch

        torch.set_num_threads(arguments.peer_threads)
    # The peers warn of parameters at their bounds and of inputs that are not in the unit cube.
    warnings.simplefilter("ignore")
    print(
        f"{os.cpu_count()} processors, on which {os.getloadavg()[0]:.1f} other processes run; "
        f"double precision, from σ_f² {START.signal_variance}, ℓ {START.lengthscale}, "
        f"σ_n² {START.noise_variance}; equal means within {EQUAL:g}"
    )
    rows = [measure(n, m, arguments) for n in arguments.pairs for m in arguments.points]
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
