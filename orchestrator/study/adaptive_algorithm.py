"""The default algorithm: multi-tone tests, one response model per robot, and a stopping rule.

Every robot without stored responses is tested once, over the whole band. Further tests are chosen
by how much they are expected to reduce the probability of a wrong selection per second of robot
time, and sources that can no longer win are not tested again. The study is complete when the
selected source is, with probability 1 − δ, within ε of the closest (the stopping rule of Garivier
and Kaufmann, COLT 2016, with ε as the difference that does not matter).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
from nufleet.orchestrator.study.tone_choice import ToneChoice, closer_looks, first_look
from nufleet.orchestrator.study.trajectory_spectrum import Spectrum
from nufleet.orchestrator.study.value_of_tests import expected_gain
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.robots.spec import RobotSpec


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
        settings: AdaptiveSettings | None = None,
    ) -> None:
        """Begin a study.

        Args:
            plan: Robots, band, axis and motion; `iterations` is the largest number of rounds.
            specs: Specs of the target and of every source, by robot.
            rng: Generator that draws the samples of the belief.
            stored: Responses of earlier tests, by robot; a source that has some is not tested.
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
        self._stored = tuple(name for name, tests in (stored or {}).items() if tests)
        for name in self._stored:
            for response in (stored or {})[name]:
                self._robots[name].learn(response, rng)
        self._dropped: dict[str, str] = {}
        self._grounded: dict[str, str] = {}
        self._first: dict[str, ToneChoice] = {
            name: first_look(
                plan.band_rad_s,
                robot.spec,
                self._settings.first_periods,
                self._settings.share_of_settling,
            )
            for name, robot in self._robots.items()
        }
        self._next: dict[str, ToneChoice] = {
            name: self._first[name]
            for name in (plan.target, *plan.sources)
            if name == plan.target or name not in self._stored
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
        tests = {n: choice.excitation(self._plan.axis) for n, choice in self._next.items()}
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
        stopped = self._stop(belief, leader, confidence)
        self._next = {} if stopped else self._choose(belief, draws, leader, hopeless)
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
            confidence=confidence,
            eliminated=hopeless,
            findings=tuple(f for robot in self._robots.values() for f in robot.findings),
            stopped_because=stopped,
        )

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

    def _stop(self, belief: SelectionBelief, leader: str, confidence: float) -> str | None:
        if confidence >= 1 - self._settings.delta:
            best = "is the closest" if self._spectrum is None else "leaves the smallest error"
            alone = float(belief.probability_best()[belief.sources.index(leader)])
            if alone >= 1 - self._settings.delta:
                return f"{leader} {best} with probability {alone:.3f}"
            return (
                f"{leader} {best}, or within {self._settings.epsilon:g} of it, with probability "
                f"{confidence:.3f}"
            )
        if self._asked >= self._plan.iterations:
            return (
                f"all {self._asked} rounds have been used; P(correct selection) = {confidence:.3f}"
            )
        return None

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
            if name in self._grounded or name in self._stored:
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
        for choice in closer_looks(
            self._plan.band_rad_s,
            first_s,
            self._settings.lengths,
            centres_rad_s,
            self._settings.window_tones,
        ):
            cost_s = choice.duration_s(robot.spec)
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
