"""Knowledge of one robot's response: its tests, a model of them, and their contradictions."""

from __future__ import annotations

import numpy as np
from scipy.special import chdtri

from nufleet.orchestrator.belief.loop_features import LOOP_PARAMETERS, ResponsePrior
from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.orchestrator.belief.noise_pooling import pooled_variance
from nufleet.orchestrator.belief.response_belief import ResponseModel
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.frequency_response import Flight, FrequencyResponse
from nufleet.shared.robots.spec import RobotSpec

DECAYS_UNTIL_SETTLED = 3.0
"""Least number of time constants of the slowest mode in a robot's declared settling time."""

NONLINEAR_DEVIATION = 0.02
"""Assumed relative change of a nonlinear robot's response at another amplitude."""

FLIGHT_TEST_STD = 0.02
"""Standard deviation that is expected of a test's estimates while the robot was never tested."""

DEGREES_OF_A_VARIANCE = 2.0
"""A t distribution with d degrees of freedom has the variance d / (d − 2)."""

CHANGE_SIGNIFICANCE = 1e-3
CHECK_SAMPLES = 400
VARIANCE_MIN = 1e-10
"""Lower bound of a variance: no response is known better than to 1e-5, and smaller variances would
be lost to rounding."""


class RobotKnowledge:
    """The knowledge of one robot that its tests have provided."""

    def __init__(self, robot: str, spec: RobotSpec, omega_max_rad_s: float) -> None:
        self.robot = robot
        self.spec = spec
        self.prior = ResponsePrior(
            omega_max_rad_s, DECAYS_UNTIL_SETTLED / max(spec.settling_time_s, 1e-3)
        )
        self.responses: list[FrequencyResponse] = []
        self.findings: tuple[str, ...] = ()
        self.flight_doubt = 0.0
        """Variance by which flights missed tests, or flights at other speeds, where they did."""
        self._tones: list[Tones] = []
        self._noise: list[FloatArray] = []
        self._model: ResponseModel | None = None

    def learn(
        self, response: FrequencyResponse, rng: np.random.Generator, *, check: bool = True
    ) -> None:
        """Learn a test's usable estimates; a contradiction to earlier tests becomes a finding.

        Args:
            response: Response that the test measured.
            rng: Generator that draws the responses expected from the earlier tests.
            check: Whether to look for contradictions, which takes as long as a fit of the model.

        Raises:
            InvalidInputError: The test has no usable estimate.
        """
        known = np.isfinite(response.z) & np.isfinite(response.variance)
        if not known.any():
            raise InvalidInputError(
                f"{self.robot}: a test of it holds no finite estimate: leave that test out, or "
                "repeat it"
            )
        first, flight = not self.responses, response.flight
        omega, z = response.omega_rad_s[known], response.z[known]
        degrees = response.degrees_of_freedom[known]
        if flight is None:
            variance = pooled_variance(omega, response.variance[known], degrees)
            self._noise.append(np.stack([omega, np.maximum(variance, VARIANCE_MIN) / len(omega)]))
        else:
            # A reference of no tones has its own spectrum, so no line in ln ω fits its variances.
            variance = response.variance[known] * degrees / (degrees - DEGREES_OF_A_VARIANCE)
        variance = np.maximum(variance, VARIANCE_MIN)
        for finding in response.quality.warnings:
            if finding.code == "nonlinear":
                self._find(finding.text)
                variance = variance + (NONLINEAR_DEVIATION * np.abs(z)) ** 2
        new = Tones(omega, z, variance)
        later = None if first or not check else self._modelled(new)
        doubt = 0.0 if later is None else self._contradiction(new, later, flight, rng)
        self.responses.append(response)
        self._tones.append(new)
        self._doubt(doubt)
        self._model = None if doubt else later

    def doubt_flights(self, variance: float) -> None:
        """Make all flights less certain, as flights of another robot missed its tests.

        Args:
            variance: Variance E|ẑ − z|² to add, less what was added already.
        """
        more = variance - self.flight_doubt
        if more > 0 and any(response.flight is not None for response in self.responses):
            self._doubt(more)
            self._model = None

    def _doubt(self, variance: float) -> None:
        """Add a variance to all flights or, where there are none, to all tests.

        It is not known which of several tests is right; but a flight that misses a test was another
        motion than the one that robots are compared by. Its many estimates are wrong together, so
        that their number must not average the doubt away: what is left for each of the loop's
        parameters is the doubt itself.
        """
        flown = [response.flight is not None for response in self.responses]
        if variance and any(flown):
            self.flight_doubt += variance
            estimates = sum(
                len(t.z) for t, of_flight in zip(self._tones, flown, strict=True) if of_flight
            )
            variance *= max(1.0, estimates / LOOP_PARAMETERS)
        doubted = flown if any(flown) else [True] * len(flown)
        self._tones = [
            Tones(t.omega_rad_s, t.z, t.variance + variance * at_stake)
            for t, at_stake in zip(self._tones, doubted, strict=True)
        ]

    @property
    def tests(self) -> int:
        """Number of tests and flights of the robot."""
        return len(self.responses)

    @property
    def flown_only(self) -> bool:
        """Whether all that is known of the robot comes from flights."""
        return bool(self.responses) and not self._noise

    @property
    def omega_rad_s(self) -> FloatArray:
        """All tested frequencies in rad/s, in the order of the tests, shape (tones,)."""
        return np.concatenate([tones.omega_rad_s for tones in self._tones])

    @property
    def model(self) -> ResponseModel:
        """The belief after all tests, of which there must be at least one."""
        if self._model is None:
            self._model = self._modelled()
        return self._model

    def _modelled(self, *more: Tones) -> ResponseModel:
        tones = (*self._tones, *more)
        return ResponseModel(
            Tones(
                np.concatenate([each.omega_rad_s for each in tones]),
                np.concatenate([each.z for each in tones]),
                np.concatenate([each.variance for each in tones]),
            ),
            self.prior,
        )

    def expected_variance(self, omega_rad_s: FloatArray, times_as_long: float) -> FloatArray:
        """Predict the variances of a test's estimates from the earlier tests.

        The tones of a test share its power, and their energy grows with time, so variances are
        proportional to the number of tones and inversely proportional to the measuring time.

        Args:
            omega_rad_s: Frequencies of the test's tones in rad/s, shape (tones,).
            times_as_long: Measuring time of the test, as a multiple of that of the first test.

        Returns:
            Predicted variances E|ẑ − z|², shape (tones,).
        """
        if not self._noise:
            return np.full(len(omega_rad_s), FLIGHT_TEST_STD**2 / times_as_long)
        omega, density = np.concatenate(self._noise, axis=1)
        nearest = np.argmin(np.abs(omega - omega_rad_s[:, None]), axis=1)
        return np.asarray(density[nearest] * len(omega_rad_s) / times_as_long)

    def _contradiction(
        self, new: Tones, later: ResponseModel, flight: Flight | None, rng: np.random.Generator
    ) -> float:
        """Return the variance to add to all tests if a new one contradicts the earlier ones.

        The test statistic is the squared distance of the new ẑ from what was expected, of which the
        belief with the new one as well says how large it is; its distribution is χ² with one degree
        of freedom for each real and imaginary part.
        """
        if self.model.distance(later) <= chdtri(2 * len(new.z), CHANGE_SIGNIFICANCE):
            return 0.0
        expected = self.model.draw(new.omega_rad_s, CHECK_SAMPLES, rng)
        excess = np.abs(new.z - expected.mean(axis=0)) ** 2
        usual = new.variance + np.var(expected, axis=0)
        worst = int(np.argmax(excess / usual))
        self._find(
            f"its response changed between {self._motions(flight)}, by "
            f"{np.sqrt(excess[worst]):.3g} at {new.omega_rad_s[worst]:.4g} rad/s: it depends on "
            "the amplitude or on time"
        )
        if flight is None and all(response.flight is None for response in self.responses):
            return float(np.mean(excess))
        # A flight's estimates differ in certainty; the uncertain ones say nothing about the change.
        return float(np.average(np.maximum(excess - usual, 0.0), weights=1 / usual))

    def _motions(self, flight: Flight | None) -> str:
        """Return in words what a new response and the earlier ones were measured in."""
        earlier = [one.flight for one in self.responses if one.flight is not None]
        if flight is None:
            return "its flights and its test" if earlier else "tests"
        if not earlier:
            return "its tests and a flight"
        unit = self.spec.axes[0].unit
        speeds = sorted({f"{one.speed:.2g}" for one in (*earlier, flight)})
        return f"flights at up to {' and '.join(speeds)} {unit}/s"

    def _find(self, text: str) -> None:
        finding = f"{self.robot}: {text}"
        if finding not in self.findings:
            self.findings = (*self.findings, finding)
