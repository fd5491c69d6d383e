"""The default algorithm: multi-tone tests, one response model per axis, and a stopping rule.

The target, and every source without stored responses, is tested once, over the whole band. Further
tests, of all robots that are there, are chosen by how much they are expected to reduce the
probability of a wrong selection per second of robot time, and sources that can no longer win are
not tested again. The study is complete when the selected source is, with probability 1 − δ, within
ε of the closest (the stopping rule of Garivier and Kaufmann, COLT 2016, with ε as the difference
that does not matter), and every source that may be the closest has played its lowest look, as
`nufleet.orchestrator.study.looks` says. A source that is known from flights alone is tested before
it is selected: the response to a drawing need not be that to tones. Of several axes the worst one
decides, as `nufleet.orchestrator.study.comparison` says.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from nufleet.orchestrator.belief.amplitude_dependence import differ
from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge
from nufleet.orchestrator.belief.shared_doubt import share_doubt
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.comparison import Compared, Comparison
from nufleet.orchestrator.study.interface import Question, Report, Responses, StudyPlan
from nufleet.orchestrator.study.looks import Looks
from nufleet.orchestrator.study.next_tests import NextTests, narrowing, settling
from nufleet.orchestrator.study.ranking import curves_of, ranking_of_axes, sampled_psi
from nufleet.orchestrator.study.selection_belief import SelectionBelief
from nufleet.orchestrator.study.tone_choice import ToneChoice
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.robots.spec import RobotSpec

NOT_THERE = "it is not there"
"""Why a source that a study began without cannot be tested."""


@dataclass(frozen=True)
class _Verdict:
    """What follows from a round: further tests, or the end."""

    confidence: float
    """Probability that the right one of the measured sources is selected."""
    tests: Mapping[str, ToneChoice] = field(default_factory=dict)
    """Tests of the next round, by robot."""
    why: str = ""
    """Reason for these tests or, where there are none, for the end."""


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
            plan: Robots, band, axes and motion; `iterations` is the largest number of rounds.
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
        self._robots = {
            name: AxesKnowledge(name, specs[name], plan.band_rad_s[1], plan.axes)
            for name in (plan.target, *plan.sources)
        }
        for name, known in (stored or {}).items():
            for response in known:
                self._robots[name].learn(response, rng)
        self._dropped: dict[str, str] = {}
        self._grounded = dict.fromkeys(absent, NOT_THERE)
        self._share_doubt()
        self._looks = Looks(plan, self._settings, self._robots)
        self._comparison = Comparison(plan, self._settings, self._robots, rng)
        grid = self._comparison.omega_rad_s
        self._next_tests = NextTests(plan.target, grid, self._settings, self._robots, self._looks)
        self._next: Mapping[str, ToneChoice] = {
            plan.target: self._looks.first[plan.target],
            **self._looks.unseen(plan.sources),
        }
        self._purpose = "a first look at the whole band"
        self._asked = 0
        # Probability of a wrong selection before the latest tests of what is contested.
        self._wrong_before = math.inf
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
        before_s = self._looks.asked_s
        tests = {name: self._looks.excitation(name, one) for name, one in self._next.items()}
        cost_s = self._looks.asked_s - before_s
        self._open = Question(self._asked, tests, self._purpose, cost_s)
        return self._open

    def tell(self, responses: Responses, failed: Mapping[str, str]) -> Report:
        """Learn from the answers to the last question; see `Study`."""
        question = self._open
        if question is None:
            raise ValueError("nothing was asked")
        self._open = None
        for name, asked in question.tests.items():
            if name in responses:
                self._robots[name].learn(responses[name], self._rng, asked=asked)
            else:
                self._lose(name, failed.get(name, "it returned no response"))
        self._share_doubt()
        self._lose_the_silent()
        sources = self._remaining()
        compared = self._comparison.of(sources)
        belief = compared.belief
        leader, confidence = belief.leader(self._settings.epsilon, self._settings.delta)
        hopeless = belief.hopeless(leader, self._settings.delta)
        verdict = self._first_alone(confidence)
        verdict = verdict or self._judge(compared, leader, confidence, hopeless)
        self._next, self._purpose = verdict.tests, verdict.why
        unlooked = {name: self._looks.unlooked(name) for name in (self._plan.target, *sources)}
        # Tests that follow may still look for it.
        open_above = () if verdict.tests else self._open_above(unlooked, belief.sources)
        tested = {
            name: [one for axis in robot.axes.values() for one in axis.responses]
            for name, robot in self._robots.items()
        }
        return Report(
            iteration=question.iteration,
            omega_rad_s=question.omega_rad_s,
            responses=responses,
            known={name: tuple(all_known) for name, all_known in self.responses.items()},
            sampled_psi=sampled_psi(self._plan.target, sources, responses),
            curves=curves_of(belief, tested),
            ranking=ranking_of_axes(compared, self._robots, self._plan.target, leader, unlooked),
            dropped=dict(self._dropped),
            confidence=verdict.confidence * self._share_measured,
            eliminated={**hopeless, **compared.outrun},
            findings=(
                *self._findings(leader),
                *open_above,
                *compared.findings,
                *self._looks.findings,
            ),
            stopped_because=None if verdict.tests else verdict.why + self._left_open(),
        )

    def _first_alone(self, confidence: float) -> _Verdict | None:
        """Ask for the first tests of axes that must be tested alone; None once all were tested."""
        alone = self._looks.unseen(name for name in self._robots if name not in self._dropped)
        if not alone:
            return None
        played = (axis for one in alone.values() for axis in one.axes)
        names = " and ".join(self._plan.axes[place] for place in dict.fromkeys(played))
        if self._asked < self._plan.iterations:
            why = f"a first look at {names} alone"
            return _Verdict(min(confidence, self._doubtful), alone, why)
        why = f"all {self._asked} rounds have been used, and {names} was not tested"
        return _Verdict(min(confidence, self._doubtful), why=why)

    def _judge(
        self, compared: Compared, leader: str, confidence: float, hopeless: Mapping[str, str]
    ) -> _Verdict:
        """Decide between further tests and the end.

        What flights alone say, or tests that did not reach the lower end of the band, is claimed
        only once a test has confirmed it.
        """
        belief, sure, doubtful = compared.belief, 1 - self._settings.delta, self._doubtful
        rounds_left = self._asked < self._plan.iterations
        misled = self._misled_by_flights(belief.sources)
        used = f"all {self._asked} rounds have been used"
        if misled and rounds_left:
            tests = {name: self._looks.first[name] for name in misled}
            return _Verdict(min(confidence, doubtful), tests, "flights differ from tests")
        if self._flights_mislead and (confidence >= sure or not rounds_left):
            return _Verdict(
                min(confidence, doubtful),
                why=f"{leader} is selected without a claim: flights and tests differ, so that the "
                "responses of this fleet depend on the amplitude",
            )
        if confidence < sure:
            chance = f"P(correct selection) = {confidence:.3f}"
            if not rounds_left:
                return _Verdict(
                    confidence, why=f"{used}; {chance}{self._time_left(belief, leader)}"
                )
            value = settling(belief, leader, self._settings.epsilon)
            told = 1 - confidence <= (1 - self._settings.worth) * self._wrong_before
            following = self._next_tests.choose(
                compared, leader, value, hopeless=hopeless, absent=self._grounded, told=told
            )
            if following.missing:
                why = f"{chance}; to settle it, test again: {self._named(following.missing)}"
                failed = any(self._grounded[name] != NOT_THERE for name in following.missing)
                more = self._time_left(belief, leader) if failed else ""
                return _Verdict(confidence, why=why + more)
            if following.tests:
                self._wrong_before = 1 - confidence
                return _Verdict(confidence, following.tests, "what is contested")
            contenders = [n for n in (self._plan.target, leader) if n not in self._grounded]
            if looks := self._looks.due(contenders):
                return _Verdict(confidence, looks, "what another amplitude does")
            return _Verdict(confidence, why=f"no further test would help; {chance}")
        if self._robots[leader].flown_only:
            if leader in self._grounded or not rounds_left:
                why = f"{leader} is known from flights alone, and no test could confirm them"
                return _Verdict(doubtful, why=why)
            return _Verdict(doubtful, {leader: self._looks.first[leader]}, "a test after flights")
        return self._looked(compared, leader, confidence, hopeless)

    def _looked(
        self, compared: Compared, leader: str, confidence: float, hopeless: Mapping[str, str]
    ) -> _Verdict:
        """Decide what a claim needs: lowest and finer looks, and a narrow interval of ψ*.

        Target and leader need them, a rival only if what was seen of it leaves open that it is the
        best.
        """
        belief, sure, doubtful = compared.belief, 1 - self._settings.delta, self._doubtful
        rounds_left = self._asked < self._plan.iterations
        seen = {name: seen for name in belief.sources if (seen := self._looks.seen(name))}
        surely, ahead = compared.beaten(leader, self._settings.epsilon, seen)
        share = self._settings.delta / len(belief.sources)
        rivals = [source for source, chance in ahead.items() if chance > share]
        contenders = [name for name in (self._plan.target, leader) if name not in self._grounded]
        there = [name for name in rivals if name not in self._grounded]
        looks = self._looks.due(contenders)
        if not looks and surely < sure and (looks := self._looks.due(there)):
            # What the contenders need anyway costs no round of its own.
            looks = {**self._looks.finer(contenders), **looks}
        unreached = [name for name in looks if self._unseen(name)]
        if unreached:
            lowest_rad_s = max(self._robots[name].lowest_rad_s for name in unreached)
            why = f"nothing is claimed unseen below {lowest_rad_s:.3g} rad/s"
            lacking = "the lower end of the band was not tested"
        elif looks:
            why, lacking = "what another amplitude does", "only one amplitude was tested"
        else:
            looks = self._looks.finer((*contenders, *there))
            why = "resonances as narrow as settling was found to be slow"
            lacking = "resonances as narrow as settling is slow were not looked for"
        if looks and rounds_left:
            return _Verdict(doubtful, looks, why)
        if looks:
            why = f"all {self._asked} rounds have been used, and {lacking} on "
            return _Verdict(doubtful, why=why + ", ".join(unreached or looks))
        confidence = min(confidence, surely)
        if confidence < sure:
            why = self._unseen_of(rivals)
            return _Verdict(confidence, why=f"{why}; P(correct selection) = {confidence:.3f}")
        claim = self._claim(belief, leader, confidence)
        low, _, high = belief.interval(leader)
        hidden = any(self._looks.unlooked(name) for name in (self._plan.target, leader))
        high = 1.0 if hidden else high
        wanted = self._plan.precision
        if wanted is None or high - low <= wanted:
            return _Verdict(confidence, why=claim)
        wide = f"ψ* of {leader} is known to {high - low:.2g}, and {wanted:g} is wanted"
        if not rounds_left or hidden:
            return _Verdict(confidence, why=f"{claim}; {wide}")
        value = narrowing(belief, leader)
        following = self._next_tests.choose(
            compared, leader, value, hopeless=hopeless, absent=self._grounded
        )
        if following.tests:
            return _Verdict(confidence, following.tests, wide)
        again = f"; to narrow it, test again: {self._named(following.missing)}"
        return _Verdict(confidence, why=f"{claim}; {wide}{again if following.missing else ''}")

    def _named(self, grounded: Sequence[str]) -> str:
        """Return robots that cannot be tested in words, with why where they were there."""
        reasons = {name: self._grounded[name] for name in grounded}
        return ", ".join(
            name if reason == NOT_THERE else f"{name} ({reason})"
            for name, reason in reasons.items()
        )

    def _time_left(self, belief: SelectionBelief, leader: str) -> str:
        """Return in words what more tests like those that were played would have to cost."""
        if any(robot.doubted for robot in self._robots.values()):
            return ""
        settings = self._settings
        times = belief.variance_to_settle(leader, settings.epsilon, settings.delta)
        more_s = (times - 1.0) * self._looks.asked_s
        if not math.isfinite(more_s):
            return "; more tests may well favour another source"
        text = "with as much noise, about {:.0f} robot-seconds more would settle it"
        return "; " + text.format(float(f"{more_s:.2g}"))

    @property
    def _doubtful(self) -> float:
        """Largest confidence that is stated without a claim."""
        return 1 - 2 * self._settings.delta

    def _unseen(self, name: str) -> bool:
        return not self._looks.reached(name)

    def _unseen_of(self, rivals: Sequence[str]) -> str:
        """Return in words what tests did not show of sources that may be as close as the leader."""
        below = [name for name in rivals if self._unseen(name)]
        between = [name for name in rivals if self._looks.coarse(name)]
        lacking = [
            f"{what} on {', '.join(names)}"
            for what, names in (
                ("the lower end of the band was not tested", below),
                ("resonances as narrow as settling is slow were not looked for", between),
            )
            if names
        ]
        return ", and ".join(lacking) or f"{', '.join(rivals) or 'others'} may be as close"

    def _open_above(
        self, unlooked: Mapping[str, Collection[str]], sources: Sequence[str]
    ) -> tuple[str, ...]:
        """Return in words which distances have no upper bound, since much was not looked for.

        Args:
            unlooked: Axes on which much of a robot is unseen, by robot.
            sources: Sources that were compared.
        """
        target = self._plan.target
        robots = [name for name in (target, *sources) if unlooked[name]]
        larger = sources if target in robots else robots
        if not robots:
            return ()
        finding = (
            f"the distance of {', '.join(larger)} may be larger: resonances as narrow as settling "
            f"was found to be slow were not looked for in the whole band on {', '.join(robots)}"
        )
        return (finding,)

    def _lose_the_silent(self) -> None:
        """Drop the robots that respond to no tone, down to the lowest that they can be asked."""
        for name, robot in self._robots.items():
            if robot.silent and self._looks.reached(name):
                lowest_rad_s = robot.lowest_rad_s
                it = "it" if len(robot.axes) == 1 else f"axis {' and '.join(robot.silent)}"
                robot.forget()
                self._lose(
                    name,
                    f"{it} responds to no tone from {lowest_rad_s:.3g} rad/s on: it is not armed, "
                    "its dead zone is larger than the amplitudes that it allows, or noise hides "
                    "what it does",
                )

    @property
    def _share_measured(self) -> float:
        """Probability that the best source was measured, if it may be any of them."""
        return len(self._remaining()) / len(self._plan.sources)

    def _left_open(self) -> str:
        """Return in words what would settle which source is the best, where tests failed."""
        if not self._dropped:
            return ""
        named = "; ".join(f"{source} ({why})" for source, why in self._dropped.items())
        return f"; a source that was not measured may be closer, so test again: {named}"

    def _findings(self, leader: str) -> tuple[str, ...]:
        shown = [finding for one in self._robots.values() for finding in one.findings]
        found = _together((*shown, *self._of_another_size(leader)))
        if leader in self._grounded and self._unseen(leader):
            found.append(
                f"{leader}: nothing is known of it below {self._robots[leader].lowest_rad_s:.3g} "
                "rad/s, and nothing is claimed there; test it again from the lower end of the band "
                "on"
            )
        looks = self._looks
        if looks.lowest_asked_s > self._settings.dear * looks.asked_s:
            lowest_rad_s = max(float(one.omega_rad_s[0]) for one in looks.first.values())
            found.append(
                f"the band's lower end took {looks.lowest_asked_s:.0f} of {looks.asked_s:.0f} "
                f"robot-seconds: --band {lowest_rad_s:.2g} {self._plan.band_rad_s[1]:g} would do "
                "without them"
            )
        return tuple(found)

    def _of_another_size(self, leader: str) -> Iterator[str]:
        """Yield in words of which robots that a claim is about no test was as large as the task, or
        as small."""
        task = self._plan.amplitude
        for name in (self._plan.target, leader):
            for known in self._robots[name].axes.values():
                if task is None or not known.amplitudes:
                    continue
                least, most = min(known.amplitudes), max(known.amplitudes)
                unit = known.spec.axes[0].unit
                moves = f"{known.robot}: the task moves by {task:.2g} {unit}, and tests by "
                if task > most and differ(task, most):
                    yield (
                        f"{moves}{most:.2g} {unit} at most: what only larger motions show is not "
                        "known; with a lower upper end of --band, tests may be larger"
                    )
                if task < least and differ(task, least):
                    yield (
                        f"{moves}{least:.2g} {unit} at least: what only smaller motions show, such "
                        "as friction, is not known; test again without --reuse"
                    )

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
        """Extend what is doubted of some robots on an axis to the others."""
        for axis in self._plan.axes:
            share_doubt([robot.axes[axis] for robot in self._robots.values()])

    def _remaining(self) -> tuple[str, ...]:
        return tuple(source for source in self._plan.sources if source not in self._dropped)

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

    def _claim(self, belief: SelectionBelief, leader: str, confidence: float) -> str:
        best = "leaves the smallest error"
        if self._plan.motion is None:
            best = f"is the closest{' on its worst axis' if self._plan.also else ''}"
        alone = float(belief.probability_best()[belief.sources.index(leader)])
        if alone >= 1 - self._settings.delta:
            return f"{leader} {best} with probability {alone:.3f}"
        return (
            f"{leader} {best}, or within {self._settings.epsilon:g} of it, with probability "
            f"{confidence:.3f}"
        )


def _together(findings: Iterable[str]) -> list[str]:
    """Return findings, of which those that say the same of several robots are one."""
    robots: dict[tuple[str, str], list[str]] = {}
    for finding in findings:
        whose, _, text = finding.partition(": ")
        robot, comma, axis = whose.partition(", ")
        robots.setdefault((comma + axis, text), []).append(robot)
    return [f"{', '.join(names)}{axis}: {text}" for (axis, text), names in robots.items()]
