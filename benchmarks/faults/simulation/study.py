"""A short study whose outcome is known, and the responses of the robots in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np

from nufleet.orchestrator.study.interface import Question, Report, Responses, SourceEstimate
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Finding, Quality

ROUNDS = 2
_OMEGA_RAD_S = (8.0, 12.0)


@cache
def response_of(robot: str) -> FrequencyResponse:
    """Return the response of a good test of a robot; |z| determines its place in the ranking."""
    return _response(robot, Quality())


@cache
def useless(robot: str) -> FrequencyResponse:
    """Return the response of a test whose sensor failed."""
    finding = Finding.model_construct(code="frozen", text="the sensor reads 0")
    return _response(robot, Quality.model_construct(reasons=(finding,), warnings=()))


def _response(robot: str, quality: Quality) -> FrequencyResponse:
    value = complex(1.0 + int(robot.removeprefix("r")) / 10.0)
    return FrequencyResponse(
        omega_rad_s=np.array([1.0]),
        z=np.array([value]),
        variance=np.array([1e-6]),
        segments=4,
        quality=quality,
    )


class RankingStudy:
    """Ranks robots by the sum of |z| over its rounds.

    The first robot is the target, the others are the sources; a source that fails is dropped from
    the following questions.
    """

    def __init__(self, robots: tuple[str, ...]) -> None:
        self._target, self._sources = robots[0], list(robots[1:])
        self._iteration = 0
        self.responses: Mapping[str, Sequence[FrequencyResponse]] = {}
        self.dropped: dict[str, str] = {}
        self._sums: dict[str, float] = dict.fromkeys(robots, 0.0)

    @property
    def ranking(self) -> tuple[str, ...]:
        """Names of the sources, best first."""
        return tuple(sorted(self._sources, key=lambda robot: (self._sums[robot], robot)))

    def ask(self) -> Question | None:
        if self._iteration == ROUNDS:
            return None
        omega = _OMEGA_RAD_S[self._iteration]
        self._iteration += 1
        test = Excitation(axis="x", tones=(Tone(omega_rad_s=omega),))
        return Question(self._iteration, dict.fromkeys((self._target, *self._sources), test))

    def tell(self, responses: Responses, failed: Mapping[str, str]) -> Report:
        if self._target in failed:
            raise StudyError(f"the target is gone: {failed[self._target]}")
        for robot, reason in failed.items():
            self._sources.remove(robot)
            self.dropped[robot] = reason
        if not self._sources:
            raise StudyError("no source is left")
        for robot, response in responses.items():
            self._sums[robot] += abs(complex(response.z[0]))
        ranking = tuple(SourceEstimate(r, self._sums[r], 0.0, 1.0, 1.0, 1) for r in self.ranking)
        return Report(self._iteration, (), responses, {}, (), ranking, dict(self.dropped))
