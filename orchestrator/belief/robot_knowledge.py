"""Knowledge of one robot's response: its tests, a model of them, and their contradictions."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtri, fdtri

from nufleet.orchestrator.belief.amplitude_dependence import (
    AmplitudeDependence,
    change_in_words,
    differ,
)
from nufleet.orchestrator.belief.common_error import CommonError
from nufleet.orchestrator.belief.contradiction import Miss, miss_at_same_tones, miss_of
from nufleet.orchestrator.belief.distortion import ASSUMED_ANEW, Distortion
from nufleet.orchestrator.belief.loop_features import LOOP_PARAMETERS, ResponsePrior
from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.orchestrator.belief.noise_pooling import pooled_variance
from nufleet.orchestrator.belief.response_belief import ResponseModel
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.nonlinearity import nonlinearity_of
from nufleet.shared.frequency_test.quality import NO_RESPONSE_SIGNIFICANCE
from nufleet.shared.frequency_test.ring_down import DECAYS_UNTIL_SETTLED
from nufleet.shared.robots.spec import RobotSpec

SETTLING_RATIO_MAX = 1.2
"""Largest ratio of a measured settling time to the stated one that is not reported."""

INFORMATIVE_STD_MAX = 0.05
"""Largest standard deviation of a test's estimates at which agreement shows that the amplitude has
no effect."""

FLIGHT_TEST_STD = 0.02
"""Standard deviation that is expected of a test's estimates while the robot was never tested."""

RETRY = 0.5
HIDES = 0.08
UNLIKELY = 0.05
ELSEWHERE = 0.5
"""Measuring time of a test relative to that of its repetition at fewer tones; least standard
deviation of estimates with which noise hides a whole test; probability of an estimate of the noise
so low that it cannot have hidden one; and standard deviation of the response to a test which noise
did not hide, as a multiple of the response to its repetition."""

DEGREES_OF_A_VARIANCE = 2.0
"""A t distribution with d degrees of freedom has the variance d / (d − 2)."""

DOUBT_STAYS = 10.0
"""Factor by which a doubt that no test removes outweighs what a test of average noise tells."""

VARIANCE_MIN = 1e-10
"""Lower bound of a variance: no response is known better than to 1e-5, and smaller variances would
be lost to rounding."""


def tone_spacing(omega_rad_s: FloatArray) -> float:
    """Return the distance between neighbouring tones in rad/s, the median of all, at least two."""
    return float(np.median(np.diff(np.sort(omega_rad_s))))


class RobotKnowledge:
    """The knowledge of one robot that its tests have provided."""

    def __init__(self, robot: str, spec: RobotSpec, omega_max_rad_s: float) -> None:
        self.robot = robot
        self.spec = spec
        self.settling_time_s = spec.settling_time_s
        """Settling time in s: what the spec states or, if it is too short, what tests measured."""
        self._omega_max_rad_s = omega_max_rad_s
        self.responses: list[FrequencyResponse] = []
        self._found: tuple[str, ...] = ()
        self.flight_doubt = 0.0
        """Variance by which flights missed tests, or flights at other speeds, where they did."""
        self._test_doubt = 0.0
        """Variance by which tests missed each other, where only time differed between them."""
        self.delay_std_s = 0.0
        """Standard deviation in s of what the delay of one test differs from that of another."""
        self.compared = False
        """Whether the robot was tested at two amplitudes."""
        self.by_amplitude: AmplitudeDependence | None = None
        """What the amplitude does to its response, as its tests or those of others show."""
        self._tones: list[Tones] = []
        self._hidden: list[FloatArray] = []
        self._distortions: list[Distortion] = []
        self._assumed_distortion = 0.0
        """Distortion that other robots of its kind have shown."""
        self._noise: list[FloatArray] = []
        self._model: ResponseModel | None = None
        self.revision = 0
        """Number that changes with what is believed of the robot."""

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
            variance = pooled_variance(omega, response.noise_variance[known], degrees)
            self._noise.append(np.stack([omega, np.maximum(variance, VARIANCE_MIN) / len(omega)]))
        else:
            # A reference of no tones has its own spectrum, so no line in ln ω fits its variances.
            variance = response.variance[known] * degrees / (degrees - DEGREES_OF_A_VARIANCE)
        variance = np.maximum(variance, VARIANCE_MIN)
        self._note(response)
        new = Tones(omega, z, variance)
        distortion = Distortion.of(response, new)
        amplitude = self.amplitude
        compared = flight is None and differ(amplitude, response.amplitude)
        if compared and not self.compared:
            # What others have shown is no longer assumed, if the robot shows it itself.
            self.by_amplitude = None
            self._revise()
        # What a transient may have done must not explain what another amplitude did.
        before = self._expected(settled=compared) if check and not first else None
        earlier = self._doubted if compared else None
        self.responses.append(response)
        self._tones.append(new)
        self._hidden.append(response.variance[known] - response.noise_variance[known])
        self._distortions.append(distortion)
        self._revise()
        if before is None:
            return
        doubt = self._doubts[-1]
        miss = None if earlier is None else miss_at_same_tones(new, doubt, earlier)
        miss = miss or miss_of(new, doubt, before, self._expected(settled=compared), rng)
        if compared and (miss is not None or np.mean(variance + doubt) <= INFORMATIVE_STD_MAX**2):
            self.compared = True
        if miss is None:
            return
        self._revise()
        tests_only = all(one.flight is None for one in self.responses)
        if tests_only and self._timed_apart(miss):
            self.doubt_delays(self.spec.sample_time_s / math.sqrt(12))
        elif tests_only and compared:
            self._doubt_amplitudes(miss, amplitude or 0.0, response.amplitude or 0.0)
        else:
            self._doubt(self._changed(miss))

    def _note(self, response: FrequencyResponse) -> None:
        """Take note of what a test found besides its response."""
        for finding in response.quality.warnings:
            if finding.code == "nonlinear":
                self._find(finding.text)
            if finding.code == "ringing":
                self.expect_settling(finding.value or 0.0)

    def compare_to_asked(self, played_rad_s: FloatArray, asked_rad_s: FloatArray) -> None:
        """Doubt all tests if a repetition at fewer tones shows more than noise hid at all of them.

        A robot that answers to a few tones as a linear one with little noise, and to more of them
        as if all were noise, is driven into its limits by these. What it does in the motion that
        was asked for is then as good as unknown.

        Args:
            played_rad_s: Frequencies of the test that was learned last in rad/s, shape (tones,).
            asked_rad_s: Frequencies that it was asked for in rad/s, shape (asked,).
        """
        if len(played_rad_s) >= len(asked_rad_s):
            return
        noise = float(np.median(self.expected_variance(asked_rad_s, RETRY)))
        # It is estimated from few segments, and may well be larger.
        degrees = float(self.responses[-1].degrees_of_freedom.sum())
        if noise * degrees > HIDES**2 * chdtri(degrees, 1 - UNLIKELY):
            return
        self._find(
            f"it answers to {len(asked_rad_s)} tones at once as if most of it were noise, and not "
            f"to {len(played_rad_s)} of them: its actuators are at their limits, and its response "
            "to motions as large is not known; test smaller ones by --amplitude"
        )
        self._test_doubt += ELSEWHERE**2 * float(np.mean(np.abs(self._tones[-1].z) ** 2))
        self._revise()

    def expect_settling(self, settling_time_s: float) -> None:
        """Believe that the robot settles more slowly than was known.

        Args:
            settling_time_s: Time in s; one that is shorter than what is known says nothing.
        """
        if settling_time_s > self.settling_time_s:
            self.settling_time_s = settling_time_s
            self._revise()

    def doubt_flights(self, variance: float) -> None:
        """Make all flights less certain, as flights of another robot missed its tests.

        Args:
            variance: Variance E|ẑ − z|² to add, less what was added already.
        """
        more = variance - self.flight_doubt
        if more > 0 and any(response.flight is not None for response in self.responses):
            self._doubt(more)
            self._revise()

    def doubt_delays(self, std_s: float) -> None:
        """Believe that the delay differs from test to test.

        Args:
            std_s: Standard deviation in s; one that is less than what is known says nothing.
        """
        if std_s > self.delay_std_s:
            self.delay_std_s = std_s
            self._revise()

    def _timed_apart(self, miss: Miss) -> bool:
        """Return whether nothing but a delay of less than a sample distinguishes two tests."""
        delay_s, step_s = miss.delay_s, self.spec.sample_time_s
        if delay_s is None or abs(delay_s) > step_s:
            return False
        self._find(
            f"one of its tests answers {1e3 * abs(delay_s):.2g} ms later than another, and is like "
            "it otherwise: when a measurement is taken is not known to less than a sample of "
            f"{1e3 * step_s:.3g} ms, and neither is its delay"
        )
        return True

    def _doubt_amplitudes(self, miss: Miss, before: float, now: float) -> None:
        """Make the tests less certain by what amplitude does to the response, at each frequency.

        The response is that at the largest amplitude, so that a test is the less certain the
        further its own is from that; motions of another form are as those of another amplitude.
        """
        larger, smaller = miss.expected, miss.measured
        if now > before:
            larger, smaller = smaller, larger
        kind = nonlinearity_of(larger, smaller)
        unit = self.spec.axes[0].unit
        self._find(
            f"its response depends on the amplitude: at {now:.2g} {unit} it is "
            f"{miss.worst:.3g} away from that at {before:.2g} {unit}, at "
            f"{miss.worst_rad_s:.4g} rad/s" + (f", as with {kind}" if kind else "")
        )
        excess = np.maximum(miss.squared - miss.usual, float(np.mean(miss.squared)) / 4)
        self.by_amplitude = AmplitudeDependence.of(miss.omega_rad_s, excess, kind)

    def assume(self, by_amplitude: AmplitudeDependence | None, distortion: float) -> None:
        """Believe of a robot what others of its kind have shown, where its tests are silent.

        Args:
            by_amplitude: What the amplitude does to their responses; None if nothing.
            distortion: Distortion of their tests, as a ratio of the nonlinear to the linear part.
        """
        before = self._assumed_distortion
        if abs(distortion - before) > ASSUMED_ANEW * before:
            self._assumed_distortion = distortion
            self._revise()
        if self.compared or by_amplitude is self.by_amplitude:
            return
        if by_amplitude is None or not by_amplitude.equals(self.by_amplitude):
            self.by_amplitude = by_amplitude
            self._revise()

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
            self._tones = [
                Tones(t.omega_rad_s, t.z, t.variance + variance * of_flight)
                for t, of_flight in zip(self._tones, flown, strict=True)
            ]
        else:
            self._test_doubt += variance

    @property
    def findings(self) -> tuple[str, ...]:
        """What the tests showed that weakens what is believed of the robot, in words."""
        if not self.misstated:
            return self._found
        stated, found = self.spec.settling_time_s, self.settling_time_s
        misstated = (
            f"{self.robot}: the settling time is stated as {stated:.3g} s, and it was measured to "
            f"be {found:.3g} s: later tests wait as long; correct what the driver states"
        )
        return (misstated, *self._found)

    @property
    def misstated(self) -> bool:
        """Whether it settles more slowly than it states."""
        return self.settling_time_s > SETTLING_RATIO_MAX * self.spec.settling_time_s

    @property
    def prior(self) -> ResponsePrior:
        """The belief about the robot before its tests, but for its settling time."""
        decay_min_1_s = DECAYS_UNTIL_SETTLED / max(self.settling_time_s, 1e-3)
        return ResponsePrior(self._omega_max_rad_s, decay_min_1_s, self.misstated)

    @property
    def lowest_rad_s(self) -> float:
        """Lowest tested frequency in rad/s; infinite before the first test."""
        return min((float(t.omega_rad_s.min()) for t in self._tones), default=math.inf)

    def spacing_rad_s(self, band_rad_s: tuple[float, float]) -> float:
        """Return the least distance in rad/s between the tones of a test of a whole band.

        Such a test leaves out no more at the ends of the band than between two tones. Of several
        axes that share its tones, one may play none near an end.

        Args:
            band_rad_s: Lowest and highest frequency in rad/s.

        Returns:
            The distance, infinite before the first test.
        """
        low, high = band_rad_s
        least = math.inf
        for omega in (np.sort(t.omega_rad_s) for t in self._tones if len(t.z) > 1):
            gap = float(np.diff(omega).max())
            if omega[0] - gap <= low and omega[-1] + gap >= high:
                least = min(least, tone_spacing(omega))
        return least

    @property
    def amplitudes(self) -> tuple[float, ...]:
        """Amplitudes of the tests in the axis's unit, as far as they are known."""
        played = (one.amplitude for one in self.responses if one.flight is None)
        return tuple(one for one in played if one is not None)

    @property
    def amplitude(self) -> float | None:
        """Largest amplitude of the tests in the axis's unit; None where it is not known."""
        return max(self.amplitudes, default=None)

    @property
    def at_two_amplitudes(self) -> bool:
        """Whether tests were played at clearly different amplitudes."""
        return any(differ(one, self.amplitude) for one in self.amplitudes)

    @property
    def silent(self) -> bool:
        """Whether the robot was tested, and every test is certain that it does not respond.

        A small response that noise hides at each tone is still one if all tones together show it.
        """
        codes = [{finding.code for finding in one.quality.warnings} for one in self.responses]
        if not codes or any("no-response" not in c or "uncertain-at-some" in c for c in codes):
            return False
        z = np.concatenate([one.z for one in self._tones])
        variance = np.concatenate([one.variance for one in self._tones])
        variance = variance + np.concatenate(self._hidden)
        # The variances were estimated, too: the ratio is distributed as F.
        degrees = sum(float(one.degrees_of_freedom.sum()) for one in self.responses)
        most = fdtri(2 * len(z), degrees, 1 - NO_RESPONSE_SIGNIFICANCE)
        return float(np.mean(np.abs(z) ** 2 / variance)) <= float(most)

    def forget(self) -> None:
        """Forget all tests."""
        self.responses, self._tones, self._noise = [], [], []
        self._hidden, self._distortions = [], []
        self._revise()

    @property
    def tests(self) -> int:
        """Number of tests and flights of the robot."""
        return len(self.responses)

    @property
    def distortion(self) -> float:
        """Largest distortion of its tests, as a ratio of the nonlinear to the linear part."""
        return max((one.found for one in self._distortions), default=0.0)

    @property
    def doubted(self) -> bool:
        """Whether something makes its tests uncertain that further tests do not tell."""
        return any(doubt.any() for doubt in self._doubts)

    @property
    def _doubts(self) -> list[FloatArray]:
        """Variance of each test's estimates that is the same in all tests, however many there are.

        It is 0 for a flight, and has the shape (tones,).
        """
        played = zip(self._tones, self._distortions, self.responses, strict=True)
        return [self._doubt_of(*one) for one in played]

    def _doubt_of(
        self, tones: Tones, distortion: Distortion, response: FrequencyResponse
    ) -> FloatArray:
        if response.flight is not None:
            return np.zeros(len(tones.z))
        share = distortion.open_share(self._distortions, self._assumed_distortion)
        relative = share**2 + (tones.omega_rad_s * self.delay_std_s) ** 2
        doubt: FloatArray = self._test_doubt + relative * np.abs(tones.z) ** 2
        if self.by_amplitude is None:
            return doubt
        return doubt + self.by_amplitude.variance(
            tones.omega_rad_s, response.amplitude, self.amplitude
        )

    @property
    def flown_only(self) -> bool:
        """Whether all that is known of the robot comes from flights."""
        return bool(self.responses) and not self._noise

    @property
    def omega_rad_s(self) -> FloatArray:
        """All tested frequencies in rad/s, in the order of the tests, shape (tones,)."""
        return np.concatenate([tones.omega_rad_s for tones in self._tones])

    @property
    def tones(self) -> Tones:
        """Estimates of all tests and flights, with what is doubted of them in their variances, and
        what transients that their tones may hide add."""
        tones = self._doubted
        return Tones(tones.omega_rad_s, tones.z, tones.variance + np.concatenate(self._hidden))

    @property
    def _doubted(self) -> Tones:
        """The same without what hidden transients add."""
        doubted = zip(self._tones, self._doubts, strict=True)
        return Tones(
            self.omega_rad_s,
            np.concatenate([each.z for each in self._tones]),
            np.concatenate([each.variance + doubt for each, doubt in doubted]),
        )

    @property
    def model(self) -> ResponseModel:
        """The belief after all tests, of which there must be at least one."""
        if self._model is None:
            self._model = self._fitted(self.tones)
        return self._model

    def _fitted(self, tones: Tones) -> ResponseModel:
        # A doubt is the same in every test, so that their number must not average it away.
        played = zip(self._tones, self._doubts, self.responses, strict=True)
        common = CommonError.of_tests(
            [(t.omega_rad_s, doubt) for t, doubt, one in played if one.flight is None]
        )
        return ResponseModel(tones, self.prior, common=common)

    def _expected(self, *, settled: bool) -> ResponseModel:
        """Return the belief; if `settled`, as if no tone had hidden a transient."""
        hidden = any(one.any() for one in self._hidden)
        return self._fitted(self._doubted) if settled and hidden else self.model

    def forget_model(self) -> None:
        """Forget the fitted belief, which takes several megabytes, until it is asked for again."""
        self._model = None

    def _revise(self) -> None:
        self._model = None
        self.revision += 1

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

    def lasting_doubt(self, omega_rad_s: FloatArray) -> FloatArray:
        """Return the part of the variance that no further test reduces.

        Args:
            omega_rad_s: Frequencies of a test's tones in rad/s, shape (tones,).

        Returns:
            Variances to add to those that are expected of it, shape (tones,).
        """
        if not self.doubted:
            return np.zeros(len(omega_rad_s))
        nearest = np.argmin(np.abs(self.omega_rad_s - omega_rad_s[:, None]), axis=1)
        doubt = np.concatenate(self._doubts)[nearest]
        return np.asarray(DOUBT_STAYS * (1 + len(self._tones)) * doubt)

    def _changed(self, miss: Miss) -> float:
        """Return the variance to add to all tests if a new one contradicts the earlier ones."""
        flights = [one.flight for one in self.responses]
        unit = self.spec.axes[0].unit
        self._find(change_in_words(flights, unit, miss.worst, miss.worst_rad_s))
        if all(flight is None for flight in flights):
            return float(np.mean(miss.squared))
        return miss.excess

    def _find(self, text: str) -> None:
        finding = f"{self.robot}: {text}"
        if finding not in self._found:
            self._found = (*self._found, finding)
