"""The next round of tests: for each robot the one that is worth most per second."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.comparison import Compared, Draws
from nufleet.orchestrator.study.looks import Looks
from nufleet.orchestrator.study.selection_belief import SelectionBelief
from nufleet.orchestrator.study.tone_choice import ToneChoice
from nufleet.orchestrator.study.value_of_tests import (
    expected_errors,
    expected_gain,
    expected_narrowing,
)
from nufleet.shared.arrays import ComplexArray, FloatArray

GAIN_MIN = 1e-4
"""Value of a test that cannot be told from sampling noise."""

NO_ERROR = 1e-12

OWED = 0.9
"""Share of the price of a lowest look that does not count where a claim surely needs it."""

Value = Callable[[ComplexArray, FloatArray], float]
"""Value of a test, from samples of the response at its tones and the variances expected there: the
share of what is to be decreased by which the test is expected to decrease it."""


def settling(belief: SelectionBelief, leader: str, epsilon: float) -> Value:
    """Return the value of a test that is to settle which source is the best.

    What it is to decrease is the probability of a wrong selection.
    """
    n = belief.sources.index(leader)
    now = max(expected_errors(belief.loss, n, epsilon), NO_ERROR)
    return lambda z, variance: expected_gain(belief.loss, n, z, variance, epsilon) / now


def narrowing(belief: SelectionBelief, leader: str) -> Value:
    """Return the value of a test that is to narrow the interval of the selected source."""
    psi_star = belief.psi_star[belief.sources.index(leader)]
    now = max(float(np.std(psi_star)), NO_ERROR)
    return lambda z, variance: expected_narrowing(psi_star, z, variance) / now


@dataclass(frozen=True)
class NextRound:
    """Tests that are worth their time, and robots whose tests would be if they were there."""

    tests: Mapping[str, ToneChoice]
    """Test of each robot that is there."""
    missing: tuple[str, ...]
    """Absent robots, if what is stored limits the answer: a test of one of them would tell more per
    second than any of those, none of which is competitive with it."""


class NextTests:
    """Chooses the tests of later rounds."""

    def __init__(
        self,
        target: str,
        omega_rad_s: FloatArray,
        settings: AdaptiveSettings,
        robots: Mapping[str, AxesKnowledge],
        looks: Looks,
    ) -> None:
        """Remember what the tests of a study are chosen from.

        Args:
            target: Name of the target.
            omega_rad_s: Frequencies in rad/s at which samples of the belief exist, shape (grid,).
            settings: Stopping rule and choice of tests.
            robots: Knowledge of target and sources, by robot.
            looks: Tests that each robot may play.
        """
        self._target, self._grid = target, omega_rad_s
        self._settings, self._robots, self._looks = settings, robots, looks

    def choose(
        self,
        compared: Compared,
        leader: str,
        value: Value,
        *,
        hopeless: Collection[str],
        absent: Collection[str],
        told: bool = True,
    ) -> NextRound:
        """Return each robot's best test, if its value per second is competitive.

        Args:
            compared: Samples of all distances, and of the responses behind them.
            leader: Name of the source that is selected now.
            value: Value of a test.
            hopeless: Sources that cannot win.
            absent: Robots that cannot be tested.
            told: Whether the tests that were chosen before told what they were played for.
        """
        belief, draws = compared.belief, compared.draws
        chances = belief.probability_best()
        rivals = sorted(
            (s for s in belief.sources if s not in hopeless and s != leader),
            key=lambda s: -chances[belief.sources.index(s)],
        )[: self._settings.contenders]
        # The frequencies that decide the losses of the leader and two rivals.
        found = [belief.decisive_omega_rad_s(source) for source in (leader, *rivals[:2])]
        centres_rad_s = tuple(dict.fromkeys(found))
        contenders = (self._target, leader, *rivals)
        # A claim needs the lowest looks of the target and of the source that it names.
        needed = dict(zip(belief.sources, chances.tolist(), strict=True)) | {self._target: 1.0}
        # Where something is doubted that no test tells, tests that seem worth nothing are so, and
        # others may be worth less than they seem. Where robots are absent, the study can name them.
        doubted = any(self._robots[name].doubted for name in contenders)
        if doubted and not told:
            return NextRound({}, ())
        least = self._settings.worth if doubted or absent else 0.0
        least_away = self._settings.worth if doubted else GAIN_MIN
        there: dict[str, _Candidate] = {}
        away: dict[str, _Candidate] = {}
        for name in contenders:
            one = self._best_test(name, draws[name], centres_rad_s, value, needed[name])
            if one is not None and one.gain >= (least_away if name in absent else least):
                (away if name in absent else there)[name] = one
        enough, enough_away = self._enough(there), self._enough(away)
        tests = {name: one.choice for name, one in there.items() if one.rate >= enough}
        limited = all(one.rate < enough_away for one in there.values())
        missing = [name for name, one in away.items() if limited and one.rate >= enough_away]
        return NextRound(tests, tuple(missing))

    def _enough(self, candidates: Mapping[str, _Candidate]) -> float:
        """Return the value per second from which a test is competitive with the best of these."""
        most = max((one.rate for one in candidates.values()), default=0.0)
        return self._settings.together * most

    def _best_test(
        self,
        name: str,
        z: Draws,
        centres_rad_s: Sequence[float],
        value: Value,
        needed: float,
    ) -> _Candidate | None:
        robot = self._robots[name]
        each = self._settings.simulated_cost if robot.spec.simulated else 1.0
        due = self._looks.due([name]).get(name)
        found = []
        for choice in self._looks.candidates(name, centres_rad_s):
            gain = value(*self._looks.expected(name, choice, self._grid, z))
            price = each * (1.0 - OWED * needed) if choice == due else each
            # Gains below the floor cannot be told from sampling noise; the cheapest test then wins.
            rate = max(gain, GAIN_MIN) / (price * self._looks.duration_s(name, choice))
            found.append(_Candidate(rate, gain, choice))
        return max(found, key=lambda one: one.rate, default=None)


@dataclass(frozen=True)
class _Candidate:
    rate: float
    gain: float
    choice: ToneChoice
