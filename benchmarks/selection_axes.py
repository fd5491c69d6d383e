"""Selection over all axes at once, on random fleets of linear robots whose axes are coupled.

    python -m benchmarks.selection_axes --axes 2 --fleets 50 --noise-mm 2

Every robot has loops with random natural frequencies, damping and inertial coupling, so that its
Z(ω) is known exactly, and with it the largest distance of the matrices in the band. Right is a
regret below 0.01 in that distance. The same fleets are ranked by their first axis alone as well.
The error that inverses leave, on a motion with equal power on all axes and at all frequencies, is
compared with one source on all axes and with the closest on each.

The study of 200 fleets consists of six such commands, which print a line for each fleet as it ends
(seeds may also be divided among machines with `--seed`), each with 2 and with 6 mm of noise:

    python -m benchmarks.selection_axes --axes 2 --fleets 40 --noise-mm 2 --processes 2
    python -m benchmarks.selection_axes --axes 3 --fleets 20 --noise-mm 2 --processes 2
    python -m benchmarks.selection_axes --axes 4 --fleets 40 --noise-mm 2 --processes 2

`--distortion 0.3` adds to each output y_i of the robots 0.3/m times the square of the one before
it, which no linear response explains.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field, fields
from functools import partial

import numpy as np

from nufleet.orchestrator.conduct.attempts import ATTEMPTS, retried
from nufleet.orchestrator.study.adaptive_algorithm import AdaptiveStudy
from nufleet.orchestrator.study.interface import Question, Report, Study, StudyPlan
from nufleet.orchestrator.study.source_by_axis import sources_by_axis
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.distance.nu_gap import chordal_peak_in_band
from nufleet.shared.frequency_test.excitation import ExcitationPlan
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.sims.coupled_loops import CoupledLoops, CoupledLoopsSettings

BAND_RAD_S = (0.2, 8.0)
NAMES = ("x", "y", "z", "w")
CLAIM = 0.95
RIGHT_BELOW = 0.01
ROUNDS = 8

Robots = Mapping[str, CoupledLoops]


@dataclass
class Counts:
    """What was counted over all fleets."""

    fleets: int = 0
    claims: int = 0
    claims_right: int = 0
    right: int = 0
    regret: float = 0.0
    alone_regret: float = 0.0
    robot_s: float = 0.0
    alone_s: float = 0.0
    entries: int = 0
    inside: int = 0
    intervals: int = 0
    intervals_right: int = 0
    wrong: list[int] = field(default_factory=list)
    missed: list[str] = field(default_factory=list)
    differ: int = 0
    left_by_one: float = 0.0
    left_by_axis: float = 0.0

    def __add__(self, other: Counts) -> Counts:
        """Return the counts of both."""
        names = [one.name for one in fields(self)]
        return Counts(**{name: getattr(self, name) + getattr(other, name) for name in names})

    @property
    def line(self) -> str:
        """What was counted of one fleet."""
        claimed = "right" if self.claims_right else "WRONG" if self.claims else "none"
        return (
            f"regret {self.regret:.4f}, claim {claimed}, {self.robot_s:.0f} s, "
            f"{self.robot_s / self.alone_s:.2f} times one axis, "
            f"{self.intervals_right} of {self.intervals} intervals"
        )


def random_robots(
    axes: int, sources: int, noise_std_m: float, seed: int
) -> dict[str, CoupledLoops]:
    """Return a target and sources whose axes differ from it independently of each other."""
    rng = np.random.default_rng([seed, axes])
    base, damping = rng.uniform(2.5, 5.0, axes), rng.uniform(0.5, 0.9, axes)
    pairs = axes * (axes - 1) // 2
    robots = {}
    for name in ("target", *(f"source-{n}" for n in range(1, sources + 1))):
        rates = base if name == "target" else base * np.exp(rng.normal(0.0, 0.2, axes))
        settings = CoupledLoopsSettings(
            natural_frequency_rad_s=tuple(rates.tolist()),
            damping_ratio=tuple((damping * np.exp(rng.normal(0.0, 0.1, axes))).tolist()),
            coupling=tuple(rng.uniform(-0.2, 0.2, pairs).tolist()),
            axes=NAMES[:axes],
            noise_std_m=noise_std_m,
        )
        robots[name] = CoupledLoops(name, settings, rng.spawn(1)[0])
        robots[name].connect()
    return robots


def played(
    question: Question, robots: Robots, counts: Counts, distortion_1_m: float
) -> tuple[dict[str, FrequencyResponse], float]:
    """Return what the robots measure, and the robot time in s that repeated tests took."""
    found, repeated_s = {}, 0.0
    for name, test in question.tests.items():
        excitation, robot = test, robots[name]
        for attempt in range(ATTEMPTS):
            plan = plan_excitation(excitation, robot.spec, name)
            repeated_s += plan.duration_s if attempt else 0.0
            response = measured(robot, plan, counts, distortion_1_m)
            if response.quality.usable:
                found[name] = response
                break
            excitation = retried(excitation, plan, response.quality, robot.spec)
    return found, repeated_s


def measured(
    robot: CoupledLoops, plan: ExcitationPlan, counts: Counts, distortion_1_m: float
) -> FrequencyResponse:
    """Return what a test measures, and count how often the truth lies in the 95 % regions."""
    reference = reference_of(plan)
    names = [axis.name for axis in robot.spec.axes]
    columns = [names.index(one.axis) for one in plan.played]
    references = np.zeros((len(reference), len(names)))
    references[:, columns] = reference.reshape(len(reference), -1)
    moved = robot.run(references)
    moved = moved + distortion_1_m * np.roll(moved, 1, axis=1) ** 2
    output = moved[:, columns].reshape(reference.shape)
    robot.rest()
    response = estimate_frequency_response(reference, output, plan)
    if response.matrix is not None:
        omega = response.matrix.rows[0].omega_rad_s
        z = robot.model.graph(omega)[:, len(names) :]
        for column, row in zip(columns, response.matrix.rows, strict=True):
            at = np.array(columns)[response.matrix.played_by]
            error = np.abs(row.z - z[np.arange(len(omega)), column, at])
            counts.inside += int(np.sum(error <= row.radius()))
            counts.entries += len(omega)
    return response


def follow(
    study: Study, robots: Robots, counts: Counts, distortion_1_m: float
) -> tuple[Report, float]:
    """Follow a study to its end; return its last report and the robot time in s."""
    robot_s, report = 0.0, None
    while (question := study.ask()) is not None:
        robot_s += question.robot_time_s or 0.0
        answers, repeated_s = played(question, robots, counts, distortion_1_m)
        robot_s += repeated_s
        report = study.tell(answers, dict.fromkeys(question.tests, "not usable"))
    if report is None:
        raise ValueError("a study asks at least one question")
    return report, robot_s


def rank_fleet(
    axes: int, sources: int, noise_std_m: float, distortion_1_m: float, seed: int
) -> Counts:
    """Rank one random fleet by all axes and by the first alone; return what was counted."""
    counts = Counts()
    robots = random_robots(axes, sources, noise_std_m, seed)
    specs = {name: robot.spec for name, robot in robots.items()}
    names = tuple(name for name in robots if name != "target")
    at_target = robots["target"].model
    truth = {
        name: chordal_peak_in_band(at_target, robots[name].model, BAND_RAD_S).value
        for name in names
    }
    best = min(truth.values())
    plan = StudyPlan("target", names, BAND_RAD_S, ROUNDS, "x", also=NAMES[1:axes])
    study = AdaptiveStudy(plan, specs, np.random.default_rng(seed))
    report, robot_s = follow(study, robots, counts, distortion_1_m)
    regret = truth[report.selected] - best
    counts.fleets += 1
    counts.right += regret < RIGHT_BELOW
    counts.regret += regret
    counts.robot_s += robot_s
    if (report.confidence or 0.0) >= CLAIM:
        counts.claims += 1
        counts.claims_right += regret < RIGHT_BELOW
        if regret >= RIGHT_BELOW:
            counts.wrong.append(seed)
    for estimate in report.ranking:
        counts.intervals += 1
        psi = truth[estimate.robot]
        held = estimate.psi_low <= psi <= estimate.psi_high
        counts.intervals_right += held
        if not held:
            counts.missed.append(f"seed {seed}, {estimate.robot}: {psi:.4f}, {estimate.stated}")
    chosen = sources_by_axis(report.ranking)
    if chosen:
        counts.differ += 1
        counts.left_by_one += error_left(robots, [report.selected] * axes)
        counts.left_by_axis += error_left(robots, [chosen[axis] for axis in NAMES[:axes]])
    one = StudyPlan("target", names, BAND_RAD_S, ROUNDS, "x")
    alone = AdaptiveStudy(one, specs, np.random.default_rng(seed))
    report, robot_s = follow(alone, robots, Counts(), distortion_1_m)
    counts.alone_regret += truth[report.selected] - best
    counts.alone_s += robot_s
    return counts


def error_left(robots: Robots, sources: Sequence[str]) -> float:
    """Return the error relative to the motion, with the inverse of one source for each axis.

    An inverse answers for its own axis, so that the target's cross responses remain:
    E_ij = δ_ij − z_T,ij / z_S,jj with the source S of axis j.
    """
    omega, count = np.linspace(*BAND_RAD_S, 200), len(sources)
    target = robots["target"].model.graph(omega)[:, count:]
    left = np.broadcast_to(np.eye(count), target.shape).astype(np.complex128)
    for place, source in enumerate(sources):
        own = robots[source].model.graph(omega)[:, count:][:, place, place]
        left[:, :, place] -= target[:, :, place] / own[:, None]
    return float(np.sqrt(np.mean(np.sum(np.abs(left) ** 2, axis=(1, 2))) / count))


def main() -> None:
    """Rank random fleets and print what was counted."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--axes", type=int, default=2, choices=(2, 3, 4))
    parser.add_argument("--sources", type=int, default=3)
    parser.add_argument("--fleets", type=int, default=50)
    parser.add_argument("--noise-mm", type=float, default=2.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--distortion", type=float, default=0.0, metavar="PER_M")
    parser.add_argument("--processes", type=int, default=1)
    options = parser.parse_args()
    rank = partial(
        *(rank_fleet, options.axes, options.sources, options.noise_mm / 1000, options.distortion)
    )
    seeds = range(options.seed, options.seed + options.fleets)
    counts = Counts()
    with ProcessPoolExecutor(options.processes) as pool:
        for seed, one in zip(seeds, pool.map(rank, seeds), strict=True):
            print(f"seed {seed}: {one.line}", flush=True)
            counts += one
    n = counts.fleets
    print(f"{n} fleets of {options.sources} sources, {options.axes} axes, {options.noise_mm:g} mm")
    print(f"right {counts.right}, claims {counts.claims}, of them right {counts.claims_right}")
    print(f"claims that were wrong: seeds {counts.wrong}")
    print(f"regret {counts.regret / n:.4f}, by the first axis alone {counts.alone_regret / n:.4f}")
    print(
        f"robot time {counts.robot_s / n:.0f} s, of the first axis alone {counts.alone_s / n:.0f}"
        f" s: {counts.robot_s / counts.alone_s:.2f} times"
    )
    if counts.differ:
        print(
            f"axes differ in {counts.differ} fleets; error left with one source "
            f"{counts.left_by_one / counts.differ:.3f}, with the closest on each axis "
            f"{counts.left_by_axis / counts.differ:.3f}"
        )
    print(f"entries inside their 95 % regions: {counts.inside / counts.entries:.3f}")
    held = counts.intervals_right
    print(f"95 % intervals of ψ* that hold it: {held} of {counts.intervals}; those that do not:")
    print("\n".join(counts.missed))


if __name__ == "__main__":
    main()
