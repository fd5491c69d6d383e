"""What tests that still run have shown up to now: the responses from the samples that have arrived.

These are for the eye alone. A study estimates responses from whole tests, with their transients and
covariances (`shared.frequency_test`); here a least-squares fit of the tones must do, several times
a second.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from nufleet.orchestrator.viewer.events import LEADERS, Answers, TestSamplesEvent
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.excitation import Tone

RIDGE = 1e-3
"""Weight of the ridge that keeps the fit bounded while tones cannot be told apart yet, relative to
what the samples weigh. It shrinks the reference and the response alike, so that their ratio keeps
its size."""

STEPS_MAX = 12
"""Limit on the number of times that are looked at when many samples arrive at once."""

STEP_S = 0.25
"""Smallest interval between two such times."""

STEADY = 0.02
"""Largest difference of a reference from its tones at full size that counts as none, relative to
the sum of their sizes."""

PATIENCE = 8
"""Number of looks, of which there are four a second, that wait for a robot without new samples."""


class RunningTest:
    """The test that one robot plays: a least-squares fit of its tones that grows by samples."""

    def __init__(self, begin_s: float, tones: Sequence[Tone]) -> None:
        """Begin a test.

        Args:
            begin_s: Time of the first sample.
            tones: Tones of the test.
        """
        self.begin_s = begin_s
        tones = sorted(tones, key=lambda tone: tone.omega_rad_s)
        self.omega_rad_s = np.array([tone.omega_rad_s for tone in tones])
        gaps = np.diff(self.omega_rad_s, prepend=0.0, append=np.inf)
        self._apart_rad_s = np.minimum(gaps[:-1], gaps[1:])
        columns = 1 + 2 * len(self.omega_rad_s)
        weight, phase_rad = np.array([(tone.weight, tone.phase_rad) for tone in tones]).T
        self._shape = np.zeros(columns)
        self._shape[1::2], self._shape[2::2] = (
            weight * np.sin(phase_rad),
            weight * np.cos(phase_rad),
        )
        self._amplitude = 0.0
        self._gram = np.zeros((columns, columns))
        self._moments = np.zeros((columns, 2))
        self._waiting: list[TestSamplesEvent] = []
        self._fitted_s = self.end_s = begin_s

    def add(self, event: TestSamplesEvent) -> None:
        """Keep samples, which follow those before."""
        self._waiting.append(event)
        self.end_s = event.t_s + len(event.reference) * event.sample_time_s

    def responses(self, t_s: float) -> dict[float, complex]:
        """Return z(ω) as the samples before a time show it, by frequency in rad/s.

        Left out are tones that have not played a period yet, that have not come apart from their
        neighbours by a period, or that the reference hardly contains.
        Times must not fall from call to call.
        """
        begun = bisect_left(self._waiting, t_s, key=lambda event: event.t_s)
        if begun:
            self._fit(self._waiting[:begun], t_s)
            over = self._waiting[begun - 1]
            self._waiting = self._waiting[begun - (_end_s(over) > t_s) :]
        self._fitted_s = max(self._fitted_s, min(t_s, self.end_s))
        weight = np.trace(self._gram) / len(self._gram)
        if weight <= 0.0:
            return {}
        ridge = RIDGE * weight * np.eye(len(self._gram))
        fit = np.linalg.solve(self._gram + ridge, self._moments)
        phasors: ComplexArray = fit[1::2] - 1j * fit[2::2]
        size = np.abs(phasors[:, 0])
        apart = self._apart_rad_s * (self._fitted_s - self.begin_s) >= 2 * math.pi
        shown = apart & (size > 1e-3 * size.max(initial=0.0))
        z = phasors[shown, 1] / phasors[shown, 0]
        return dict(zip(self.omega_rad_s[shown].tolist(), z.tolist(), strict=True))

    def _fit(self, events: Sequence[TestSamplesEvent], until_s: float) -> None:
        """Count the samples of events, of which there may be thousands, in one step."""
        time_s = np.concatenate(
            [e.t_s + e.sample_time_s * np.arange(len(e.reference)) for e in events]
        )
        reference = np.concatenate([event.reference for event in events])
        response = np.concatenate([event.response for event in events])
        new = (time_s >= self._fitted_s - 1e-9) & (time_s < until_s - 1e-9)
        phase = (time_s[new, np.newaxis] - self.begin_s) * self.omega_rad_s
        waves: FloatArray = np.ones((len(phase), len(self._gram)))
        waves[:, 1::2], waves[:, 2::2] = np.cos(phase), np.sin(phase)
        signals = np.column_stack([reference[new], response[new]])
        # After its tones a reference falls to rest: no sum of tones, which would spoil the fit.
        played = waves @ self._shape
        if (size := float(played @ played)) > 0.0:
            self._amplitude = max(self._amplitude, float(signals[:, 0] @ played) / size)
        off = np.abs(signals[:, 0] - self._amplitude * played)
        steady = off <= STEADY * self._amplitude * np.abs(self._shape).sum()
        self._gram += waves[steady].T @ waves[steady]
        self._moments += waves[steady].T @ signals[steady]


class RunningTests:
    """The tests of a round in progress."""

    def __init__(self) -> None:
        self._tests: dict[str, RunningTest] = {}
        self._silent: dict[str, int] = {}
        self._target = ""
        self._leaders: tuple[str, ...] = ()
        self._looked_s = -math.inf

    def add(self, event: TestSamplesEvent) -> None:
        """Count samples; those that go back in time begin the robot's test again."""
        test = self._tests.get(event.robot)
        if test is None or event.t_s < test.end_s - event.sample_time_s / 2:
            test = self._tests[event.robot] = RunningTest(event.t_s, event.tones)
        test.add(event)
        self._target = event.target
        self._silent |= {robot: self._silent.get(robot, 0) for robot in event.robots}
        self._silent[event.robot] = 0

    def end(self, leaders: tuple[str, ...]) -> None:
        """End the round; `leaders` are the best sources now, best first."""
        self._tests.clear()
        self._silent.clear()
        self._leaders = leaders
        self._looked_s = -math.inf

    def look(self, *, last: bool = False) -> Iterator[Answers]:
        """Yield what the tests tell at times since the last look.

        Samples of simulated robots may come one robot after another, so that a look goes as far as
        all robots of the round have come.

        Args:
            last: Whether no more samples will come, so that no robot is waited for.
        """
        if not self._tests:
            return
        end_s = max(test.end_s for test in self._tests.values())
        if not last:
            waited_for = [robot for robot, looks in self._silent.items() if looks < PATIENCE]
            self._silent = {robot: looks + 1 for robot, looks in self._silent.items()}
            if not self._tests.keys() >= set(waited_for):
                return
            end_s = min((self._tests[robot].end_s for robot in waited_for), default=end_s)
        begin_s = max(self._looked_s, min(test.begin_s for test in self._tests.values()))
        if end_s <= begin_s:
            return
        self._looked_s = end_s
        steps = max(1, min(STEPS_MAX, int((end_s - begin_s) / STEP_S)))
        for t_s in np.linspace(begin_s, end_s, steps + 1)[1:].tolist():
            now = {robot: test.responses(t_s) for robot, test in self._tests.items()}
            answers = self._answers(t_s, now)
            if answers is not None:
                yield answers

    def _answers(self, t_s: float, z: dict[str, dict[float, complex]]) -> Answers | None:
        """Return the responses at the tones that the target plays, of the robots that play them."""
        common = z.get(self._target) or next(iter(z.values()))
        if not common:
            return None
        responses = {robot: tones for robot, tones in z.items() if common.keys() <= tones.keys()}
        leaders = tuple(robot for robot in self._leaders if robot in responses)
        answers = Answers(t_s, tuple(sorted(common)), responses, self._target, leaders)
        if leaders:
            return answers
        farthest = largest_psi(answers)
        return replace(
            answers, leaders=tuple(sorted(farthest, key=lambda robot: farthest[robot])[:LEADERS])
        )


def largest_psi(answers: Answers) -> dict[str, float]:
    """Return the largest chordal distance over the tones to the target, by source.

    It is 0 for all while the target's response is not known.
    """
    return {
        source: max(answers.psi(source).values(), default=0.0)
        for source in answers.responses
        if source != answers.target
    }


def _end_s(event: TestSamplesEvent) -> float:
    return event.t_s + len(event.reference) * event.sample_time_s
