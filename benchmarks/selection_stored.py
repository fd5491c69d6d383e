"""A new target against many sources whose responses are stored: only the target flies.

    python -m benchmarks.selection_stored --fleets 50 --sources 50 --seed 1
    python -m benchmarks.selection_stored --fleets 1 --sources 5000

Every source was tested once, on an earlier day, over the whole band. The default algorithm then
selects for a target that nothing is known of. Right is a regret below 0.01, as in
`benchmarks.selection`.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
import zlib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.selection import CLAIM, RIGHT_BELOW
from benchmarks.selection_families import FAMILIES
from benchmarks.selection_fleets import NOISE_LEVELS_M, random_fleet
from benchmarks.selection_methods import ADAPTIVE_ROUNDS, follow
from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge
from nufleet.orchestrator.study.adaptive_algorithm import AdaptiveStudy
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.orchestrator.study.looks import Looks
from nufleet.shared.errors import InvalidInputError


@dataclass(frozen=True)
class Outcome:
    """One target: what was lost by the selection, what was claimed, how long the target flew."""

    regret: float
    confidence: float
    flight_s: float
    tests: int
    first_computing_s: float
    later_computing_s: float
    """Processor time until the first choice, and of the longest later round, in s."""
    memory_mib: float
    """Memory that choosing took beyond that of the stored responses, at its peak."""


@dataclass(frozen=True)
class Row:
    """All targets of one family."""

    family: str
    right: float
    claims: int
    claims_right: float
    flight_mean_s: float
    flight_90_s: float
    flight_worst_s: float
    tests_mean: float
    first_computing_worst_s: float
    later_computing_worst_s: float
    memory_worst_mib: float


def outcome_of(family: str, sources: int, noise_m: float, seed: int, number: int) -> Outcome:
    """Select for one new target."""
    rng = np.random.default_rng([seed, zlib.crc32(family.encode()), sources, number])
    fleet = random_fleet(family, sources, noise_m, rng)
    specs = {name: robot.spec for name, robot in fleet.robots.items()}
    all_new = StudyPlan("target", tuple(fleet.sources), fleet.band_rad_s, ADAPTIVE_ROUNDS, "x")
    nothing = {
        name: AxesKnowledge(name, spec, fleet.band_rad_s[1], all_new.axes)
        for name, spec in specs.items()
    }
    looks = Looks(all_new, AdaptiveSettings(), nothing)
    stored = {}
    for name, robot in fleet.sources.items():
        response, _ = robot.test(looks.excitation(name, looks.first[name]))
        if response.quality.usable:
            stored[name] = [response]
    plan = replace(all_new, sources=tuple(stored))
    before_mib, before_s = _peak_mib(), time.process_time()
    study = AdaptiveStudy(plan, specs, rng, stored=stored, absent=tuple(stored))
    began_s = time.process_time() - before_s
    trace = follow(study, fleet)
    flown = {
        name: len(tests) - len(stored.get(name, ())) for name, tests in study.responses.items()
    }
    if any(flown[source] for source in stored):
        raise InvalidInputError(f"sources flew, although their responses are stored: {flown}")
    last = trace.steps[-1]
    return Outcome(
        regret=fleet.regret(last.selected),
        confidence=last.confidence or 0.0,
        flight_s=last.robot_time_s,
        tests=flown["target"],
        first_computing_s=began_s + trace.computing_s[0],
        later_computing_s=max(trace.computing_s[1:], default=0.0),
        memory_mib=_peak_mib() - before_mib,
    )


def _peak_mib() -> float:
    """Return the largest memory that this process ever had, in MiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def row_of(family: str, outcomes: Sequence[Outcome]) -> Row:
    """Summarise one family."""
    right = np.array([outcome.regret < RIGHT_BELOW for outcome in outcomes])
    claimed = np.array([outcome.confidence >= CLAIM for outcome in outcomes])
    flights = np.array([outcome.flight_s for outcome in outcomes])
    return Row(
        family=family,
        right=float(right.mean()),
        claims=int(claimed.sum()),
        claims_right=float(right[claimed].mean()) if claimed.any() else float("nan"),
        flight_mean_s=float(flights.mean()),
        flight_90_s=float(np.quantile(flights, 0.9)),
        flight_worst_s=float(flights.max()),
        tests_mean=float(np.mean([outcome.tests for outcome in outcomes])),
        first_computing_worst_s=max(outcome.first_computing_s for outcome in outcomes),
        later_computing_worst_s=max(outcome.later_computing_s for outcome in outcomes),
        memory_worst_mib=max(outcome.memory_mib for outcome in outcomes),
    )


def main() -> None:
    """Parse the command line, run, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fleets", type=int, default=50, help="new targets of each family")
    parser.add_argument("--sources", type=int, default=50)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--families", nargs="*", default=list(FAMILIES), choices=list(FAMILIES))
    parser.add_argument("--noise", default="high", choices=list(NOISE_LEVELS_M))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    arguments = parser.parse_args()
    noise_m = NOISE_LEVELS_M[arguments.noise]
    rows = []
    print(
        f"{arguments.sources} stored sources, {arguments.noise} noise, {arguments.fleets} targets\n"
        "family              P(right)  95 % claims right  flight mean  90 %   worst  tests"
        "  computing first, later  memory"
    )
    with ProcessPoolExecutor(arguments.workers) as pool:
        for family in arguments.families:
            waiting = [
                pool.submit(outcome_of, family, arguments.sources, noise_m, arguments.seed, number)
                for number in range(arguments.fleets)
            ]
            row = row_of(family, [future.result() for future in waiting])
            rows.append(row)
            print(
                f"{row.family:<18} {row.right:9.3f}  {row.claims_right:.3f} of {row.claims:<8}"
                f"  {row.flight_mean_s:9.0f} s  {row.flight_90_s:.0f} s  {row.flight_worst_s:.0f} s"
                f"  {row.tests_mean:.2f}  {row.first_computing_worst_s:15.1f} s, "
                f"{row.later_computing_worst_s:.1f} s  {row.memory_worst_mib:.0f} MiB",
                flush=True,
            )
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=2))


if __name__ == "__main__":
    main()
