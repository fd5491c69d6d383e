"""What one step of the online process costs and finds, beside GPy, scikit-learn and BoTorch.

A step is what a robot does in every sample: one more pair for the x and the y process, both
windows of 50 points fitted to convergence, one prediction each. Windows are recorded from tracking
drawings with the paper's architecture and a zero prior; harder ones are drawn at random. All get
the same windows, kernel, bounds and the paper's start; `warm` columns start each search where their
own last one ended, as the product does. What they find is compared by the log marginal likelihood,
by one formula for all; equal means within 1e-6, absolute. Where a likelihood is lower, our Newton
search continues from there: it ends at ours where the peer stopped short of the same maximum, and
elsewhere where there is another maximum. `best known` is the best of all columns and 24 starts.
Then a robot tracks drawings by a real clock; see `benchmarks.control_period`.

    python -m benchmarks.online_gp --minutes 10 --json online_gp.json

needs `pip install -c constraints.txt -e '.[benchmarks,learning,quadrotors]'`; --robot
double-integrator does without quadrotors. On a busy machine trust the processor's time.

The product has one warm start. In flight 1 window in 400 ends in a lower maximum, for one to three
samples, until that one is gone. A second start in every step removes most of these cases and takes
three times as long; tracking errors of a quadrotor along five drawings, with both architectures,
then differed by less than 0.5 % from those without. So there is no second start. A random window
has nothing to do with the one before, so there a warm start is a start anywhere.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import tempfile
import warnings
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from benchmarks.control_period import fly_by_the_clock, print_flight
from benchmarks.online_gp_columns import Column, Comparison, best_known, compare, run, run_product
from benchmarks.online_gp_ours import OURS
from benchmarks.online_gp_peers import MODULES, PEERS
from benchmarks.online_gp_windows import ROBOTS, Windows, random_windows, read, recorded
from nufleet.shared.gaussian_process.exact import warm_up

MEDIAN_MAX_MS, P99_MAX_MS, RATIO_MIN = 1.0, 3.0, 50.0
BLOCKS = 5


@dataclass(frozen=True)
class Row:
    """The times of one column, in ms per step, and its likelihoods relative to the product."""

    name: str
    start: str
    steps: int
    median_ms: float
    p99_ms: float
    processor_median_ms: float
    processor_p99_ms: float
    times_ours: float
    likelihood: Comparison


def row(column: Column, product: Column, windows: Windows, best: np.ndarray) -> Row:
    """Summarise a column beside the product on the same steps."""
    wall, processor = 1e3 * column.wall_s, 1e3 * column.processor_s
    same = product.at(column.steps)
    return Row(
        name=column.name,
        start=column.start,
        steps=len(column.steps),
        median_ms=float(np.median(wall)),
        p99_ms=float(np.quantile(wall, 0.99)),
        processor_median_ms=float(np.median(processor)),
        processor_p99_ms=float(np.quantile(processor, 0.99)),
        times_ours=float(np.median(column.wall_s) / np.median(same.wall_s)),
        likelihood=compare(column, same, windows.part(column.steps), best[column.steps]),
    )


def blocks(steps: int, wanted: int) -> np.ndarray:
    """Return `wanted` steps in a few runs spread over all, so that a peer can start warm."""
    length = max(1, min(wanted, steps) // BLOCKS)
    starts = np.linspace(0, steps - length, BLOCKS).round().astype(int)
    return np.unique(np.concatenate([start + np.arange(length) for start in starts]))


def measure(windows: Windows, peers: list[str], peer_steps: int) -> list[Row]:
    """Run every column on the windows, one after the other; the product on all of them."""
    product = run_product(windows)
    columns = [run(name, make, windows, np.arange(len(windows))) for name, make in OURS.items()]
    some = blocks(len(windows), peer_steps)
    for name in peers:
        for warm in (False, True):
            if warm and name == "GPy-logistic":
                continue  # it would stay where it is
            columns.append(run(name, PEERS[name], windows, some, warm=warm))
    best = best_known(windows, [product, *columns])
    return [row(column, product, windows, best) for column in (product, *columns)]


def print_rows(console: Console, title: str, rows: list[Row]) -> None:
    """Print times and likelihoods of one set of windows."""
    table = Table(title=f"{title}: one step of x and y, ms", title_justify="left")
    for heading in ("", "start", "steps", "median", "99 %", "median, processor", "99 %, processor",
                    "× ours"):  # fmt: skip
        table.add_column(heading, justify="left" if heading in ("", "start") else "right")
    for r in rows:
        times = (r.median_ms, r.p99_ms, r.processor_median_ms, r.processor_p99_ms)
        table.add_row(
            r.name, r.start, str(r.steps), *(f"{t:.3f}" for t in times), f"{r.times_ours:.1f}"
        )
    console.print(table)
    table = Table(
        title=f"{title}: log marginal likelihood less the product's, of each fit",
        title_justify="left",
    )
    headings = ("", "start", "fits", "higher", "by at most", "ours finds it from paper's start",
                "lower", "by at most", "stopped short", "another maximum", "below best known",
                "formula off by")  # fmt: skip
    for heading in headings:
        table.add_column(heading, justify="left" if heading in ("", "start") else "right")
    for r in rows:
        c = r.likelihood
        table.add_row(
            r.name,
            r.start,
            str(c.fits),
            f"{c.higher} ({100 * c.higher / c.fits:.2f} %)",
            f"{c.highest:.1e}",
            str(c.higher_found_from_papers_start),
            f"{c.lower} ({100 * c.lower / c.fits:.2f} %)",
            f"{c.lowest:.1e}",
            str(c.stopped_short),
            str(c.another_maximum),
            f"{c.below_best} ({100 * c.below_best / c.fits:.2f} %)",
            f"{c.formula_difference:.0e}",
        )
    console.print(table)


def verdicts(rows: list[Row]) -> list[str]:
    """Say whether the figures hold on one set of windows."""
    product, peers = rows[0], [r for r in rows if r.name in PEERS]

    def held(holds: bool) -> str:
        return "holds" if holds else "DOES NOT HOLD"

    limits = {"median": (product.median_ms, MEDIAN_MAX_MS), "99 %": (product.p99_ms, P99_MAX_MS)}
    lines = [
        f"{what} {value_ms:.3f} ms, below {limit_ms:g} ms: {held(value_ms < limit_ms)}"
        for what, (value_ms, limit_ms) in limits.items()
    ]
    lines += [
        f"{r.times_ours:.0f} times faster than {r.name}, {r.start} start, at least "
        f"{RATIO_MIN:g}: {held(r.times_ours >= RATIO_MIN)}"
        for r in peers
        if r.name == "GPy"
    ]
    lines += [
        f"likelihood no worse than that of {r.name}, {r.start} start: "
        f"{held(r.likelihood.higher == 0)}, worse in {r.likelihood.higher} of "
        f"{r.likelihood.fits} fits, better in {r.likelihood.lower}"
        for r in peers
    ]
    return lines


def main() -> None:
    """Parse the command line, measure both sets, fly by the clock, print and store."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robot", choices=ROBOTS, default=ROBOTS[0], help="that is recorded")
    parser.add_argument("--windows", type=Path, help="recorded by benchmarks.online_gp_windows")
    parser.add_argument("--random", type=int, default=500, help="steps of random windows")
    parser.add_argument("--peers", nargs="*", choices=list(PEERS), default=list(PEERS))
    parser.add_argument("--peer-steps", type=int, default=500, help="in each set, in five runs")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minutes", type=float, default=10.0, help="of paced flight, 0 for none")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    arguments = parser.parse_args()
    for name in arguments.peers:
        if importlib.util.find_spec(MODULES[name]) is None:
            parser.error(
                f"{name} is not installed: pip install -c constraints.txt -e '.[benchmarks]', "
                "or name the others after --peers"
            )
    warm_up()
    console = Console(width=170)
    console.print(
        f"{os.cpu_count()} processors, on which {os.getloadavg()[0]:.1f} processes run; one thread"
    )
    if arguments.windows is not None:
        flown = read(arguments.windows)
    else:
        with tempfile.TemporaryDirectory() as folder:
            flown = recorded(arguments.robot, Path(folder) / "windows.npz")
    rng = np.random.default_rng(arguments.seed)
    sets = {
        "in flight": flown,
        "random windows": random_windows(arguments.random, flown.targets.shape[1], rng),
    }
    results: dict[str, Any] = {}
    # The peers warn of parameters at their bounds and of inputs that are not in the unit cube.
    warnings.simplefilter("ignore")
    with threadpool_limits(1):
        if "BoTorch" in arguments.peers:
            import torch

            torch.set_num_threads(1)
        for title, windows in sets.items():
            rows = measure(windows, arguments.peers, arguments.peer_steps)
            print_rows(console, title, rows)
            for line in verdicts(rows):
                console.print(f"  {title}: {line}", highlight=False)
            results[title] = [asdict(r) for r in rows]
        if arguments.minutes > 0:
            flight = fly_by_the_clock(arguments.minutes)
            print_flight(flight)
            results["control period"] = asdict(flight)
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
