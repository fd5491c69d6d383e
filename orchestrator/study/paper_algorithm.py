"""Algorithm 1 of Sorocky, Zhou and Schoellig (ICRA 2020): multi-source Bayesian optimisation.

One zero-mean Gaussian process with a Matérn 3/2 kernel models ψ_n(ω), the chordal distance of each
source n to the target. All robots are tested at the ω that maximises max_n EI_n(ω) / ψ̂*_n over the
band: where a source that looks close may still turn out to be far. Equation numbers in this module
are the paper's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from nufleet.orchestrator.study.interface import (
    Curve,
    Question,
    Report,
    Responses,
    SourceEstimate,
    StudyPlan,
)
from nufleet.shared.arrays import FloatArray
from nufleet.shared.distance.chordal import chordal_distance, chordal_variance
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.gaussian_process.exact import fit, posterior
from nufleet.shared.gaussian_process.problem import Batch, Bounds, Hyperparameters

GRID_POINTS = 1001

SEGMENTS = 4
SEGMENT_MIN_S = 2.0
"""Least length of a measuring segment in s, so that fast tones are averaged over many periods."""

DEVIATIONS = 1.96
"""Standard deviations on either side of a normal variable's mean that hold 95 % of it."""


@dataclass(frozen=True)
class PaperSettings:
    """Parameters whose values the paper does not give."""

    exploration: float = 1e-3
    """Exploration parameter ξ of the expected improvement (eq. 9)."""
    psi_floor: float = 1e-3
    """Lower bound of the divisor ψ̂*_n in the acquisition function (eq. 11).

    A posterior mean can reach or cross zero while there are few samples.
    """
    lengthscale_fractions: tuple[float, float] = (0.05, 1.0)
    """Bounds of the lengthscale, as fractions of the band's width.

    A longer lengthscale cannot be distinguished from a constant; a shorter one would require more
    tests than are practical.
    """
    signal_variance: tuple[float, float] = (1e-6, 10.0)
    """Bounds of the kernel's signal variance."""
    noise_variance: tuple[float, float] = (1e-10, 1e-6)
    """Bounds of the variance of ψ_n beyond the measured uncertainty of the responses."""


def slowest_test(plan: StudyPlan) -> Excitation:
    """Return the longest of the tests that a study may ask for: that of the lowest frequency."""
    return _test_at(plan.band_rad_s[0], plan)


def _test_at(omega_rad_s: float, plan: StudyPlan) -> Excitation:
    return Excitation(
        axis=plan.axis,
        tones=(Tone(omega_rad_s=omega_rad_s),),
        segments=SEGMENTS,
        segment_min_s=SEGMENT_MIN_S,
    )


class PaperStudy:
    """A study in progress that follows Algorithm 1."""

    def __init__(
        self, plan: StudyPlan, rng: np.random.Generator, settings: PaperSettings | None = None
    ) -> None:
        """Begin a study.

        Args:
            plan: Robots, band, axis and number of rounds.
            rng: Generator that draws the first frequency, uniformly over the band as in the
                initialisation of Algorithm 1; nothing else is random.
            settings: Parameters whose values the paper does not give; None takes the defaults.
        """
        self._plan = plan
        self._settings = settings or PaperSettings()
        low, high = plan.band_rad_s
        self._grid = np.linspace(low, high, GRID_POINTS)
        self._next_omega = float(rng.uniform(low, high))
        self._samples: dict[str, list[tuple[float, float, float]]] = {s: [] for s in plan.sources}
        self._responses: dict[str, list[FrequencyResponse]] = {}
        self._dropped: dict[str, str] = {}
        self._asked = 0
        self._open: Question | None = None

    @property
    def responses(self) -> dict[str, list[FrequencyResponse]]:
        """All responses measured in this study, by robot."""
        return self._responses

    def ask(self) -> Question | None:
        """Return the next round of tests; None when the study is complete."""
        if self._open is not None:
            return self._open
        if self._asked == self._plan.iterations:
            return None
        self._asked += 1
        test = _test_at(self._next_omega, self._plan)
        robots = (self._plan.target, *self._remaining())
        self._open = Question(self._asked, dict.fromkeys(robots, test))
        return self._open

    def tell(self, responses: Responses, failed: Mapping[str, str]) -> Report:
        """Learn from the answers to the last question; see `Study`."""
        question = self._open
        if question is None:
            raise ValueError("nothing was asked")
        if self._plan.target not in responses:
            reason = failed.get(self._plan.target, "it returned no response")
            raise StudyError(f"the target {self._plan.target} cannot be tested: {reason}")
        self._open = None
        for robot, response in responses.items():
            self._responses.setdefault(robot, []).append(response)
        for source in self._remaining():
            if source not in responses:
                self._dropped[source] = failed.get(source, "it returned no response")
        if not self._remaining():
            lost = "; ".join(f"{source}: {reason}" for source, reason in self._dropped.items())
            raise StudyError(f"no source is left: {lost}")
        sampled_psi = self._sample(question.omega_rad_s[0], responses)
        curves, improvements = self._believe()
        estimates = [_estimate(curve) for curve in curves]
        # α(ω) = max_n EI_n(ω) / ψ̂*_n (eq. 11), on the grid; the next test is at its maximum.
        psi_stars = np.maximum([estimate.psi for estimate in estimates], self._settings.psi_floor)
        acquisition = np.max(improvements / psi_stars[:, None], axis=0)
        self._next_omega = float(self._grid[int(np.argmax(acquisition))])
        return Report(
            iteration=question.iteration,
            omega_rad_s=question.omega_rad_s,
            responses=responses,
            known={name: tuple(measured) for name, measured in self._responses.items()},
            sampled_psi=sampled_psi,
            curves=curves,
            ranking=tuple(sorted(estimates, key=lambda estimate: estimate.psi)),
            dropped=dict(self._dropped),
        )

    def _remaining(self) -> tuple[str, ...]:
        return tuple(source for source in self._plan.sources if source not in self._dropped)

    def _sample(self, omega_rad_s: float, responses: Responses) -> dict[str, float]:
        """Keep and return each remaining source's ψ_n(ω) at the frequency of a round."""
        sources, target = self._remaining(), responses[self._plan.target]
        # All at once, since the calls of NumPy would take most of the time for one source.
        z = np.array([responses[source].z[0] for source in sources])
        variance = np.array([responses[source].variance[0] for source in sources])
        psi = dict(zip(sources, chordal_distance(target.z, z).tolist(), strict=True))
        variances = chordal_variance(target.z, target.variance, z, variance).tolist()
        for source, variance_of_psi in zip(sources, variances, strict=True):
            self._samples[source].append((omega_rad_s, psi[source], variance_of_psi))
        return psi

    def _believe(self) -> tuple[tuple[Curve, ...], FloatArray]:
        """Fit a Gaussian process to each remaining source's samples of ψ_n.

        Returns:
            The curve of each source, and EI_n on the grid, shape (sources, grid).
        """
        sources = self._remaining()
        samples = [np.array(self._samples[source]) for source in sources]
        batch = Batch.ragged(
            [s[:, 0] for s in samples], [s[:, 1] for s in samples], [s[:, 2] for s in samples]
        )
        width = float(self._grid[-1] - self._grid[0])
        shortest, longest = self._settings.lengthscale_fractions
        bounds = Bounds(
            signal_variance=self._settings.signal_variance,
            lengthscale=(shortest * width, longest * width),
            noise_variance=self._settings.noise_variance,
        )
        # The prior mean is zero, so E ψ² of the samples is the natural signal variance to start at.
        start = Hyperparameters(
            signal_variance=[max(float(np.mean(s[:, 1] ** 2)), 1e-6) for s in samples],
            lengthscale=0.2 * width,
            noise_variance=self._settings.noise_variance[0],
        )
        found = fit(batch, bounds.starts(start, 3), bounds)
        mean, variance = posterior(batch, found.hyperparameters, self._grid)
        # Rounding may leave a variance just below 0 at a sampled frequency.
        std = np.sqrt(np.maximum(variance, 0.0))
        low, high = (np.clip(mean + sign * DEVIATIONS * std, 0.0, 1.0) for sign in (-1.0, 1.0))
        curves = tuple(
            Curve(source, self._grid, mean[n], low[n], high[n], *samples[n][:, :2].T)
            for n, source in enumerate(sources)
        )
        best = np.array([s[:, 1].max() for s in samples])
        improvements = expected_improvement(mean, std, best[:, None], self._settings.exploration)
        return curves, improvements


def expected_improvement(
    mean: FloatArray, std: FloatArray, best: FloatArray | float, exploration: float
) -> FloatArray:
    """Return EI(ω) = (ψ̂ − ψ_max − ξ) Φ(Z) + σ̂ φ(Z), Z = (ψ̂ − ψ_max − ξ) / σ̂ (paper, eq. 9).

    Args:
        mean: Posterior mean ψ̂, shape (…, grid).
        std: Posterior standard deviation σ̂, the same shape.
        best: Largest sample ψ_max, one for all or shape (…, 1).
        exploration: Exploration parameter ξ ≥ 0.

    Returns:
        Expected improvement, shape (…, grid); never negative, and 0 where σ̂ is 0.
    """
    gain = mean - best - exploration
    certain = std <= 0.0
    z = gain / np.where(certain, 1.0, std)
    density = np.exp(-0.5 * z**2) / np.sqrt(2.0 * np.pi)
    improvement = gain * ndtr(z) + std * density
    # Far in the tail the two terms cancel, and leave a rounding error of either sign.
    return np.asarray(np.where(certain, 0.0, np.maximum(improvement, 0.0)))


def _estimate(curve: Curve) -> SourceEstimate:
    """Return ψ̂*_n = max ψ̂_n(ω) with its interval at its ω (eq. 10, Fig. 4)."""
    top, largest = int(np.argmax(curve.median)), int(np.argmax(curve.sampled_psi))
    return SourceEstimate(
        robot=curve.source,
        psi=float(curve.median[top]),
        psi_low=float(curve.low[top]),
        psi_high=float(curve.high[top]),
        omega_rad_s=float(curve.omega_rad_s[top]),
        tests=len(curve.sampled_psi),
        measured_psi=float(curve.sampled_psi[largest]),
        measured_omega_rad_s=float(curve.sampled_omega_rad_s[largest]),
    )
