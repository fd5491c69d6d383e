"""What is believed of a loop's error response after flights: a Gaussian, with its uncertainty.

The prior says that the impulse response of the error is smooth and decays, and that the loop rests
where its reference is. Its scales maximise the marginal likelihood (regularised system
identification: Pillonetto, Dinuzzo, Chen, De Nicolao and Ljung, Automatica 50, 2014). A single
multi-tone test then determines the response over its whole band; a flight of another kind simply
adds its rows.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import product

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.models.error_response import ErrorBasis
from nufleet.shared.models.evidence import Evidence

MODEL_ERROR = 0.03
"""Share of its error by which a loop is never better known than a linear response: friction,
saturation, and motions of another size."""

ALIKE_STD = 0.1
"""Standard deviation of the relative differences, in size and in time scale, between the error
responses of two axes of one robot."""

_DECAYS = (1.5, 3.0, 6.0, 12.0, 24.0)  # rates at which a response may decay, per settling time
_SMOOTH_S = (0.05, 0.1, 0.2, 0.4, 0.8)  # correlation times of its slope in s
_SCALES = tuple(product(_DECAYS, _SMOOTH_S))
_WIDE = ((3.0, 0.1),)  # those of a prior that restricts hardly any response
_SIZES = (0.03, 0.3, 3.0)  # scales of the prior's variance
_SIZES_ACROSS = (3e-4, 3e-3, 3e-2, 0.3)  # the same for what one axis adds to another
_REST = ((1e-3, 0.9), (3e-2, 0.1))  # standard deviations of g∞, and how probable each is
_TAIL = 1e-3  # largest share of its reference by which a settled loop may still move
_GRID = 300  # most points on which the prior is integrated
_NOISES = np.geomspace(1.0, 1e-12, 241)  # noise variances, as shares of the mean squared error
_SURE = 2.0  # standard deviations of the noise's mean square that may hide what is not linear
_JITTER = 1e-10
_ROUNDED = 10 * float(np.finfo(np.float64).eps)  # share of a sum of squares that is not known
_TINY = float(np.finfo(np.float64).tiny)
_FACTORS = 16  # of a product that does not overflow

_Prior = tuple[tuple[FloatArray, FloatArray], float, tuple[float, float]]
"""Mean and covariance, scale of the covariance, and standard deviation and probability of g∞."""


@dataclass(frozen=True, eq=False)
class ErrorBelief:
    """The belief about the error response of one axis: x ~ N(mean, factor factorᵀ)."""

    basis: ErrorBasis
    """Parameters x of the error response."""
    mean: FloatArray
    """Mean of x, shape (size,)."""
    factor: FloatArray
    """Factor of the covariance of x, shape (size, columns)."""
    noise_std: float
    """Standard deviation of the output that no linear response explains, in the axis's unit:
    measurement noise, and what is not linear."""
    flown_s: float
    """Duration in s of the flights of this axis that the belief rests on; 0 for one that is only
    believed to be like the robot's other axes."""
    model_error: float = MODEL_ERROR
    """Standard deviation of the relative size of what is not linear: `MODEL_ERROR`, or less where
    the noise of the motions could not have hidden as much."""
    bounded: float = 0.0
    """Share of the error that may not grow with the size of the motion; see `Evidence.bounded`."""
    largest: float = np.inf
    """Root mean square of the reference in the largest motion that the belief rests on, in the
    axis's unit; that of a larger one makes the bounded share of its error count."""
    lasting: float = 1.0
    """Correlation time, in samples, of what no linear response explains; see `Evidence.thinned`."""

    def open(self, size: float) -> float:
        """Return the share of the error by which a motion may leave less than a linear loop would.

        Args:
            size: Root mean square of the reference's deviations from its mean, in the axis's unit.
        """
        return self.bounded * (1 - min(1.0, self.largest / max(size, _TINY)))

    def error(self, reference: FloatArray, before: float) -> FloatArray:
        """Predict the error u − y along a reference, shape (samples,), without noise.

        Args:
            reference: Reference u, shape (samples,), in the axis's unit.
            before: Reference at which the robot rests before it.
        """
        blocks = self.basis.blocks(reference, before)
        return np.concatenate([columns @ self.mean for columns in blocks])

    def if_right(self) -> ErrorBelief:
        """Return the belief as if its mean were known to be right, and the loop to be linear."""
        return replace(self, factor=np.zeros_like(self.factor), model_error=0.0)

    def impulse_response(self) -> FloatArray:
        """Return the mean output 1, 2, … samples after a unit impulse of the reference.

        Returns:
            The impulse response, shape (samples of the loop's memory,), without unit.
        """
        last = int(self.basis.nodes[-1]) + 1
        steps = 1.0 - self.error(np.ones(last + 1), 0.0)
        return np.diff(steps)

    def draws(
        self,
        count: int,
        rng: np.random.Generator,
        size: float,
        *,
        flown: bool = True,
        alone: bool = False,
    ) -> FloatArray:
        """Draw parameters x from the belief, shape (size, count).

        Each draw is larger or smaller as a whole by what no linear response is better known than,
        and smaller where its error may not grow with the size of the motion.

        Args:
            count: Number of draws.
            rng: Generator of the draws.
            size: Root mean square of the deviations of the motion to foresee from its mean, in the
                axis's unit.
            flown: False for an axis that tests alone have moved. They show neither how axes act on
                each other nor what larger motions change, so it is not known how linear it is.
            alone: True for the only axis of its robot, on which no other can act. The share of its
                error that its tests may have hidden then grows with the square of its motion, as
                that of a cubic nonlinearity does.
        """
        normal = rng.standard_normal((self.factor.shape[1], count))
        error = np.full(count, self.model_error)
        if not flown and self.model_error > 0:
            hidden = self.model_error * max(1.0, size / max(self.largest, _TINY)) ** 2
            error = MODEL_ERROR * np.exp(rng.standard_normal(count))
            error = np.minimum(error, hidden) if alone else error
        scale = 1 + error * rng.standard_normal(count)
        less = self.open(size)
        if less > 0:
            scale *= 1 - less * (rng.permutation(count) + rng.random(count)) / count
        return np.asarray((self.mean[:, None] + self.factor @ normal) * scale)

    def response(self, omega_rad_s: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """Return the mean of the loop's response z(ω), and E|z − mean|².

        Args:
            omega_rad_s: Frequencies in rad/s, shape (frequencies,).
        """
        features = self.basis.response(omega_rad_s)
        variance = np.sum(np.abs(features @ self.factor) ** 2, axis=1)
        return np.asarray(1 - features @ self.mean), np.asarray(variance)

    def surprise(
        self, evidence: Evidence, model_error: float = MODEL_ERROR, noise_std: float = 0.0
    ) -> float:
        """Return the root mean square error of new flights, as a multiple of the one expected.

        It is near 1 for the robot that the belief was learned from, and larger for one that has
        changed, or is less linear than its motions have shown.

        Args:
            evidence: Evidence of the new flights.
            model_error: Standard deviation of the share of the error that is not linear.
            noise_std: Standard deviation of what no linear response could explain of the new
                flights, in the axis's unit, if it is known.
        """
        normal, right = _arrays(evidence)
        left = float(evidence.squares - 2 * self.mean @ right + self.mean @ normal @ self.mean)
        spread = float(np.sum(self.factor * (normal @ self.factor)))
        size = max(evidence.largest, float(np.sqrt(evidence.moved / evidence.rows)))
        foreseen = float(self.mean @ normal @ self.mean)
        expected = evidence.rows * max(self.noise_std, noise_std) ** 2 + spread
        expected += model_error**2 * evidence.squares + self.open(size) ** 2 * foreseen
        return float(np.sqrt(max(0.0, left) / max(expected, _TINY)))


@lru_cache(maxsize=8)
def believe(basis: ErrorBasis, evidence: Evidence) -> ErrorBelief:
    """Return the belief about an axis after its flights.

    The last few are kept: after every motion, what was believed before it is asked for again.

    Args:
        basis: Parameters of the error response.
        evidence: Evidence of all flights, on that basis.
    """
    return _likeliest(basis, evidence, product(_priors(basis, _SCALES), _SIZES, _REST))


def fitted(basis: ErrorBasis, evidence: Evidence) -> ErrorBelief:
    """Return the belief about an axis under a wide prior alone, in a tenth of the time.

    What it leaves of the motions, it leaves like the likeliest of all priors, apart from 2 %. How
    sure it is of the response says little, and what it foresees of other motions may be worse.

    Args:
        basis: Parameters of the error response.
        evidence: Evidence of the motions, on that basis.
    """
    widest = product(_priors(basis, _WIDE), _SIZES[-1:], _REST[-1:])
    return _likeliest(basis, evidence, widest)


def believe_across(basis: ErrorBasis, evidence: Evidence) -> ErrorBelief:
    """Return the belief about what one axis adds to the error of another.

    Args:
        basis: Parameters of its response.
        evidence: Evidence of all motions, with what the other axis's own response leaves as error.
    """
    found = _likeliest(basis, evidence, product(_nothing(basis, _SCALES), _SIZES_ACROSS, _REST))
    return replace(found, bounded=0.0)


def fitted_across(basis: ErrorBasis, evidence: Evidence) -> ErrorBelief:
    """Return the same under a wide prior alone, as `fitted` does."""
    widest = product(_nothing(basis, _WIDE), _SIZES_ACROSS[-1:], _REST[-1:])
    return replace(_likeliest(basis, evidence, widest), bounded=0.0)


def _nothing(
    basis: ErrorBasis, scales: tuple[tuple[float, float], ...]
) -> Iterable[tuple[FloatArray, FloatArray]]:
    """Return the priors of a response that begins at 0, and is as likely below 0 as above."""
    return ((np.zeros_like(mean), covariance) for mean, covariance in _priors(basis, scales))


def _likeliest(basis: ErrorBasis, evidence: Evidence, priors: Iterable[_Prior]) -> ErrorBelief:
    """Return the belief under that prior, and with that noise, that explain the evidence best."""
    normal, right = _arrays(evidence)
    found = list(priors)
    if not found:
        raise InvalidInputError("an axis without evidence")
    # The mean square of n samples of noise varies by √(2/n) of itself.
    hidden = min(1.0, _SURE * float(np.sqrt(2 / evidence.rows)))
    scale = max(evidence.squares / evidence.rows, _TINY)
    moved = max(evidence.moved / evidence.rows, _TINY)
    means = np.stack([mean for (mean, _), _, _ in found])
    prior = np.stack([size * covariance for (_, covariance), size, _ in found])
    rest_std, probability = np.array([rest for _, _, rest in found]).T
    prior[:, -1, -1] = rest_std**2
    prior += _JITTER * np.eye(len(right))
    factor = np.linalg.cholesky(prior)
    # In the coordinates w of x = mean + L Q w, with Q diagonal for LᵀAᵀA L, every direction
    # is a problem of its own, whose evidence is known in closed form for any noise.
    power, turn = np.linalg.eigh(np.swapaxes(factor, 1, 2) @ normal @ factor)
    power = np.maximum(power, 0.0)
    spread = factor @ turn
    of_means = means @ normal
    toward = np.einsum("pij,pi->pj", spread, right - of_means)
    of_mean = np.sum(of_means * means, axis=1)
    squares = evidence.squares - 2 * means @ right + of_mean
    # Sums of squares are rounded, which is all that a motion without noise leaves of them.
    noise = np.maximum(scale * _NOISES, _ROUNDED * np.maximum(power[:, -1], of_mean)[:, None])
    left = 1.0 + power[:, None] / noise[..., None]
    explained = ((1 / left) @ (toward**2)[..., None])[..., 0] / noise
    # The logarithm of a product takes less time than those of its factors, which are below 10¹⁵.
    products = np.multiply.reduceat(left, np.arange(0, len(right), _FACTORS), axis=2)
    cost = (
        evidence.rows * np.log(noise)
        + np.sum(np.log(products), axis=2)
        + (squares[:, None] - explained) / noise
        - 2 * np.log(probability)[:, None]
    )
    best, at = np.unravel_index(np.argmin(cost), cost.shape)
    noise_variance = float(noise[best, at])
    # What a loop does later than its settling time appears in no parameter. The noise hides it as
    # it hides what is not linear, and it moves the robot as an error at rest would.
    tail = np.zeros((len(right), 1))
    tail[-1] = min(_TAIL, float(np.sqrt(hidden * noise_variance / moved)))
    noise_std = float(np.sqrt(noise_variance))
    certain = np.sqrt(1 + power[best] / noise_variance)
    return ErrorBelief(
        basis,
        means[best] + spread[best] @ (toward[best] / (noise_variance * left[best, at])),
        np.concatenate([spread[best] / certain, tail], axis=1),
        noise_std,
        evidence.flown_s,
        min(MODEL_ERROR, float(np.sqrt(hidden * noise_variance / scale))),
        bounded=evidence.bounded(noise_std),
        largest=max(evidence.largest, float(np.sqrt(moved))),
        lasting=max(1.0, evidence.flown_s / (basis.sample_time_s * evidence.rows)),
    )


def like(beliefs: list[ErrorBelief]) -> ErrorBelief:
    """Return what is believed of an axis that was never flown, given other axes of its robot.

    It is like their mean, apart from a difference in size and one in time scale, each with a
    standard deviation of `ALIKE_STD`.

    Args:
        beliefs: Beliefs about the other axes, at least one, on the same basis.
    """
    basis, count = beliefs[0].basis, len(beliefs)
    mean = np.mean([belief.mean for belief in beliefs], axis=0)
    values, lags = mean[:-1], basis.nodes.astype(np.float64)
    # g(τ / (1 + s)) ≈ g(τ) − s τ g′(τ): a slower axis stretches the response.
    stretched = np.append(-lags * np.gradient(values, lags), 0.0)
    larger = np.append(values, mean[-1])
    larger[0] = 0.0  # an output measured before its reference acts never answers it
    differences = [belief.mean - mean for belief in beliefs] if count > 1 else []
    return ErrorBelief(
        basis,
        mean,
        np.concatenate(
            [
                *(belief.factor / count for belief in beliefs),
                *(difference[:, None] for difference in differences),
                ALIKE_STD * np.stack([larger, stretched], axis=1),
            ],
            axis=1,
        ),
        max(belief.noise_std for belief in beliefs),
        0.0,
        bounded=max(belief.bounded for belief in beliefs),
        largest=min(belief.largest for belief in beliefs),
        lasting=max(belief.lasting for belief in beliefs),
    )


def _arrays(evidence: Evidence) -> tuple[FloatArray, FloatArray]:
    right = np.array(evidence.right)
    return np.array(evidence.normal).reshape(len(right), len(right)), right


@lru_cache(maxsize=16)
def _priors(
    basis: ErrorBasis, scales: tuple[tuple[float, float], ...]
) -> tuple[tuple[FloatArray, FloatArray], ...]:
    """Return prior means and covariances, shapes (size,) and (size, size), for these scales.

    The impulse response h of the error has the covariance e^{−λ(τ + τ′)} M(τ − τ′), with a Matérn
    3/2 kernel M, and g(τ) = ∫_τ^∞ h. Conditioned on g(0) = 1, since an output that is measured
    before its reference acts has not answered it yet.
    """
    step_s, nodes = basis.sample_time_s, basis.nodes
    last_s = float(nodes[-1]) * step_s
    grid = np.linspace(0.0, last_s, min(_GRID, 4 * len(nodes) + int(nodes[-1])))
    apart = np.abs(grid[:, None] - grid)
    # From the far end, so that row i sums the impulse response from grid point i on.
    summed = np.triu(np.ones((len(grid), len(grid)))) * (grid[1] - grid[0])
    place = np.interp(nodes * step_s, grid, np.arange(len(grid)))
    below = np.minimum(place.astype(int), len(grid) - 2)
    interpolate = np.zeros((len(nodes), len(grid)))
    interpolate[np.arange(len(nodes)), below] = 1 - (place - below)
    interpolate[np.arange(len(nodes)), below + 1] += place - below
    priors = []
    for decay, smooth_s in scales:
        near = np.sqrt(3) * apart / smooth_s
        kernel = np.exp(-decay / last_s * (grid[:, None] + grid)) * (1 + near) * np.exp(-near)
        covariance = interpolate @ (summed @ kernel @ summed.T) @ interpolate.T
        mean = covariance[:, 0] / covariance[0, 0]
        rest = covariance / covariance[0, 0] - np.outer(mean, mean)
        whole = np.zeros((len(nodes) + 1,) * 2)
        whole[:-1, :-1] = rest
        priors.append((np.append(mean, 0.0), whole))
    return tuple(priors)
