"""The belief about one robot's response z(ω) over the band, from all its tests.

It is a mixture of Gaussians. Each component linearises a second-order loop with delay (and none,
one or two modes) about a maximum a posteriori fit, adds a causal residual of some size and memory,
and possibly one more narrow mode that the tones have neither shown nor excluded. The weights are
marginal likelihoods, so that the data choose the complexity, and a mode between the tones keeps a
probability in proportion to how well it fits the data unseen.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_triangular
from scipy.special import log_softmax, logsumexp

from nufleet.orchestrator.belief.common_error import CommonError
from nufleet.orchestrator.belief.loop_features import (
    LOOP_PARAMETERS,
    ResponsePrior,
    mode_columns,
    response,
    response_and_slope,
    tap_columns,
    tap_std,
)
from nufleet.orchestrator.belief.loop_fit import Tones, fit_from
from nufleet.shared.arrays import ComplexArray, FloatArray

STARTS_BANDWIDTH = (0.5, 0.86, 1.43, 2.4)
STARTS_DAMPING = (0.1, 0.7)
"""Bandwidths, as multiples of each that is expected, and damping ratios from which fits start."""

MODE_CANDIDATES = 4


@dataclass(frozen=True)
class ModelSettings:
    """The components of the mixture."""

    residual_sizes: tuple[float, ...] = (3e-4, 3e-3, 1e-2, 3e-2, 0.1)
    """Prior standard deviations of the residual."""
    residual_size_weights: tuple[float, ...] = (0.3, 0.3, 0.2, 0.15, 0.05)
    """Prior probability of each size."""
    residual_memories: tuple[float, ...] = (4.0, 16.0)
    """Memories of the residual, in units of 1/ω_max."""
    fit_floor: float = 2e-3
    """Standard deviation added to every measurement during the fit, since no loop is exactly of
    second order."""
    one_more_mode: float = 0.3
    """Prior probability of a mode beyond those fitted."""
    slow_mode: float = 0.8
    """That of the first mode, if something in the robot was measured to decay slowly: it may be
    the loop itself."""
    modes_max: int = 2
    """Largest number of fitted modes."""


@dataclass(frozen=True)
class _Expansion:
    """A fit with 0, 1 or 2 modes, about which components are linearised."""

    theta: FloatArray
    """Fitted parameters, shape (parameters,)."""
    mean: FloatArray
    """Prior mean of the parameters, shape (parameters,)."""
    std: FloatArray
    """Prior standard deviation of the parameters, shape (parameters,)."""
    log_prior: float
    """Logarithm of the prior probability of this number of modes."""


@dataclass(frozen=True)
class _Component:
    """All components with the same expansion and residual: without another mode, and with each.

    The whitened data are r = Φ w + X h + noise, with weights w of loop and residual, columns X of
    one more mode, its coefficients h, and w, h and the noise standard normal.
    """

    expansion: _Expansion
    tap_std: FloatArray
    factor: FloatArray  # Cholesky factor of A = I + ΦᵀΦ
    half: FloatArray  # L⁻¹ Φᵀ r
    cross: FloatArray  # L⁻¹ Φᵀ X of each mode: (size, 2 modes)
    mode_precision: FloatArray  # S: (modes, 2, 2)
    mode_mean: FloatArray  # S⁻¹ u: (modes, 2)
    misfit: FloatArray  # least ‖w‖² + ‖h‖² + ‖noise‖², (1 + modes,): first without another mode
    log_weights: FloatArray  # (1 + modes,), likewise


class ResponseModel:
    """The belief about one robot's response after its tests."""

    def __init__(
        self,
        tones: Tones,
        prior: ResponsePrior,
        settings: ModelSettings | None = None,
        common: CommonError | None = None,
    ) -> None:
        """Fit all components and compute their weights.

        Args:
            tones: All measurements of the robot, at least one.
            prior: Belief about the robot before its tests.
            settings: Components of the mixture; None takes the defaults.
            common: Error that all measurements share; None if their errors are independent.
        """
        self.tones = tones
        self._common = common
        self._settings = settings or ModelSettings()
        self._prior = prior
        self._grid_omega, self._grid_damping, self._grid_log_weight = prior.mode_grid()
        self._components: list[_Component] = []
        self._build()
        self.misfit = np.concatenate([c.misfit for c in self._components])
        """How much each component departs from its prior, and the measurements from it, squared."""
        # Posterior weights are proportional to prior × evidence.
        self._log_weights = log_softmax(np.concatenate([c.log_weights for c in self._components]))
        self._weights = np.exp(self._log_weights)

    @property
    def gain_std(self) -> float:
        """Prior standard deviation of the gain at rest, about 1."""
        return self._prior.gain_std

    def draw(self, omega_rad_s: FloatArray, count: int, rng: np.random.Generator) -> ComplexArray:
        """Draw samples of the response.

        Args:
            omega_rad_s: Frequencies in rad/s, shape (frequencies,).
            count: Number of samples.
            rng: Generator that draws them.

        Returns:
            Samples of z, in random order, shape (count, frequencies).
        """
        samples = self.draw_fitted(omega_rad_s, count, rng)
        if self._common is not None:
            samples = samples + self._common.draw(omega_rad_s, count, rng)
        return samples

    def draw_fitted(
        self, omega_rad_s: FloatArray, count: int, rng: np.random.Generator
    ) -> ComplexArray:
        """Draw samples of what the measurements say, without the error that all of them share.

        Args:
            omega_rad_s: Frequencies in rad/s, shape (frequencies,).
            count: Number of samples.
            rng: Generator that draws them.

        Returns:
            Samples of z, in random order, shape (count, frequencies).
        """
        chosen = np.sort(rng.choice(len(self._weights), size=count, p=self._weights))
        # A weight's flat index is index × per_component + 1 + mode, with mode −1 for no other mode.
        per_component = 1 + len(self._grid_omega)
        parts = []
        for index, component in enumerate(self._components):
            mine = chosen[
                (chosen >= index * per_component) & (chosen < (index + 1) * per_component)
            ]
            if len(mine):
                modes = mine - index * per_component - 1
                parts.append(self._draw_component(component, modes, omega_rad_s, rng))
        samples = np.concatenate(parts)
        return samples[rng.permutation(count)]

    def likeliest_fit(self, omega_rad_s: FloatArray) -> ComplexArray:
        """Return the most probable loop with its modes, without the residual.

        Args:
            omega_rad_s: Frequencies in rad/s, shape (frequencies,).
        """
        best = self._components[int(np.argmax(self._weights)) // (1 + len(self._grid_omega))]
        return response(best.expansion.theta, omega_rad_s)

    def distance(self, later: ResponseModel) -> float:
        """Return how far new measurements lie from what was expected of them, squared.

        It is how much more the model must depart from its prior, and its measurements from it, to
        explain the new ones as well. For a single Gaussian this is the squared Mahalanobis distance
        of the new measurements from their prediction. Unlike a prediction, it does not trust a fit
        to a few tones far away from them: the loop is fitted to all tones again.

        Args:
            later: The belief after the new measurements, with the same prior and settings.
        """
        more = np.maximum(later.misfit - self.misfit, 0.0)
        return float(-2 * logsumexp(self._log_weights - 0.5 * more))

    def _build(self) -> None:
        floored = Tones(
            self.tones.omega_rad_s, self.tones.z, self.tones.variance + self._settings.fit_floor**2
        )
        # Modes are added one at a time: the components about a fit say which further mode is the
        # most likely, and that mode starts the next fit.
        expansion = self._fit_loop(floored)
        for modes in range(self._settings.modes_max + 1):
            components = self._components_about(expansion)
            self._components += components
            if modes == self._settings.modes_max:
                break
            expansion = self._fit_mode(expansion, components, floored)

    def _fit_loop(self, floored: Tones) -> _Expansion:
        mean, std = self._prior.loop()
        # The posterior has several maxima in bandwidth and damping (parameters 2 and 3, both
        # logarithmic), so the fit starts from a grid of both.
        fast, slow = self._prior.bandwidths_rad_s
        # A loop much slower than its band is sought by its settling time, too.
        middles = (fast, slow) if slow < 0.5 * fast else (fast,)
        found = list(product(middles, STARTS_BANDWIDTH, STARTS_DAMPING))
        starts = np.tile(mean, (len(found), 1))
        for start, (middle, bandwidth, damping) in zip(starts, found, strict=True):
            start[2:4] = np.log(bandwidth * middle), np.log(damping)
        theta, cost = fit_from(starts, floored, mean, std)
        return _Expansion(theta[np.argmin(cost)], mean, std, 0.0)

    def _fit_mode(
        self, before: _Expansion, components: Sequence[_Component], floored: Tones
    ) -> _Expansion:
        """Add the most likely mode of the grid to an expansion, and refit all parameters."""
        best = max(components, key=lambda c: float(c.log_weights[1:].max()))
        ranked = np.argsort(best.log_weights[1:])[::-1][:MODE_CANDIDATES]
        starts, means, stds = [], [], []
        for mode in ranked:
            mean, std = self._prior.mode(self._grid_omega[mode], self._grid_damping[mode])
            start = mean.copy()
            # The coefficients h of a mode are standard normal, in units of its prior height.
            start[:2] = best.mode_mean[mode] * self._prior.mode_height_std
            starts.append(np.concatenate([before.theta, start]))
            means.append(np.concatenate([before.mean, mean]))
            stds.append(np.concatenate([before.std, std]))
        theta, cost = fit_from(np.array(starts), floored, np.array(means), np.array(stds))
        chosen = int(np.argmin(cost))
        log_prior = before.log_prior + np.log(self._one_more_mode(before))
        return _Expansion(theta[chosen], means[chosen], stds[chosen], log_prior)

    def _components_about(self, expansion: _Expansion) -> list[_Component]:
        tones, settings = self.tones, self._settings
        one_more = self._one_more_mode(expansion)
        z, slope = response_and_slope(expansion.theta, tones.omega_rad_s)
        # δ = θ − prior mean has mean 0, so the linearised z(δ = 0) is subtracted from the data.
        at_prior = z + slope @ (expansion.mean - expansion.theta)
        residual = tones.whiten(tones.z - at_prior)
        loop = tones.whiten((slope * expansion.std).T).T
        taps = tones.whiten(tap_columns(self._prior.omega_max_rad_s, tones.omega_rad_s).T).T
        modes = self._mode_columns(expansion, tones.omega_rad_s)
        extra = tones.whiten(np.moveaxis(modes, -1, 0)).transpose(2, 1, 0)
        extra = extra.reshape(len(residual), -1)  # (2 tones, 2 modes)
        gram = np.einsum("imc,imd->mcd", *[extra.reshape(len(residual), -1, 2)] * 2)
        toward = (residual @ extra).reshape(-1, 2)
        found = []
        for (size, weight), memory in product(
            zip(settings.residual_sizes, settings.residual_size_weights, strict=True),
            settings.residual_memories,
        ):
            memory_s = memory / self._prior.omega_max_rad_s
            deviations = tap_std(size, memory_s, self._prior.omega_max_rad_s)
            columns = np.concatenate([loop, taps * deviations], axis=1)
            factor = np.linalg.cholesky(np.eye(columns.shape[1]) + columns.T @ columns)
            half = solve_triangular(factor, columns.T @ residual, lower=True)
            # ln p(r) = ½ ‖L⁻¹Φᵀr‖² − ½ ‖r‖² − Σ ln L_ii + const, with A = I + ΦᵀΦ = LLᵀ.
            log_evidence = (
                expansion.log_prior
                + np.log(weight / len(settings.residual_memories))
                + 0.5 * (half @ half - residual @ residual)
                - np.sum(np.log(np.diag(factor)))
            )
            cross = solve_triangular(factor, columns.T @ extra, lower=True)
            by_mode = cross.reshape(len(half), -1, 2)
            # With w eliminated, h has the posterior precision S = I + XᵀX − XᵀΦ A⁻¹ ΦᵀX and the
            # mean S⁻¹u, u = Xᵀr − XᵀΦ A⁻¹ Φᵀr; S is 2 × 2 and inverted by hand for all modes.
            precision = np.eye(2) + gram - np.einsum("imc,imd->mcd", by_mode, by_mode)
            u = toward - (half @ cross).reshape(-1, 2)
            determinant = precision[:, 0, 0] * precision[:, 1, 1] - precision[:, 0, 1] ** 2
            mean = (
                np.stack(
                    [
                        precision[:, 1, 1] * u[:, 0] - precision[:, 0, 1] * u[:, 1],
                        precision[:, 0, 0] * u[:, 1] - precision[:, 0, 1] * u[:, 0],
                    ],
                    axis=1,
                )
                / determinant[:, None]
            )
            # One more mode multiplies the evidence by exp(½ uᵀS⁻¹u) / √det S.
            gain = 0.5 * np.sum(u * mean, axis=1) - 0.5 * np.log(determinant)
            with_mode = np.log(one_more) + self._grid_log_weight + gain
            log_weights = log_evidence + np.append(np.log1p(-one_more), with_mode)
            misfit = residual @ residual - half @ half - np.append(0.0, np.sum(u * mean, axis=1))
            found.append(
                _Component(
                    expansion, deviations, factor, half, cross, precision, mean, misfit, log_weights
                )
            )
        return found

    def _one_more_mode(self, expansion: _Expansion) -> float:
        """Return the prior probability of a mode beyond those of an expansion."""
        if self._prior.measured and len(expansion.theta) == LOOP_PARAMETERS:
            return self._settings.slow_mode
        return self._settings.one_more_mode

    def _mode_columns(self, expansion: _Expansion, omega_rad_s: FloatArray) -> ComplexArray:
        delay_s = float(expansion.theta[LOOP_PARAMETERS - 1])
        columns = mode_columns(self._grid_omega, self._grid_damping, delay_s, omega_rad_s)
        return self._prior.mode_height_std * columns

    def _draw_component(
        self,
        component: _Component,
        modes: NDArray[np.int64],
        omega_rad_s: FloatArray,
        rng: np.random.Generator,
    ) -> ComplexArray:
        expansion, count = component.expansion, len(modes)
        z, slope = response_and_slope(expansion.theta, omega_rad_s)
        at_prior = z + slope @ (expansion.mean - expansion.theta)
        taps = tap_columns(self._prior.omega_max_rad_s, omega_rad_s)
        columns = np.concatenate([slope * expansion.std, taps * component.tap_std], axis=1)
        with_mode = modes >= 0
        heights = np.zeros((count, 2))
        mine = modes[with_mode]
        # First h from N(S⁻¹u, S⁻¹), then w given h from N(A⁻¹Φᵀ(r − Xh), A⁻¹).
        spread = np.linalg.cholesky(np.linalg.inv(component.mode_precision[mine]))
        noise = rng.standard_normal((len(mine), 2, 1))
        heights[with_mode] = component.mode_mean[mine] + (spread @ noise)[..., 0]
        by_mode = component.cross.reshape(len(component.half), -1, 2)
        shifted = np.tile(component.half[:, None], count)
        shifted[:, with_mode] -= np.einsum("imc,mc->im", by_mode[:, mine], heights[with_mode])
        # w = L⁻ᵀ (L⁻¹Φᵀ(r − Xh) + ε) with ε standard normal has that mean and covariance, since
        # A⁻¹ = L⁻ᵀL⁻¹.
        shifted += rng.standard_normal(shifted.shape)
        weights = solve_triangular(component.factor, shifted, lower=True, trans="T")
        samples = at_prior + (columns @ weights).T
        if len(mine):
            kinds, which = np.unique(mine, return_inverse=True)
            shapes = self._prior.mode_height_std * mode_columns(
                self._grid_omega[kinds],
                self._grid_damping[kinds],
                float(expansion.theta[LOOP_PARAMETERS - 1]),
                omega_rad_s,
            )
            samples[with_mode] += np.einsum("mfc,mc->mf", shapes[which], heights[with_mode])
        return samples
