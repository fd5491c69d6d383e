"""How a ranking grows with the fleet: wall time per iteration, memory per robot, real-time cost.

Robots are agents of their own session each, dealt to a few processes, tested through a real router.

    python -m benchmarks.fleet_scale --robots 8 32 128 256
    python -m benchmarks.fleet_scale --robots 32 --realtime 1 --band 5 10
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import psutil

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.conductor import conduct
from nufleet.orchestrator.conduct.dispatcher import Dispatcher
from nufleet.orchestrator.conduct.leases import lease_robots
from nufleet.orchestrator.conduct.rank_run import RankRequest, prepare
from nufleet.orchestrator.conduct.recipe import make_study, recipe_of
from nufleet.orchestrator.fleet.connection import started_fleet
from nufleet.orchestrator.repository.repository import open_repository
from nufleet.orchestrator.study.interface import Question, Report
from nufleet.orchestrator.study.outcomes import Measured, TestOutcome
from nufleet.shared.robots.fleet_file import read_fleet_file

PROCESSES = 4


class Timer:
    """An observer that times the iterations and keeps each one's longest test."""

    def __init__(self) -> None:
        self.asked_s = 0.0
        self.iterations_s: list[float] = []
        self.slowest_test_s: list[float] = []
        self.failures = 0

    def asked(self, question: Question) -> None:
        """An iteration begins."""
        del question
        self.asked_s = time.perf_counter()

    def attempt_failed(self, robot: str, attempt: int, reason: str) -> None:
        """Count it."""
        print(f"  {robot}, attempt {attempt}: {reason}")
        self.failures += 1

    def told(self, question: Question, outcomes: Mapping[str, TestOutcome], report: Report) -> None:
        """An iteration ended."""
        del question, report
        self.iterations_s.append(time.perf_counter() - self.asked_s)
        tests = [o.result.plan.duration_s for o in outcomes.values() if isinstance(o, Measured)]
        self.slowest_test_s.append(max(tests))


def write_fleet(path: Path, robots: int, rng: np.random.Generator) -> None:
    """Write a fleet of random Section V robots."""
    lines = ["schema = 1", f'name = "scale-{robots}"', ""]
    for k in range(robots):
        name = "target" if k == 0 else f"source-{k}"
        alpha, beta = rng.uniform(0.8, 1.1), rng.uniform(0.0, 0.005)
        lines += [
            f"[robots.{name}]",
            'driver = "double_integrator"',
            f"settings = {{ alpha = {alpha:.6f}, beta = {beta:.6f}, noise_std_m = 0.001 }}",
            "",
        ]
    path.write_text("\n".join(lines))


def measure(
    robots: int, iterations: int, band: tuple[float, float], realtime: float | None
) -> dict[str, float]:
    """Rank one fleet; return what it cost."""
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "fleet.toml"
        write_fleet(path, robots, np.random.default_rng(robots))
        began_s = time.perf_counter()
        with started_fleet(read_fleet_file(path), path, processes=PROCESSES, realtime=realtime) as (
            fleet,
            _,
            there,
        ):
            started_s = time.perf_counter() - began_s
            request = RankRequest("target", None, band, iterations, 0, None)
            ready = prepare(fleet, request, there)
            prepared_s = time.perf_counter() - began_s - started_s
            timer = Timer()
            with (
                open_repository(str(Path(directory) / "nufleet.sqlite")) as repository,
                lease_robots(repository.leases, fleet, "scale", ready.descriptions) as leases,
            ):
                archive = Archive(repository, "scale", leases)
                begun = archive.begin("scale", "paper", ready.plan, 0, ready.descriptions)
                log = archive.log(begun.study_id)
                specs = recipe_of(begun).specs
                dispatcher = Dispatcher(fleet, log, specs, on_attempt_failed=timer.attempt_failed)
                study = make_study(begun, repository.studies)
                conclusion = conduct(study, log, dispatcher, timer)
            agents = [
                child
                for child in psutil.Process().children(recursive=True)
                if "agent" in child.cmdline()
            ]
            resident = sum(child.memory_info().rss for child in agents)
            threads = sum(child.num_threads() for child in agents)
            own = psutil.Process().memory_info().rss
    if len(conclusion.report.ranking) != robots - 1:
        raise SystemExit(
            f"only {len(conclusion.report.ranking)} of {robots - 1} sources were ranked"
        )
    # The first iteration also loads the compiled numerics.
    return {
        "robots": robots,
        "start_s": started_s,
        "prepare_s": prepared_s,
        "iteration_median_s": float(np.median(timer.iterations_s[1:])),
        "iteration_max_s": max(timer.iterations_s[1:]),
        "slowest_test_median_s": float(np.median(timer.slowest_test_s[1:])),
        "failed_attempts": timer.failures,
        "agent_mib_per_robot": resident / robots / 2**20,
        "agent_threads_per_robot": threads / robots,
        "orchestrator_mib": own / 2**20,
    }


def main() -> None:
    """Parse the command line and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, nargs="+", default=[8, 32, 128, 256])
    parser.add_argument("--iterations", type=int, default=7)
    parser.add_argument("--band", type=float, nargs=2, default=[0.5, 10.0])
    parser.add_argument("--realtime", type=float)
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    arguments = parser.parse_args()
    print(f"{os.cpu_count()} cores, {PROCESSES} agent processes, band {arguments.band} rad/s")
    print("robots  start  prepare  iteration median/max  slowest test  MiB/robot  threads/robot")
    rows = []
    for robots in arguments.robots:
        row = measure(robots, arguments.iterations, tuple(arguments.band), arguments.realtime)
        rows.append(row)
        print(
            f"{robots:6d} {row['start_s']:5.1f}s {row['prepare_s']:7.2f}s "
            f"{row['iteration_median_s']:9.3f} / {row['iteration_max_s']:6.3f}s "
            f"{row['slowest_test_median_s']:11.1f}s {row['agent_mib_per_robot']:10.1f} "
            f"{row['agent_threads_per_robot']:14.1f}",
            flush=True,
        )
    if arguments.realtime:
        ratio = max(
            row["iteration_median_s"] / (row["slowest_test_median_s"] / arguments.realtime)
            for row in rows
        )
        print(f"iteration over the slowest robot's test: {ratio:.3f}")
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
