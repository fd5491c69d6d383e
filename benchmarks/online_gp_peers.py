"""The peers of the online process: one step of GPy, scikit-learn and BoTorch on two axes.

A step gets a window per axis and starting hyperparameters, maximises the marginal likelihood with
the peer's own stopping rule and predicts at one query. All have the kernel σ_f² Matérn 3/2, one ℓ
for all inputs, σ_n², no prior on them and the product's bounds.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple, Protocol

import numpy as np

from nufleet.robot_agent.flight.online_gp import BOUNDS, START
from nufleet.shared.arrays import FloatArray
from nufleet.shared.gaussian_process.problem import Hyperparameters


class Answer(NamedTuple):
    """θ (axes, 3), the mean at the query (axes,), and the likelihood as the peer reports it."""

    theta: FloatArray
    mean: FloatArray
    log_likelihood: FloatArray


class Peer(Protocol):
    """Fits one window per axis and predicts, keeping what it can between steps."""

    def __call__(
        self, inputs: FloatArray, targets: FloatArray, queries: FloatArray, start: FloatArray, /
    ) -> Answer:
        """Take (axes, n, d), (axes, n), (axes, d) and θ (axes, 3)."""


def one_by_one(
    step: Callable[[FloatArray, FloatArray, FloatArray, Hyperparameters], Any],
) -> Peer:
    """Turn a step of one axis, which returns θ, mean and likelihood, into a step of all axes."""

    def steps(
        inputs: FloatArray, targets: FloatArray, queries: FloatArray, start: FloatArray
    ) -> Answer:
        found = [
            step(x, y, q, Hyperparameters(*np.exp(theta)))
            for x, y, q, theta in zip(inputs, targets, queries, start, strict=True)
        ]
        return Answer(*(np.array(values) for values in zip(*found, strict=True)))

    return steps


def gpy(dimension: int, points: int) -> Peer:
    """GPy with the bounds given to its L-BFGS-B, over logarithms.

    GPy's own bounds are `gpy_logistic`. One model is kept and gets new data, which is faster than
    a new model for each window.
    """
    import GPy
    from paramz.optimization import Optimizer
    from paramz.transformations import Exponent
    from scipy.optimize import fmin_l_bfgs_b

    limits = list(zip(*BOUNDS.log(), strict=True))

    class BoundedLbfgs(Optimizer):  # type: ignore[misc]
        """paramz's `opt_lbfgsb`, which has no bounds, with bounds."""

        def opt(self, x_init: FloatArray, f_fp: Any = None, f: Any = None, fp: Any = None) -> None:
            self.x_opt, self.f_opt, how = fmin_l_bfgs_b(f_fp, x_init, bounds=limits, maxfun=1000)
            self.funct_eval, self.status = how["funcalls"], how["task"]

    kernel = GPy.kern.Matern32(dimension)
    model = GPy.models.GPRegression(
        np.zeros((points, dimension)), np.zeros((points, 1)), kernel, noise_var=0.1
    )
    for parameter in (model.kern.variance, model.kern.lengthscale, model.likelihood.variance):
        parameter.constrain(Exponent(), warning=False)

    def step(x: FloatArray, y: FloatArray, query: FloatArray, start: Hyperparameters) -> Any:
        model.set_XY(x, y[:, np.newaxis])
        model.optimizer_array = start.log(1)[0]
        model.optimize(optimizer=BoundedLbfgs())
        model.optimization_runs.clear()
        mean, _ = model.predict_noiseless(query[np.newaxis])
        return model.optimizer_array.copy(), mean[0, 0], model.log_likelihood()

    return one_by_one(step)


def gpy_logistic(dimension: int, points: int) -> Peer:
    """GPy as its manual has it, `constrain_bounded` and `optimize()`.

    Its bounds are a logistic transform, flat at the bounds: a search that starts there, as the
    paper's ℓ and σ_n² do with our bounds, hardly moves them.
    """
    import GPy

    kernel = GPy.kern.Matern32(dimension)
    model = GPy.models.GPRegression(
        np.zeros((points, dimension)), np.zeros((points, 1)), kernel, noise_var=0.1
    )
    parameters = (model.kern.variance, model.kern.lengthscale, model.likelihood.variance)
    limits = (BOUNDS.signal_variance, BOUNDS.lengthscale, BOUNDS.noise_variance)
    for parameter, (low, high) in zip(parameters, limits, strict=True):
        parameter.constrain_bounded(low, high, warning=False)

    def step(x: FloatArray, y: FloatArray, query: FloatArray, start: Hyperparameters) -> Any:
        model.set_XY(x, y[:, np.newaxis])
        model[:] = np.exp(start.log(1)[0])
        model.optimize()
        model.optimization_runs.clear()
        mean, _ = model.predict_noiseless(query[np.newaxis])
        return np.log(model.param_array), mean[0, 0], model.log_likelihood()

    return one_by_one(step)


def scikit_learn(dimension: int, points: int) -> Peer:  # noqa: ARG001
    """Build scikit-learn's regressor, its L-BFGS-B over logarithms."""
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    def step(x: FloatArray, y: FloatArray, query: FloatArray, start: Hyperparameters) -> Any:
        kernel = ConstantKernel(float(start.signal_variance), BOUNDS.signal_variance) * Matern(
            float(start.lengthscale), BOUNDS.lengthscale, nu=1.5
        ) + WhiteKernel(float(start.noise_variance), BOUNDS.noise_variance)
        model = GaussianProcessRegressor(kernel, alpha=0.0).fit(x, y)
        mean = model.predict(query[np.newaxis])
        return model.kernel_.theta, mean[0], model.log_marginal_likelihood_value_

    return one_by_one(step)


def botorch(dimension: int, points: int) -> Peer:  # noqa: ARG001
    """BoTorch's `fit_gpytorch_mll`, L-BFGS-B over the hyperparameters themselves.

    One model per axis: a batched model of both axes stops when their sum does, further from both
    maxima. Constraints have no transform, so that L-BFGS-B gets the bounds themselves.
    """
    import torch
    from botorch.fit import fit_gpytorch_mll
    from botorch.models import SingleTaskGP
    from gpytorch.constraints import Interval
    from gpytorch.kernels import MaternKernel, ScaleKernel
    from gpytorch.likelihoods import GaussianLikelihood
    from gpytorch.means import ZeroMean
    from gpytorch.mlls import ExactMarginalLogLikelihood

    def constraint(bounds: tuple[float, float], start: FloatArray) -> Any:
        inside = float(np.clip(start, *bounds))
        interval = Interval(*bounds, transform=None, initial_value=inside)
        # It rounds its bounds to single precision, which costs 1e-6 of likelihood at a bound.
        for side, bound in zip(("lower_bound", "upper_bound"), bounds, strict=True):
            setattr(interval, side, torch.tensor(bound, dtype=torch.float64))
        return interval

    def step(x: FloatArray, y: FloatArray, query: FloatArray, start: Hyperparameters) -> Any:
        likelihood = GaussianLikelihood(
            noise_constraint=constraint(BOUNDS.noise_variance, start.noise_variance)
        )
        matern = MaternKernel(
            nu=1.5, lengthscale_constraint=constraint(BOUNDS.lengthscale, start.lengthscale)
        )
        covariance = ScaleKernel(
            matern,
            outputscale_constraint=constraint(BOUNDS.signal_variance, start.signal_variance),
        )
        model = SingleTaskGP(
            torch.from_numpy(x),
            torch.from_numpy(y[:, np.newaxis]),
            likelihood=likelihood,
            covar_module=covariance,
            mean_module=ZeroMean(),
            outcome_transform=None,
        )
        objective = ExactMarginalLogLikelihood(model.likelihood, model)
        fit_gpytorch_mll(objective)
        with torch.no_grad():
            mean = model.posterior(torch.from_numpy(query[np.newaxis])).mean
            model.train()
            value = objective(model(*model.train_inputs), model.train_targets) * len(y)
        values = (covariance.outputscale, matern.lengthscale, likelihood.noise)
        theta = np.log([v.detach().numpy().item() for v in values])
        return theta, mean.numpy().item(), value.item()

    return one_by_one(step)


PEERS: dict[str, Callable[[int, int], Peer]] = {
    "GPy": gpy,
    "GPy-logistic": gpy_logistic,
    "scikit-learn": scikit_learn,
    "BoTorch": botorch,
}

MODULES = {
    "GPy": "GPy",
    "GPy-logistic": "GPy",
    "scikit-learn": "sklearn",
    "BoTorch": "botorch",
}
"""What has to be installed for each peer."""

PAPERS_START = START.log(1)[0]
"""θ where every search starts that is not warm."""
