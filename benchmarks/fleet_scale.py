"""How a ranking grows with the fleet: processor time per test and at rest, wall time, memory.

The robots are dealt to a few agent processes and tested through a real router. Processor time is
that of the orchestrator, the agents and the router together, per robot and iteration (a test), and
per robot and second while nothing moves.

    python -m benchmarks.fleet_scale --robots 8 64 256
    python -m benchmarks.fleet_scale --robots 8 16 32 64 128 256 512 1000 --json scale.json
    python -m benchmarks.fleet_scale --robots 32 --realtime 1 --band 5 10
"""

from __future__ import annotations

import argparse
import json
import os
import tempfile
import time
from collections.abc import Mapping
from contextlib import suppress
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


PROGRAMS = ("orchestrator", "agents", "router")


def processor_s() -> dict[str, float]:
    """Return the processor time that each program of the fleet has used, in s."""
    used = dict.fromkeys(PROGRAMS, 0.0)
    for process in (psutil.Process(), *psutil.Process().children(recursive=True)):
        with suppress(psutil.NoSuchProcess):
            line, times = process.cmdline(), process.cpu_times()
            name = "agents" if "agent" in line else "router" if "router" in line else PROGRAMS[0]
            used[name] += times.user + times.system
    return used


def spent_ms(before: Mapping[str, float], among: float) -> dict[str, float]:
    """Return the processor time used since a reading by each program, in ms per one of `among`."""
    now = processor_s()
    return {name: 1e3 * (now[name] - before[name]) / among for name in PROGRAMS}


class Timer:
    """An observer that times the iterations and keeps each one's longest test."""

    def __init__(self) -> None:
        self.first_over = dict.fromkeys(PROGRAMS, 0.0)
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
        if len(self.iterations_s) == 1:
            self.first_over = processor_s()
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
    robots: int,
    iterations: int,
    band: tuple[float, float],
    realtime: float | None,
    resting_s: float,
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
            rested = processor_s()
            time.sleep(resting_s)
            rest_ms = spent_ms(rested, robots * resting_s)
            request = RankRequest("target", None, band, iterations, 0, None)
            ready = prepare(fleet, request, there)
            prepared_s = time.perf_counter() - began_s - started_s - resting_s
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
                test_ms = spent_ms(timer.first_over, robots * (iterations - 1))
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
        "start_agent_processor_s": rested["agents"] / PROCESSES,
        "prepare_s": prepared_s,
        "iteration_median_s": float(np.median(timer.iterations_s[1:])),
        "iteration_max_s": max(timer.iterations_s[1:]),
        "slowest_test_median_s": float(np.median(timer.slowest_test_s[1:])),
        "failed_attempts": timer.failures,
        "agent_mib_per_robot": resident / robots / 2**20,
        "agent_threads_per_robot": threads / robots,
        "orchestrator_mib": own / 2**20,
        "load": os.getloadavg()[0],
        **{f"test_{name}_ms": spent for name, spent in test_ms.items()},
        **{f"rest_{name}_ms_per_s": spent for name, spent in rest_ms.items()},
    }


def main() -> None:
    """Parse the command line and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--robots", type=int, nargs="+", default=[8, 32, 128, 256])
    parser.add_argument("--iterations", type=int, default=7)
    parser.add_argument("--band", type=float, nargs=2, default=[0.5, 10.0])
    parser.add_argument("--realtime", type=float)
    parser.add_argument("--resting", type=float, default=10.0, help="s before anything moves")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    arguments = parser.parse_args()
    print(f"{os.cpu_count()} cores, {PROCESSES} agent processes, band {arguments.band} rad/s")
    print("processor time of orchestrator + agents + router: per test, and per s at rest")
    rows = []
    for robots in arguments.robots:
        band = tuple(arguments.band)
        row = measure(robots, arguments.iterations, band, arguments.realtime, arguments.resting)
        rows.append(row)
        test_ms, rest_ms = (
            [row[f"{kind}_{name}_ms{unit}"] for name in PROGRAMS]
            for kind, unit in (("test", ""), ("rest", "_per_s"))
        )
        print(
            f"{robots:5d} robots: {sum(test_ms):5.2f} ms ("
            + " + ".join(f"{ms:.2f}" for ms in test_ms)
            + f"), {sum(rest_ms):5.3f} ms ("
            + " + ".join(f"{ms:.3f}" for ms in rest_ms)
            + f"); start {row['start_s']:.1f} s, prepare {row['prepare_s']:.1f} s, "
            f"iteration {row['iteration_median_s']:.2f} s, slowest test "
            f"{row['slowest_test_median_s']:.0f} s; {row['agent_mib_per_robot']:.2f} MiB and "
            f"{row['agent_threads_per_robot']:.1f} threads per robot; load {row['load']:.1f}",
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
