"""The default algorithm on several axes: tests that play them together, and the worst axis decides.

Every robot plays first tests of all axes, as `nufleet.orchestrator.study.axes_looks` says. Further
tests are those that are expected to reduce the probability of a wrong selection most per second of
robot time. The study is complete when, with probability 1 − δ, the selected source is within ε of
the one that is closest on its worst axis, ψ*_n = max over axes i and frequencies of ψ_n,i(ω), and
every robot that may decide it has been tested down to the lower end of the band on every axis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge
from nufleet.orchestrator.belief.response_belief import ResponseModel
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.axes_looks import AxesLooks
from nufleet.orchestrator.study.coupled_distance import coupled_belief, matrix_draws, matters
from nufleet.orchestrator.study.interface import (
    AxisEstimate,
    Question,
    Report,
    Responses,
    SourceEstimate,
    StudyPlan,
)
from nufleet.orchestrator.study.measured_distance import own_entries
from nufleet.orchestrator.study.next_tests import NextTests, settling
from nufleet.orchestrator.study.ranking import Known, curves_of, ranking_of, sampled_psi
from nufleet.orchestrator.study.selection_belief import SelectionBelief
from nufleet.orchestrator.study.tone_choice import ToneChoice
from nufleet.shared.arrays import ComplexArray
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.robots.spec import RobotSpec


class AxesStudy:
    """A study of several axes in progress."""

    def __init__(
        self,
        plan: StudyPlan,
        specs: Mapping[str, RobotSpec],
        rng: np.random.Generator,
        *,
        settings: AdaptiveSettings | None = None,
    ) -> None:
        """Begin a study.

        Args:
            plan: Robots, band and axes; `iterations` is the largest number of rounds.
            specs: Specs of the target and of every source, by robot.
            rng: Generator that draws the samples of the belief.
            settings: Stopping rule and choice of tests; None takes the defaults.

        Raises:
            InvalidInputError: A robot does not move for as long as a test of all axes takes.
        """
        self._plan, self._rng = plan, rng
        self._settings = settings or AdaptiveSettings()
        self._grid = np.linspace(*plan.band_rad_s, self._settings.grid_points)
        self._robots = {
            name: AxesKnowledge(name, specs[name], plan.band_rad_s[1], plan.axes)
            for name in (plan.target, *plan.sources)
        }
        self._looks = AxesLooks(plan, self._settings, self._robots)
        self._matrices: dict[str, tuple[ComplexArray, ComplexArray | None]] = {}
        self._distance = ""
        self._dropped: dict[str, str] = {}
        self._grounded: dict[str, str] = {}
        self._next_tests = NextTests(
            plan.target, self._grid, self._settings, self._robots, self._looks
        )
        self._draws: dict[str, tuple[tuple[ResponseModel, ...], ComplexArray]] = {}
        self._next: Mapping[str, ToneChoice] = self._looks.first
        self._purpose = "a first look at the whole band"
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
        tests = {name: self._looks.excitation(name, one) for name, one in self._next.items()}
        cost_s = sum(self._looks.duration_s(name, one) for name, one in self._next.items())
        self._open = Question(self._asked, tests, self._purpose, cost_s)
        return self._open

    def tell(self, responses: Responses, failed: Mapping[str, str]) -> Report:
        """Learn from the answers to the last question; see `Study`."""
        question = self._open
        if question is None:
            raise ValueError("nothing was asked")
        self._open = None
        for name, test in question.tests.items():
            if name in responses:
                self._robots[name].learn(test, responses[name], self._rng)
            else:
                self._lose(name, failed.get(name, "it returned no response"))
        self._lose_the_silent()
        sources = self._remaining()
        draws = {name: self._draw(name) for name in (self._plan.target, *sources)}
        by_axis = self._by_axis(draws, sources)
        belief = self._coupled(draws, sources) or _worst(by_axis)
        if len(belief.psi_star.T) < self._settings.samples:
            draws = {name: z[: len(belief.psi_star.T)] for name, z in draws.items()}
        leader, confidence = belief.leader(self._settings.epsilon, self._settings.delta)
        hopeless = belief.hopeless(leader, self._settings.delta)
        confidence = self._decide(belief, draws, leader, confidence, hopeless)
        known = self.responses
        measured = len(sources) / len(self._plan.sources)
        return Report(
            iteration=question.iteration,
            omega_rad_s=question.omega_rad_s,
            responses=responses,
            sampled_psi=sampled_psi(self._plan.target, sources, responses),
            curves=curves_of(belief, known),
            ranking=self._ranking(belief, by_axis, leader),
            dropped=dict(self._dropped),
            confidence=confidence * measured,
            eliminated=hopeless,
            findings=self._findings(),
            stopped_because=None if self._next else self._purpose,
        )

    def _by_axis(
        self, draws: Mapping[str, ComplexArray], sources: Sequence[str]
    ) -> dict[str, SelectionBelief]:
        """Return the belief about each axis that was tested on all robots, by axis."""
        beliefs: dict[str, SelectionBelief] = {}
        for axis in self._plan.axes:
            at: dict[str, ComplexArray] = {}
            for name, drawn in draws.items():
                tested = [a for a, known in self._robots[name].axes.items() if known.tests]
                if axis in tested:
                    start = tested.index(axis) * len(self._grid)
                    at[name] = drawn[:, start : start + len(self._grid)]
            if len(at) == len(draws):
                others = {name: at[name] for name in sources}
                beliefs[axis] = SelectionBelief.of(self._grid, at[self._plan.target], others)
        return beliefs

    def _coupled(
        self, draws: Mapping[str, ComplexArray], sources: Sequence[str]
    ) -> SelectionBelief | None:
        """Return the belief about the distances of the matrices, where axes alone do not suffice.

        It is None where no axis answers to another one, and where a robot has axes that never
        played together.
        """
        robots = {name: self._robots[name] for name in draws}
        self._distance = "no axis answers to another, so that each is compared by itself"
        if not matters(robots):
            return None
        matrices = {}
        for name, robot in robots.items():
            known = self._matrices.get(name)
            if known is None or known[0] is not draws[name]:
                z = matrix_draws(robot, draws[name], self._grid, self._rng)
                known = self._matrices[name] = draws[name], z
            if known[1] is None:
                self._distance = (
                    "axes answer to each other, and not all of them were tested together: what "
                    "one does to another is not compared"
                )
                return None
            matrices[name] = known[1]
        self._distance = (
            "axes answer to each other, so that distances are computed from the whole response "
            "matrices (their largest singular values)"
        )
        others = {name: matrices[name] for name in sources}
        return coupled_belief(self._grid, matrices[self._plan.target], others)

    def _draw(self, name: str) -> ComplexArray:
        """Return samples of a robot's responses, the same until something new is known of it.

        Returns:
            Samples on the grid, axis by axis as far as axes were tested, shape
            (samples, axes × grid).
        """
        models = self._robots[name].model
        before = self._draws.get(name)
        if before is None or len(before[0]) != len(models) or any(map(_differ, before[0], models)):
            count = self._settings.samples
            drawn = [model.draw(self._grid, count, self._rng) for model in models]
            before = self._draws[name] = models, np.concatenate(drawn, axis=1)
        return before[1]

    def _decide(
        self,
        belief: SelectionBelief,
        draws: Mapping[str, ComplexArray],
        leader: str,
        confidence: float,
        hopeless: Mapping[str, str],
    ) -> float:
        """Choose the next tests, or none and why not; return what is claimed."""
        sure, doubtful = 1 - self._settings.delta, 1 - 2 * self._settings.delta
        rounds_left = self._asked < self._plan.iterations
        used = f"all {self._asked} rounds have been used"
        self._next = {}
        alone = self._looks.unseen(name for name in self._robots if name not in self._dropped)
        if alone:
            names = " and ".join(
                dict.fromkeys(one.named(self._plan.axes) for one in alone.values())
            )
            self._next = alone if rounds_left else {}
            self._purpose = f"a first look at {names}, which may not move with the other axes"
            return min(confidence, doubtful)
        if confidence < sure:
            chance = f"P(correct selection) = {confidence:.3f}"
            self._purpose = f"{used}; {chance}"
            if rounds_left:
                value = settling(belief, leader, self._settings.epsilon)
                following = self._next_tests.choose(
                    belief, draws, leader, value, hopeless=hopeless, absent=self._grounded
                )
                self._next = following.tests
                stop = f"no further test would help; {chance}"
                self._purpose = "what is contested" if self._next else stop
            return confidence
        return self._looked(belief, leader, confidence)

    def _looked(self, belief: SelectionBelief, leader: str, confidence: float) -> float:
        """Ask for the lowest looks that a claim needs; return what is claimed.

        Target and leader need them on every axis, a rival only if what was seen of it leaves open
        that it is the best.
        """
        sure, doubtful = 1 - self._settings.delta, 1 - 2 * self._settings.delta
        low_rad_s = {name: robot.lowest_rad_s for name, robot in self._robots.items()}
        unseen = {s: low_rad_s[s] for s in belief.sources if not self._looks.reached(s)}
        surely, ahead = belief.beaten(leader, self._settings.epsilon, unseen)
        there = [n for n in (self._plan.target, leader) if n not in self._grounded]
        looks = self._looks.due(there)
        if not looks and surely < sure:
            share = self._settings.delta / len(belief.sources)
            open_still = [source for source, chance in ahead.items() if chance > share]
            looks = self._looks.due(name for name in open_still if name not in self._grounded)
        if looks:
            self._purpose = "the lower end of the band, on one axis after the other"
            if self._asked < self._plan.iterations:
                self._next = looks
            else:
                self._purpose = (
                    f"all {self._asked} rounds have been used, and the lower end of the band was "
                    f"not tested on all axes of {', '.join(looks)}"
                )
            return doubtful
        confidence = min(confidence, surely)
        if confidence < sure:
            self._purpose = (
                "the lower end of the band was not tested on all axes; P(correct selection) = "
                f"{confidence:.3f}"
            )
            return confidence
        self._purpose = (
            f"{leader} is the closest on its worst axis, or within {self._settings.epsilon:g} of "
            f"it, with probability {confidence:.3f}"
        )
        return confidence

    def _ranking(
        self, belief: SelectionBelief, by_axis: Mapping[str, SelectionBelief], leader: str
    ) -> tuple[SourceEstimate, ...]:
        """Return the estimates over all axes, each with those on every axis."""
        target, tests = self._plan.target, self.responses
        estimates = {}
        for axis, one in by_axis.items():
            known: Known = {
                name: [own[axis] for test in tests[name] if axis in (own := own_entries(test))]
                for name in (target, *one.sources)
            }
            estimates[axis] = {e.robot: e for e in ranking_of(one, target, leader, known)}
        ranking = []
        for together in ranking_of(belief, target, leader, tests):
            axes = {axis: one[together.robot] for axis, one in estimates.items()}
            furthest = max(axes.values(), key=lambda one: one.measured_psi or 0.0)
            ranking.append(
                replace(
                    together,
                    measured_psi=furthest.measured_psi,
                    measured_omega_rad_s=furthest.measured_omega_rad_s,
                    axes={
                        axis: AxisEstimate(one.psi, one.psi_low, one.psi_high, one.omega_rad_s)
                        for axis, one in axes.items()
                    },
                )
            )
        return tuple(ranking)

    def _findings(self) -> tuple[str, ...]:
        found = [finding for robot in self._robots.values() for finding in robot.findings]
        return (*found, self._distance, *self._looks.findings)

    def _remaining(self) -> tuple[str, ...]:
        return tuple(source for source in self._plan.sources if source not in self._dropped)

    def _lose_the_silent(self) -> None:
        """Drop robots with an axis that responds to no tone, down to the lowest of the band."""
        for name, robot in self._robots.items():
            if robot.silent and self._looks.reached(name):
                silent, lowest_rad_s = " and ".join(robot.silent), robot.lowest_rad_s
                robot.forget()
                self._lose(
                    name,
                    f"axis {silent} responds to no tone from {lowest_rad_s:.3g} rad/s on: it is "
                    "not armed, or its dead zone is larger than the amplitudes that it allows",
                )

    def _lose(self, name: str, reason: str) -> None:
        """Drop a robot whose test failed; one with tests of all axes stays, untested."""
        if not self._robots[name].unseen:
            self._grounded[name] = reason
        elif name == self._plan.target:
            raise StudyError(f"the target {name} cannot be tested: {reason}")
        else:
            self._dropped[name] = reason
        if not self._remaining():
            lost = "; ".join(f"{source}: {why}" for source, why in self._dropped.items())
            raise StudyError(f"no source is left: {lost}")


def _worst(by_axis: Mapping[str, SelectionBelief]) -> SelectionBelief:
    """Return the belief about the distance on the worst axis at every frequency."""
    one, *others = by_axis.values()
    psi, likeliest = one.psi, one.likeliest
    for other in others:
        psi = np.maximum(psi, other.psi)
        likeliest = np.maximum(likeliest, other.likeliest)
    return replace(one, psi=psi, psi_star=psi.max(axis=2), likeliest=likeliest)


def _differ(one: ResponseModel, other: ResponseModel) -> bool:
    return one is not other
