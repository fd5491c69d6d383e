"""Ways to select a source, all on the same fleets: Algorithm 1, sweeps, an oracle, the default."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from benchmarks.selection_fleets import Fleet
from benchmarks.selection_oracle import oracle_time_s
from nufleet.orchestrator.study.adaptive_algorithm import AdaptiveStudy
from nufleet.orchestrator.study.interface import Study, StudyPlan
from nufleet.orchestrator.study.paper_algorithm import SEGMENT_MIN_S, SEGMENTS, PaperStudy
from nufleet.orchestrator.study.tone_choice import ToneChoice
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.duration import duration_s, timing
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

PAPER_ITERATIONS = 12
ADAPTIVE_ROUNDS = 8
SWEEP_TONES = 9
RANDOM_TONES = 12
REPEATED = "repeated tests"
LONG_TEST_PERIODS = 55
"""Measuring time of the long test, in periods of the upper end of the band; it has 27 tones."""


@dataclass(frozen=True)
class Step:
    """The selection after a round, the method's confidence in it, and the robot-seconds used.

    `selected` is None when the study had to end because no test of the target was usable.
    """

    selected: str | None
    confidence: float | None
    robot_time_s: float


@dataclass
class Trace:
    """All rounds of one method on one fleet, and how it ended."""

    steps: list[Step] = field(default_factory=list)
    eliminated: int = 0
    stopped_because: str = ""
    held: list[bool] = field(default_factory=list)
    """Whether the interval of each source's ψ* holds it, after the last round."""
    computing_s: list[float] = field(default_factory=list)
    """Processor time that the method took to learn from each round, in s."""
    spent_s: Counter[str] = field(default_factory=Counter)
    """Robot-seconds by what they were spent on: the purpose of a round, or tests repeated as they
    were not usable."""
    waited_s: float = 0.0
    """The part of them, repeated tests left out, in which robots ramped or settled."""


def paper(fleet: Fleet, rng: np.random.Generator) -> Trace:
    """Algorithm 1 as printed."""
    return follow(PaperStudy(_plan(fleet, PAPER_ITERATIONS), rng), fleet)


def default(fleet: Fleet, rng: np.random.Generator) -> Trace:
    """The new default, until it stops by itself."""
    return follow(adaptive(fleet, rng), fleet)


def adaptive(fleet: Fleet, rng: np.random.Generator) -> AdaptiveStudy:
    """Return the default's study of a fleet, not begun."""
    specs = {name: robot.spec for name, robot in fleet.robots.items()}
    return AdaptiveStudy(_plan(fleet, ADAPTIVE_ROUNDS), specs, rng)


def follow(study: Study, fleet: Fleet) -> Trace:
    """Conduct a study on a fleet to its end."""
    trace = Trace()
    robots = fleet.robots
    robot_time_s = 0.0
    while (question := study.ask()) is not None:
        responses: dict[str, FrequencyResponse] = {}
        failed: dict[str, str] = {}
        purpose = question.purpose.split(" below ")[0]
        for name, excitation in question.tests.items():
            response, flown_s = robots[name].test(excitation)
            robot_time_s += flown_s
            spec = robots[name].spec
            once_s, parts = duration_s(excitation, spec), timing(excitation, spec)
            trace.spent_s[purpose] += once_s
            trace.spent_s[REPEATED] += flown_s - once_s
            trace.waited_s += 2 * parts.ramp_s + parts.settle_s
            if response.quality.usable:
                responses[name] = response
            else:
                failed[name] = str(response.quality)
        before_s = time.process_time()
        try:
            report = study.tell(responses, failed)
        except StudyError as error:
            trace.steps.append(Step(None, None, robot_time_s))
            trace.stopped_because = str(error)
            break
        trace.computing_s.append(time.process_time() - before_s)
        trace.steps.append(Step(report.selected, report.confidence, robot_time_s))
        trace.eliminated = len(report.eliminated)
        trace.held = [
            one.psi_low <= fleet.psi_star[one.robot] <= one.psi_high for one in report.ranking
        ]
        trace.stopped_because = report.stopped_because or ""
    return trace


def uniform_sweep(fleet: Fleet, _rng: np.random.Generator) -> Trace:
    """Single tones, equally spaced."""
    return _single_tones(fleet, np.linspace(*fleet.band_rad_s, SWEEP_TONES).tolist())


def logarithmic_sweep(fleet: Fleet, _rng: np.random.Generator) -> Trace:
    """Single tones, equally spaced on a logarithmic axis."""
    return _single_tones(fleet, np.geomspace(*fleet.band_rad_s, SWEEP_TONES).tolist())


def random_search(fleet: Fleet, rng: np.random.Generator) -> Trace:
    """Single tones, drawn uniformly."""
    return _single_tones(fleet, rng.uniform(*fleet.band_rad_s, RANDOM_TONES).tolist())


def long_multitone(fleet: Fleet, _rng: np.random.Generator) -> Trace:
    """One long test of many tones on every robot."""
    harmonics = tuple(range(3, LONG_TEST_PERIODS + 1, 2))
    choice = ToneChoice(LONG_TEST_PERIODS * 2 * np.pi / fleet.band_rad_s[1], harmonics)
    return _largest_so_far(fleet, [choice.excitation("x")])


def oracle(fleet: Fleet, _rng: np.random.Generator) -> Trace:
    """Only prove what is known."""
    closest = min(fleet.sources, key=lambda source: fleet.psi_star[source])
    return Trace([Step(closest, None, oracle_time_s(fleet))])


METHODS: dict[str, Callable[[Fleet, np.random.Generator], Trace]] = {
    "algorithm-1": paper,
    "uniform-sweep": uniform_sweep,
    "log-sweep": logarithmic_sweep,
    "random-search": random_search,
    "long-multitone": long_multitone,
    "default": default,
    "oracle": oracle,
}


def _plan(fleet: Fleet, rounds: int) -> StudyPlan:
    return StudyPlan("target", tuple(fleet.sources), fleet.band_rad_s, rounds, "x")


def _single_tones(fleet: Fleet, omegas_rad_s: Sequence[float]) -> Trace:
    return _largest_so_far(
        fleet,
        [
            Excitation(
                axis="x",
                tones=(Tone(omega_rad_s=omega),),
                segments=SEGMENTS,
                segment_min_s=SEGMENT_MIN_S,
            )
            for omega in omegas_rad_s
        ],
    )


def _largest_so_far(fleet: Fleet, tests: Sequence[Excitation]) -> Trace:
    """Select by the largest ψ̂ that was measured of each source, after every test."""
    trace = Trace()
    robot_time_s = 0.0
    largest = dict.fromkeys(fleet.sources, 0.0)
    for excitation in tests:
        answers = {name: robot.test(excitation) for name, robot in fleet.robots.items()}
        robot_time_s += sum(duration_s for _, duration_s in answers.values())
        target = answers["target"][0]
        for source in largest:
            found = answers[source][0]
            # A test that noise spoils is repeated at fewer tones.
            _, one, other = np.intersect1d(
                target.omega_rad_s, found.omega_rad_s, return_indices=True
            )
            psi = chordal_distance(target.z[one], found.z[other])
            largest[source] = max(largest[source], float(np.nanmax(psi, initial=0.0)))
        trace.steps.append(Step(min(largest, key=lambda s: largest[s]), None, robot_time_s))
    return trace
