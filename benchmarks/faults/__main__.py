"""What a fleet does when things go wrong, in figures: one function for each, a table and JSON.

python -m benchmarks.faults                        # all
python -m benchmarks.faults fuzz --payloads 5000
python -m benchmarks.faults simulate --seeds 100000     # the whole protocol, under a virtual clock
python -m benchmarks.faults simulate --seeds 1 --first 7 --without 6-late-states
"""

from __future__ import annotations

import argparse
import json
import os
import time
from collections.abc import Callable
from pathlib import Path

from benchmarks.faults import chaos, detection, fuzz, memory, restarts, simulate, stop_time
from benchmarks.faults.figure import Figure
from benchmarks.faults.simulation.without import WITHOUT

FIGURES: dict[str, Callable[[argparse.Namespace], list[Figure]]] = {
    "detection": lambda own: detection.figures(own.kills, own.silences),
    "stop": lambda own: stop_time.figures(own.robots or 32, own.rounds),
    "restarts": lambda own: restarts.figures(own.restarts),
    "chaos": lambda own: chaos.figures(own.robots or 10, own.minutes, own.seed),
    "memory": lambda own: memory.figures(own.tests),
    "fuzz": lambda own: fuzz.figures(own.payloads, own.requests),
    "simulate": lambda own: simulate.figures(
        own.seeds, first=own.first, processes=own.processes, without=own.without
    ),
}


def main() -> None:
    """Parse the command line, measure, print a table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "what", nargs="*", metavar="FIGURE", help=f"of {', '.join(FIGURES)}; all without any"
    )
    parser.add_argument("--kills", type=int, default=20, help="detection: of an agent")
    parser.add_argument(
        "--silences", type=int, default=5, help="detection: freezes, and as many partitions"
    )
    parser.add_argument("--robots", type=int, help="stop: moving (32); chaos: in the fleet (10)")
    parser.add_argument("--rounds", type=int, default=6, help="stop: of every robot, one by one")
    parser.add_argument(
        "--restarts", type=int, default=20, help="restarts: of the router, and of orchestrators"
    )
    parser.add_argument("--minutes", type=float, default=10.0, help="chaos: how long")
    parser.add_argument("--seed", type=int, default=1, help="chaos: of what fails when")
    parser.add_argument("--tests", type=int, default=1000, help="memory: one after the other")
    parser.add_argument(
        "--payloads", type=int, default=5000, help="fuzz: to each decoder and reader"
    )
    parser.add_argument("--requests", type=int, default=20_000, help="fuzz: to a live agent")
    parser.add_argument("--seeds", type=int, default=10_000, help="simulate: how many schedules")
    parser.add_argument("--first", type=int, default=0, help="simulate: the first seed")
    parser.add_argument(
        "--processes", type=int, default=os.cpu_count(), help="simulate: how many at once"
    )
    parser.add_argument(
        "--without", choices=tuple(WITHOUT), help="simulate: with a fix taken out again"
    )
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()
    for name in arguments.what:
        if name not in FIGURES:
            parser.error(f"there is no figure {name!r}; there are {', '.join(FIGURES)}")
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    found: list[Figure] = []
    for name in arguments.what or FIGURES:
        began_s = time.perf_counter()
        for figure in FIGURES[name](arguments):
            found.append(figure)
            print(figure, flush=True)
        print(f"  ({name}: {time.perf_counter() - began_s:.0f} s)", flush=True)
    if arguments.json:
        documents = [figure.document() for figure in found]
        arguments.json.write_text(json.dumps(documents, indent=2))
    missed = [figure for figure in found if figure.holds is False]
    raise SystemExit(1 if missed else 0)


if __name__ == "__main__":
    main()
