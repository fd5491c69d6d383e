"""The default algorithm: multi-tone tests, one response model per robot, and a stopping rule.

The target, and every source without stored responses, is tested once, over the whole band. Further
tests, of all robots that are there, are chosen by how much they are expected to reduce the
probability of a wrong selection per second of robot time, and sources that can no longer win are
not tested again. The study is complete when the selected source is, with probability 1 − δ, within
ε of the closest (the stopping rule of Garivier and Kaufmann, COLT 2016, with ε as the difference
that does not matter). A source that is known from flights alone is tested before it is selected:
the response to a drawing need not be that to tones.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.belief.response_belief import ResponseModel
from nufleet.orchestrator.belief.resting_gain import draw_resting
from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.orchestrator.study.interface import (
    Curve,
    Question,
    Report,
    Responses,
    SourceEstimate,
    StudyPlan,
)
from nufleet.orchestrator.study.selection_belief import SelectionBelief
from nufleet.orchestrator.study.tone_choice import ToneChoice, closer_looks, first_look, lowest_look
from nufleet.orchestrator.study.trajectory_spectrum import Spectrum
from nufleet.orchestrator.study.value_of_tests import expected_gain
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.robots.spec import RobotSpec

REACHED = 1.25
"""Ratio of the lowest tone of a robot's tests to that of its lowest look from which it is due."""


@dataclass(frozen=True)
class AdaptiveSettings:
    """The stopping rule, and the tests that the algorithm may choose."""

    delta: float = 0.05
    """Accepted probability δ of a wrong selection."""
    epsilon: float = 0.01
    """Difference ε of two chordal distances, or relative errors, that does not matter."""
    first_periods: int = 11
    """Least length of the first test's measuring part, in periods of the band's upper end."""
    share_of_settling: float = 0.7
    """Least length of the first test's measuring part, as a share of the settling time."""
    lowest_octave: float = 2.0
    """Lowest tone that a claim rests on, as a multiple of the band's lower end."""
    lengths: tuple[float, ...] = (1.0, 1.7, 3.0)
    """Lengths of later tests, as multiples of the first test's measuring time."""
    window_tones: int = 5
    """Number of tones in a test around one frequency."""
    contenders: int = 4
    """Number of rivals, the most probable winners, that are considered for tests in a round."""
    together: float = 0.5
    """Share of the best gain per second that another robot's test needs to join the round."""
    simulated_cost: float = 0.01
    """Cost of a simulated robot's time, relative to that of a real one."""
    flight_error_max: float = 0.05
    """Error of flights, found by a test or between speeds, from which on no source is judged by
    flights alone."""
    samples: int = 600
    """Number of samples drawn from the belief about each robot's response."""
    grid_points: int = 256
    """Number of frequencies, evenly spaced over the band, at which distances are computed."""


class AdaptiveStudy:
    """A study in progress that follows the default algorithm."""

    def __init__(
        self,
        plan: StudyPlan,
        specs: Mapping[str, RobotSpec],
        rng: np.random.Generator,
        *,
        stored: Mapping[str, Sequence[FrequencyResponse]] | None = None,
        absent: Collection[str] = (),
        settings: AdaptiveSettings | None = None,
    ) -> None:
        """Begin a study.

        Args:
            plan: Robots, band, axis and motion; `iterations` is the largest number of rounds.
            specs: Specs of the target and of every source, by robot.
            rng: Generator that draws the samples of the belief.
            stored: Responses of earlier tests and flights, by robot; a source that has some needs
                no first test.
            absent: Sources that cannot be tested, all of which have stored responses.
            settings: Stopping rule and choice of tests; None takes the defaults.
        """
        self._plan = plan
        self._settings = settings or AdaptiveSettings()
        self._rng = rng
        low, high = plan.band_rad_s
        self._grid = np.linspace(low, high, self._settings.grid_points)
        self._spectrum = None if plan.motion is None else Spectrum.of_motion(plan.motion)
        self._drawn = self._grid
        if self._spectrum is not None:
            self._drawn = np.concatenate([self._grid, self._spectrum.omega_rad_s])
        self._robots = {
            name: RobotKnowledge(name, specs[name], high) for name in (plan.target, *plan.sources)
        }
        for name, known in (stored or {}).items():
            for response in known:
                self._robots[name].learn(response, rng)
        self._dropped: dict[str, str] = {}
        self._grounded = dict.fromkeys(absent, "it is not there")
        self._share_doubt()
        self._first: dict[str, ToneChoice] = {}
        self._low: dict[str, ToneChoice] = {}
        for name, robot in self._robots.items():
            settings = self._settings
            self._first[name] = first_look(
                plan.band_rad_s, robot.spec, settings.first_periods, settings.share_of_settling
            )
            self._low[name] = lowest_look(
                plan.band_rad_s, robot.spec, settings.lowest_octave * low, self._first[name]
            )
        self._next: dict[str, ToneChoice] = {
            name: self._first[name]
            for name in (plan.target, *plan.sources)
            if name == plan.target or not self._robots[name].tests
        }
        self._asked = 0
        self._open: Question | None = None

    @property
    def responses(self) -> dict[str, list[FrequencyResponse]]:
        """All known responses, by robot, of every robot that was ever tested."""
        return {name: robot.responses for name, robot in self._robots.items() if robot.tests}

    def ask(self) -> Question | None:
        """Return the next round of tests; None when the study is complete."""
        if self._open is not None:
            return self._open
        if not self._next:
            return None
        self._asked += 1
        tests = {
            name: choice.excitation(self._plan.axis, settle_s=self._robots[name].settle_s)
            for name, choice in self._next.items()
        }
        self._open = Question(self._asked, tests)
        return self._open

    def tell(self, responses: Responses, failed: Mapping[str, str]) -> Report:
        """Learn from the answers to the last question; see `Study`."""
        question = self._open
        if question is None:
            raise ValueError("nothing was asked")
        self._open = None
        for name in question.tests:
            if name in responses:
                self._robots[name].learn(responses[name], self._rng)
            else:
                self._lose(name, failed.get(name, "it returned no response"))
        self._share_doubt()
        self._lose_the_silent()
        sources = self._remaining()
        # Distances are compared over the band that is tested; a motion reaches far below it.
        draw = ResponseModel.draw if self._spectrum is None else draw_resting
        draws = {
            name: draw(self._robots[name].model, self._drawn, self._settings.samples, self._rng)
            for name in (self._plan.target, *sources)
        }
        target = draws[self._plan.target]
        belief = SelectionBelief.of(
            self._grid, target, {n: draws[n] for n in sources}, self._spectrum
        )
        leader, confidence = belief.leader(self._settings.epsilon, self._settings.delta)
        hopeless = belief.hopeless(leader, self._settings.delta)
        self._next, confidence, stopped = self._decide(belief, draws, leader, confidence, hopeless)
        if not self._next and stopped is None:
            stopped = f"no further test would help; P(correct selection) = {confidence:.3f}"
        return Report(
            iteration=question.iteration,
            omega_rad_s=question.omega_rad_s,
            responses=responses,
            sampled_psi=self._sampled(responses),
            curves=tuple(self._curve(n, source, belief) for n, source in enumerate(sources)),
            ranking=self._ranking(belief, leader),
            dropped=dict(self._dropped),
            confidence=confidence * self._share_measured,
            eliminated=hopeless,
            findings=self._findings(),
            stopped_because=None if stopped is None else stopped + self._unsettled(),
        )

    def _decide(
        self,
        belief: SelectionBelief,
        draws: Mapping[str, ComplexArray],
        leader: str,
        confidence: float,
        hopeless: Mapping[str, str],
    ) -> tuple[dict[str, ToneChoice], float, str | None]:
        """Return the next round, the confidence, and why the study ends where it does.

        What flights alone say, or tests that did not look at the lower end of the band, is claimed
        only once a test has confirmed it.
        """
        sure, doubtful = 1 - self._settings.delta, 1 - 2 * self._settings.delta
        rounds_left = self._asked < self._plan.iterations
        misled = self._misled_by_flights(belief.sources)
        if misled and rounds_left:
            return {name: self._first[name] for name in misled}, min(confidence, doubtful), None
        if self._flights_mislead and (confidence >= sure or not rounds_left):
            return (
                {},
                min(confidence, doubtful),
                (
                    f"{leader} is selected without a claim: flights and tests differ, so that the "
                    "responses of this fleet depend on the amplitude"
                ),
            )
        if confidence >= sure:
            if self._robots[leader].flown_only:
                if leader not in self._grounded and rounds_left:
                    return {leader: self._first[leader]}, doubtful, None
                return (
                    {},
                    doubtful,
                    (f"{leader} is known from flights alone, and no test could confirm them"),
                )
            looks = self._low_looks((self._plan.target, *belief.sources), hopeless)
            if looks and rounds_left:
                return looks, doubtful, None
            if looks:
                return (
                    {},
                    doubtful,
                    (
                        f"all {self._asked} rounds have been used, and none of them played the lower "
                        f"end of the band on {', '.join(looks)}"
                    ),
                )
            return {}, confidence, self._claim(belief, leader, confidence)
        if not rounds_left:
            return (
                {},
                confidence,
                (
                    f"all {self._asked} rounds have been used; P(correct selection) = {confidence:.3f}"
                ),
            )
        return self._choose(belief, draws, leader, hopeless), confidence, None

    def _low_looks(self, robots: Sequence[str], hopeless: Collection[str]) -> dict[str, ToneChoice]:
        """Return tests down to the lower end of the band, of those that were not tested there."""
        return {
            name: self._low[name]
            for name in robots
            if name not in hopeless
            and name not in self._grounded
            and self._robots[name].lowest_rad_s > REACHED * self._low[name].omega_rad_s[0]
        }

    def _lose_the_silent(self) -> None:
        """Drop the robots that respond to no tone, down to the lowest that they can be asked."""
        for name, robot in self._robots.items():
            lowest_rad_s = self._low[name].omega_rad_s[0]
            if robot.silent and robot.lowest_rad_s <= REACHED * lowest_rad_s:
                robot.forget()
                self._lose(
                    name,
                    f"it responds to no tone from {lowest_rad_s:.3g} rad/s on: it is not armed, or "
                    "its dead zone is larger than the amplitudes that it allows",
                )

    @property
    def _share_measured(self) -> float:
        """Probability that the best source is among the measured ones, which nothing tells apart
        from the others beforehand."""
        return len(self._remaining()) / len(self._plan.sources)

    def _unsettled(self) -> str:
        """Return in words what would settle which source is the best, where tests failed."""
        if not self._dropped:
            return ""
        named = "; ".join(f"{source} ({why})" for source, why in self._dropped.items())
        return f"; any source that was not measured may be closer, so test again: {named}"

    def _findings(self) -> tuple[str, ...]:
        found = [finding for robot in self._robots.values() for finding in robot.findings]
        for name in self._grounded:
            robot = self._robots[name]
            if robot.tests and robot.lowest_rad_s > REACHED * self._low[name].omega_rad_s[0]:
                found.append(
                    f"{name}: nothing is known of it below {robot.lowest_rad_s:.3g} rad/s, and "
                    "nothing is claimed there; test it again from the lower end of the band on"
                )
        return tuple(found)

    @property
    def _flights_mislead(self) -> bool:
        """Whether flights differ too much from tests, or each other, for anything to be claimed."""
        doubt = max(robot.flight_doubt for robot in self._robots.values())
        return doubt > self._settings.flight_error_max**2

    def _misled_by_flights(self, sources: Sequence[str]) -> tuple[str, ...]:
        """Return the sources to test because they rest on flights, which proved to be no tests."""
        if not self._flights_mislead:
            return ()
        known = [name for name in sources if self._robots[name].flown_only]
        return tuple(name for name in known if name not in self._grounded)

    def _share_doubt(self) -> None:
        """Make all flights as doubtful as those that missed a test, or flights at other speeds.

        Robots of one fleet are alike: where the flights of one are no tests, those of the others
        are not, either.
        """
        doubt = max(robot.flight_doubt for robot in self._robots.values())
        for robot in self._robots.values():
            robot.doubt_flights(doubt)

    def _remaining(self) -> tuple[str, ...]:
        return tuple(source for source in self._plan.sources if source not in self._dropped)

    def _lose(self, name: str, reason: str) -> None:
        """Drop a robot whose test failed; one with earlier tests stays in the ranking, untested."""
        if self._robots[name].tests:
            self._grounded[name] = reason
        elif name == self._plan.target:
            raise StudyError(f"the target {name} cannot be tested: {reason}")
        else:
            self._dropped[name] = reason
        if not self._remaining():
            lost = "; ".join(f"{source}: {why}" for source, why in self._dropped.items())
            raise StudyError(f"no source is left: {lost}")

    def _claim(self, belief: SelectionBelief, leader: str, confidence: float) -> str:
        best = "is the closest" if self._spectrum is None else "leaves the smallest error"
        alone = float(belief.probability_best()[belief.sources.index(leader)])
        if alone >= 1 - self._settings.delta:
            return f"{leader} {best} with probability {alone:.3f}"
        return (
            f"{leader} {best}, or within {self._settings.epsilon:g} of it, with probability "
            f"{confidence:.3f}"
        )

    def _choose(
        self,
        belief: SelectionBelief,
        draws: Mapping[str, ComplexArray],
        leader: str,
        hopeless: Mapping[str, str],
    ) -> dict[str, ToneChoice]:
        """Return the next round: each robot's best test, if its gain per second is competitive."""
        chances = belief.probability_best()
        rivals = sorted(
            (s for s in belief.sources if s not in hopeless and s != leader),
            key=lambda s: -chances[belief.sources.index(s)],
        )[: self._settings.contenders]
        centres = self._contested(belief, leader, rivals)
        rates: dict[str, float] = {}
        choices: dict[str, ToneChoice] = {}
        for name in (self._plan.target, leader, *rivals):
            if name in self._grounded:
                continue
            rate, choice = self._best_test(name, draws[name], belief, leader, centres)
            if choice is not None:
                rates[name], choices[name] = rate, choice
        best = max(rates.values(), default=0.0)
        enough = self._settings.together * best
        return {name: choice for name, choice in choices.items() if rates[name] >= enough}

    def _best_test(
        self,
        name: str,
        z: ComplexArray,
        belief: SelectionBelief,
        leader: str,
        centres_rad_s: Sequence[float],
    ) -> tuple[float, ToneChoice | None]:
        robot, first_s = self._robots[name], self._first[name].measure_s
        price = self._settings.simulated_cost if robot.spec.simulated else 1.0
        best: tuple[float, ToneChoice | None] = (0.0, None)
        looks = closer_looks(
            self._plan.band_rad_s,
            first_s,
            self._settings.lengths,
            centres_rad_s,
            self._settings.window_tones,
        )
        for choice in (*looks, self._low[name]):
            cost_s = choice.duration_s(robot.spec, robot.settle_s)
            if cost_s > robot.spec.duration_max_s:
                continue
            # Samples exist on the grid only, so each tone takes them from the next grid point.
            gain = expected_gain(
                belief.loss,
                belief.sources.index(leader),
                z[:, np.searchsorted(self._grid, choice.omega_rad_s).clip(0, len(self._grid) - 1)],
                robot.expected_variance(choice.omega_rad_s, choice.measure_s / first_s),
                self._settings.epsilon,
            )
            # Gains below the floor cannot be told from sampling noise; the cheapest test then wins.
            rate = max(gain, 1e-6) / (price * cost_s)
            if rate > best[0]:
                best = (rate, choice)
        return best

    def _contested(
        self, belief: SelectionBelief, leader: str, rivals: Sequence[str]
    ) -> tuple[float, ...]:
        """Return the frequencies (rad/s) that decide the losses of the leader and two rivals."""
        found = [belief.decisive_omega_rad_s(source) for source in (leader, *rivals[:2])]
        return tuple(dict.fromkeys(found))

    def _sampled(self, responses: Responses) -> dict[str, float]:
        """Return each source's largest measured ψ over the tones it shared with the target now."""
        at_target = responses.get(self._plan.target)
        found: dict[str, float] = {}
        for source in self._remaining():
            if at_target is None or source not in responses:
                continue
            at_source = responses[source]
            _, i, j = np.intersect1d(
                at_target.omega_rad_s, at_source.omega_rad_s, return_indices=True
            )
            if len(i):
                found[source] = float(np.max(chordal_distance(at_target.z[i], at_source.z[j])))
        return found

    def _curve(self, n: int, source: str, belief: SelectionBelief) -> Curve:
        psi = belief.psi[n]
        sampled = np.sort(self._robots[source].omega_rad_s)
        sampled = sampled[(sampled >= self._grid[0]) & (sampled <= self._grid[-1])]
        mean: FloatArray = psi.mean(axis=0)
        return Curve(
            source, self._grid, mean, psi.std(axis=0), sampled, np.interp(sampled, self._grid, mean)
        )

    def _ranking(self, belief: SelectionBelief, leader: str) -> tuple[SourceEstimate, ...]:
        """Return the estimates with the leader first and the others by rising typical loss."""
        estimates = []
        for n, source in enumerate(belief.sources):
            top = int(np.argmax(belief.psi[n].mean(axis=0)))
            estimate = SourceEstimate(
                robot=source,
                psi=float(belief.psi_star[n].mean()),
                psi_std=float(belief.psi_star[n].std()),
                omega_rad_s=float(self._grid[top]),
                tests=self._robots[source].tests,
            )
            estimates.append((source != leader, float(belief.typical_loss[n]), estimate))
        return tuple(estimate for _, _, estimate in sorted(estimates, key=lambda e: e[:2]))
