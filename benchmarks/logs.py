"""Selection from flight logs: one drawing flown by every robot, on an earlier day.

    python -m benchmarks.logs --fleets 4 --seed 1

Every robot, the target too, flew drawings for some time; the responses estimated from these records
are all that is known before the default algorithm selects. Two questions are answered: whether ψ*
as the logs alone tell it lies within 2 standard deviations of the truth, and how many of the claims
of 95 % that the algorithm makes in the end are right, and for how many robot-seconds. Right is a
regret below 0.01, as in `benchmarks.selection`.
"""

from __future__ import annotations

import argparse
import json
import os
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.selection import CLAIM, RIGHT_BELOW
from benchmarks.selection_families import BAND_RAD_S, FAMILIES, SAMPLE_TIME_S
from benchmarks.selection_fleets import NOISE_LEVELS_M, Fleet, TestedRobot, random_fleet
from benchmarks.selection_methods import ADAPTIVE_ROUNDS, follow
from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.orchestrator.study.adaptive_algorithm import AdaptiveStudy
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.orchestrator.study.selection_belief import SelectionBelief
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.record_response import Stretch, estimate_record_response
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.paths.installed import find_drawing
from nufleet.shared.paths.trajectories import travel

ACCELERATION_M_S2 = 3.2
GRID_POINTS = 256
SAMPLES = 600


@dataclass(frozen=True)
class Outcome:
    """One fleet."""

    known: int
    """Number of robots whose log gave a response."""
    within: int
    """Number of sources whose true ψ* lies within 2 standard deviations of what the logs say."""
    sources: int
    """Number of sources of which the logs say something, the target's included."""
    regret: float
    """Regret of the final selection."""
    confidence: float
    """Confidence of the final selection."""
    robot_time_s: float
    """Robot-seconds of tests that the algorithm flew."""


@dataclass(frozen=True)
class Row:
    """All fleets of one family."""

    family: str
    fleets: int
    known: float
    within_2_std: float
    right: float
    claims: int
    claims_right: float
    robot_time_s: float


def path(drawing: str, speed_m_s: float, seconds: float) -> FloatArray:
    """Return x of a drawing flown back and forth for this time: the log ends in mid-flight."""
    points = read_drawing(find_drawing(drawing))
    once = travel(points, speed_m_s, ACCELERATION_M_S2, SAMPLE_TIME_S)[:, 0]
    samples = round(seconds / SAMPLE_TIME_S)
    both = np.concatenate([once, once[::-1]])
    return np.asarray(np.tile(both, -(-samples // len(both)))[:samples])


def response_of(robot: TestedRobot, references: Sequence[FloatArray]) -> list[FrequencyResponse]:
    """Return the response of each flight that gives one."""
    found = []
    for reference in references:
        record = estimate_record_response(
            [Stretch(reference, robot.fly(reference))],
            SAMPLE_TIME_S,
            BAND_RAD_S,
            robot.spec.settling_time_s,
        )
        if record.response.quality.usable:
            found.append(record.response)
    return found


def by_logs_alone(
    fleet: Fleet, known: Mapping[str, list[FrequencyResponse]], rng: np.random.Generator
) -> dict[str, tuple[float, float]]:
    """Return mean and standard deviation of ψ* of every source that the logs cover."""
    grid = np.linspace(*BAND_RAD_S, GRID_POINTS)
    draws = {}
    for name, responses in known.items():
        robot = RobotKnowledge(name, fleet.robots[name].spec, BAND_RAD_S[1])
        for response in responses:
            robot.learn(response, rng)
        draws[name] = robot.model.draw(grid, SAMPLES, rng)
    target = draws.pop("target", None)
    if target is None or not draws:
        return {}
    belief = SelectionBelief.of(grid, target, draws)
    return {
        source: (float(psi.mean()), float(psi.std()))
        for source, psi in zip(belief.sources, belief.psi_star, strict=True)
    }


def outcome_of(
    family: str,
    sources: int,
    noise_m: float,
    references: Sequence[FloatArray],
    seed: int,
    number: int,
) -> Outcome:
    """Fly one fleet, and select from its logs."""
    rng = np.random.default_rng([seed, zlib.crc32(family.encode()), sources, number])
    fleet = random_fleet(family, sources, noise_m, rng)
    logs = {name: response_of(robot, references) for name, robot in fleet.robots.items()}
    known = {name: responses for name, responses in logs.items() if responses}
    told = by_logs_alone(fleet, known, rng)
    specs = {name: robot.spec for name, robot in fleet.robots.items()}
    plan = StudyPlan("target", tuple(fleet.sources), BAND_RAD_S, ADAPTIVE_ROUNDS, "x")
    trace = follow(AdaptiveStudy(plan, specs, rng, stored=known), fleet)
    last = trace.steps[-1]
    return Outcome(
        known=len(known),
        within=sum(
            abs(mean - fleet.psi_star[source]) <= 2 * std for source, (mean, std) in told.items()
        ),
        sources=len(told),
        regret=fleet.regret(last.selected),
        confidence=last.confidence or 0.0,
        robot_time_s=last.robot_time_s,
    )


def row_of(family: str, robots: int, outcomes: Sequence[Outcome]) -> Row:
    """Summarise one family."""
    right = np.array([outcome.regret < RIGHT_BELOW for outcome in outcomes])
    claimed = np.array([outcome.confidence >= CLAIM for outcome in outcomes])
    told = sum(outcome.sources for outcome in outcomes)
    return Row(
        family=family,
        fleets=len(outcomes),
        known=float(np.mean([outcome.known for outcome in outcomes])) / robots,
        within_2_std=sum(o.within for o in outcomes) / told if told else float("nan"),
        right=float(right.mean()),
        claims=int(claimed.sum()),
        claims_right=float(right[claimed].mean()) if claimed.any() else float("nan"),
        robot_time_s=float(np.mean([outcome.robot_time_s for outcome in outcomes])),
    )


def main() -> None:
    """Parse the command line, run, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fleets", type=int, default=4, help="fleets of each family")
    parser.add_argument("--sources", type=int, default=5)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--families", nargs="*", default=list(FAMILIES), choices=list(FAMILIES))
    parser.add_argument("--noise", default="low", choices=list(NOISE_LEVELS_M))
    parser.add_argument("--drawing", default="shell")
    parser.add_argument(
        "--speeds", type=float, nargs="*", default=[0.6], help="in m/s, one log each"
    )
    parser.add_argument("--seconds", type=float, default=25.0, help="of each log")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    arguments = parser.parse_args()
    references = [path(arguments.drawing, speed, arguments.seconds) for speed in arguments.speeds]
    speeds = ", ".join(f"{speed:g}" for speed in arguments.speeds)
    print(
        f"{arguments.drawing} at {speeds} m/s for {arguments.seconds:g} s each, "
        f"{arguments.sources} sources, {arguments.noise} noise; load {os.getloadavg()[0]:.1f}\n"
        "family               logs used  psi* within 2 std  P(right)  95 % claims right  robot-s"
    )
    rows = []
    for family in arguments.families:
        outcomes = [
            outcome_of(
                family,
                arguments.sources,
                NOISE_LEVELS_M[arguments.noise],
                references,
                arguments.seed,
                number,
            )
            for number in range(arguments.fleets)
        ]
        row = row_of(family, arguments.sources + 1, outcomes)
        rows.append(row)
        print(
            f"{row.family:<19} {100 * row.known:9.0f} %  {row.within_2_std:17.3f}  {row.right:8.3f}"
            f"  {row.claims_right:8.3f} of {row.claims:<6}  {row.robot_time_s:7.0f}",
            flush=True,
        )
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=2))


if __name__ == "__main__":
    main()
