"""Experience selection on random fleets: how often right, how sure, and for how many robot-seconds.

    python -m benchmarks.selection --fleets 200 --seed 1 --workers 2

Every method selects on the same fleets. Right is a regret below 0.01: ψ* of the source selected
less that of the closest.
"""

from __future__ import annotations

import argparse
import json
import zlib
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.selection_families import FAMILIES
from benchmarks.selection_fleets import NOISE_LEVELS_M, random_fleet
from benchmarks.selection_methods import METHODS, Trace
from nufleet.shared.arrays import FloatArray

RIGHT_BELOW = 0.01
WANTED = 0.98
CLAIM = 0.95


@dataclass(frozen=True)
class Setting:
    """One cell of the experiment."""

    family: str
    sources: int
    noise: str


@dataclass(frozen=True)
class Outcome:
    """A method on one fleet, round by round; each of `regret` and `robot_time_s` has one per round.

    `confidence` is what was claimed in the end, None where a method claims nothing; `held` says of
    each source whether the interval of its ψ* holds it; `spent_s` and `waited_s` say where the
    robot-seconds went, as `benchmarks.selection_methods.Trace` does.
    """

    regret: list[float]
    robot_time_s: list[float]
    confidence: float | None
    held: list[bool]
    spent_s: dict[str, float]
    waited_s: float


@dataclass(frozen=True)
class Row:
    """A method in one setting; times are robot-seconds per fleet, None where it never got there."""

    method: str
    right: float
    regret_mean: float
    regret_worst: float
    robot_time_s: float
    robot_time_98_s: float | None
    robot_time_as_default_s: float | None
    """Robot time from which on it is as right as the default in the end."""
    default_as_right_s: float | None
    """Robot time of the default from which on that is as right as this method in the end."""
    claimed_mean: float | None
    claims: int
    claims_right: float | None
    intervals: int
    intervals_held: float | None
    spent_s: dict[str, float]
    waited_s: float


def outcomes_of(
    setting: Setting, seed: int, number: int, methods: Sequence[str]
) -> dict[str, Outcome]:
    """Run these methods on one fleet; each has its own generator, so none disturbs another."""
    label = zlib.crc32(f"{setting.family} {setting.sources} {setting.noise}".encode())
    found: dict[str, Outcome] = {}
    for which, (name, method) in enumerate(METHODS.items()):
        if name not in methods:
            continue
        rng = np.random.default_rng([seed, label, number])
        fleet = random_fleet(setting.family, setting.sources, NOISE_LEVELS_M[setting.noise], rng)
        trace: Trace = method(fleet, np.random.default_rng([seed, label, number, which]))
        found[name] = Outcome(
            regret=[fleet.regret(step.selected) for step in trace.steps],
            robot_time_s=[step.robot_time_s for step in trace.steps],
            confidence=trace.steps[-1].confidence,
            held=trace.held,
            spent_s=dict(trace.spent_s),
            waited_s=trace.waited_s,
        )
    return found


def rows_of(fleets: Sequence[dict[str, Outcome]]) -> list[Row]:
    """Summarise one setting."""
    of_default = _by_round([fleet["default"] for fleet in fleets])
    default_right = float(of_default[0][-1])
    rows = []
    for method in fleets[0]:
        outcomes = [fleet[method] for fleet in fleets]
        right, times = _by_round(outcomes)
        last = np.array([outcome.regret[-1] for outcome in outcomes])
        held = [float(one) for outcome in outcomes for one in outcome.held]
        claimed = [o for o in outcomes if o.confidence is not None]
        sure = [o for o in claimed if o.confidence is not None and o.confidence >= CLAIM]
        rows.append(
            Row(
                method=method,
                right=float(right[-1]),
                regret_mean=float(last.mean()),
                regret_worst=float(last.max()),
                robot_time_s=float(times[-1]),
                robot_time_98_s=_time_to(right, times, WANTED),
                robot_time_as_default_s=_time_to(right, times, default_right),
                default_as_right_s=_time_to(*of_default, float(right[-1])),
                claimed_mean=_mean([o.confidence or 0.0 for o in claimed]),
                claims=len(sure),
                claims_right=_mean([float(o.regret[-1] < RIGHT_BELOW) for o in sure]),
                intervals=len(held),
                intervals_held=_mean(held),
                spent_s=_mean_spent([outcome.spent_s for outcome in outcomes]),
                waited_s=float(np.mean([outcome.waited_s for outcome in outcomes])),
            )
        )
    return rows


def show(setting: Setting, rows: Sequence[Row], fleets: int) -> None:
    """Print one setting's table."""
    print(f"\n{setting.family}, {setting.sources} sources, {setting.noise} noise, {fleets} fleets")
    print(
        "  method          P(right)  regret mean  worst   robot-s   to 98 %   to default's P"
        "   claimed  95 % claims right"
    )
    for row in rows:
        claims = "" if row.claims_right is None else f"{row.claims_right:.3f} of {row.claims}"
        claimed = "" if row.claimed_mean is None else f"{row.claimed_mean:.3f}"
        print(
            f"  {row.method:<15} {row.right:8.3f}  {row.regret_mean:11.4f}  {row.regret_worst:.3f}"
            f"  {row.robot_time_s:8.0f}  {_time(row.robot_time_98_s):>8}"
            f"  {_time(row.robot_time_as_default_s):>15}   {claimed:>7}  {claims}"
        )
    at = {row.method: row for row in rows}
    ours_s, held = at["default"].robot_time_s, at["default"].intervals_held
    if held is not None:
        print(f"  {held:.3f} of {at['default'].intervals} intervals of ψ* hold it")
    spent = ", ".join(f"{time_s:.0f} for {what}" for what, time_s in at["default"].spent_s.items())
    print(f"  robot-s of the default: {spent}; {at['default'].waited_s:.0f} ramping or settling")
    for other, called in (("oracle", "the oracle's"), ("long-multitone", "the long test's")):
        if other in at:
            times = ours_s / at[other].robot_time_s
            print(f"  the default needs {times:.2f} times {called} robot-seconds", flush=True)
    if "long-multitone" in at:
        long = at["long-multitone"]
        as_right_s = long.default_as_right_s
        after = "never"
        if as_right_s is not None:
            after = f"after {as_right_s / long.robot_time_s:.2f} times its robot-seconds"
        print(f"  it is as right as the long test {after}", flush=True)
    if "algorithm-1" not in at:
        return
    ours, paper = at["default"].robot_time_as_default_s, at["algorithm-1"].robot_time_as_default_s
    if ours is not None:
        bound, theirs = ("", paper) if paper else ("< ", at["algorithm-1"].robot_time_s)
        print(
            f"  the default needs {bound}{ours / theirs:.3f} of Algorithm 1's robot-seconds",
            flush=True,
        )


def main() -> None:
    """Parse the command line, run, print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fleets", type=int, default=200)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--families", nargs="*", default=list(FAMILIES), choices=list(FAMILIES))
    parser.add_argument("--sources", type=int, nargs="*", default=[5, 20])
    parser.add_argument("--noise", nargs="*", default=list(NOISE_LEVELS_M))
    parser.add_argument(
        "--methods",
        nargs="*",
        default=list(METHODS),
        choices=list(METHODS),
        help="the default is always among them",
    )
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    arguments = parser.parse_args()
    methods = (*arguments.methods, "default")
    document = []
    with ProcessPoolExecutor(arguments.workers) as pool:
        for family in arguments.families:
            for sources in arguments.sources:
                for noise in arguments.noise:
                    setting = Setting(family, sources, noise)
                    waiting = [
                        pool.submit(outcomes_of, setting, arguments.seed, number, methods)
                        for number in range(arguments.fleets)
                    ]
                    rows = rows_of([future.result() for future in waiting])
                    show(setting, rows, arguments.fleets)
                    document.append({**asdict(setting), "rows": [asdict(row) for row in rows]})
    if arguments.json:
        arguments.json.write_text(json.dumps(document, indent=2))


def _by_round(outcomes: Sequence[Outcome]) -> tuple[FloatArray, FloatArray]:
    """Return the share that is right and the mean time after each round.

    A study that has stopped keeps its answer and spends nothing more.
    """
    rounds = max(len(outcome.regret) for outcome in outcomes)
    right = np.empty((len(outcomes), rounds))
    times = np.empty((len(outcomes), rounds))
    for n, outcome in enumerate(outcomes):
        index = np.minimum(np.arange(rounds), len(outcome.regret) - 1)
        right[n] = np.array(outcome.regret)[index] < RIGHT_BELOW
        times[n] = np.array(outcome.robot_time_s)[index]
    return right.mean(axis=0), times.mean(axis=0)


def _time_to(right: FloatArray, times: FloatArray, wanted: float) -> float | None:
    """Return the time from which on the share that is right never falls below what is wanted."""
    short = np.flatnonzero(right < wanted - 1e-12)
    first = int(short[-1]) + 1 if len(short) else 0
    return float(times[first]) if first < len(times) else None


def _mean_spent(outcomes: Sequence[dict[str, float]]) -> dict[str, float]:
    """Return the mean robot-seconds by what they were spent on, the most first."""
    total: Counter[str] = Counter()
    for spent_s in outcomes:
        total.update(spent_s)
    return {what: time_s / len(outcomes) for what, time_s in total.most_common()}


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _time(seconds: float | None) -> str:
    return "never" if seconds is None else f"{seconds:.0f}"


if __name__ == "__main__":
    main()
