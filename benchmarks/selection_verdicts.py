"""Verdicts on transfers against transfers that are simulated: how often right, how often harmful.

    python -m benchmarks.selection_verdicts --fleets 50 --seed 1

On every random linear fleet the default algorithm selects as in `benchmarks.selection`; from its
tests follows a verdict on each transfer, from every source to the target and back, for a random
closed trajectory. Each transfer is then simulated in time: the target's loop follows the reference
that the source's exact inverse makes of the trajectory, and the error of that over the error
without it says whether the verdict was right.
"""

from __future__ import annotations

import argparse
import json
import math
import zlib
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.signal import lsim

from benchmarks.selection_families import (
    BAND_RAD_S,
    SAMPLE_TIME_S,
    LinearLoop,
)
from benchmarks.selection_fleets import NOISE_LEVELS_M, random_fleet
from benchmarks.selection_methods import adaptive, follow
from nufleet.orchestrator.study.interface import DesiredMotion, SourceEstimate, StudyPlan
from nufleet.orchestrator.study.trajectory_spectrum import spectrum_of
from nufleet.orchestrator.study.transfer_verdicts import judge_transfers
from nufleet.orchestrator.study.verdict import Verdict
from nufleet.orchestrator.study.verdict_document import TransferVerdict
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import StudyError

PERIOD_S = 60.0
FASTEST_RAD_S = (1.5, 5.0)
LAPS = 3
"""Number of laps; the last one is measured, when even lightly damped transients have decayed."""

LINEAR = (
    "second-order",
    "lightly-damped",
    "flexible",
    "gain-and-delay",
    "low-resonance",
    "low-resonance-10-s",
)


@dataclass(frozen=True)
class Judged:
    """One verdict and the result of the simulated transfer; errors are relative RMS values."""

    family: str
    verdict: Verdict
    predicted: float
    within_bounds: bool
    measured: float
    baseline: float

    @property
    def helps(self) -> bool:
        """Whether the target did better than by itself."""
        return self.measured < self.baseline


@dataclass(frozen=True)
class Row:
    """All verdicts of one family; `right` is a share of those given, `harmful` a number."""

    family: str
    verdicts: int
    given: int
    right: float
    recommended: int
    harmful: int
    worst_recommended: float
    refused: int
    refused_wrongly: int
    error_off: float
    within_bounds: float


def random_trajectory(rng: np.random.Generator) -> FloatArray:
    """Return a smooth closed trajectory of one axis, in m, shape (samples,)."""
    highest = int(rng.uniform(*FASTEST_RAD_S) * PERIOD_S / (2 * math.pi))
    harmonics = np.arange(2, highest + 1)
    phases = rng.uniform(0, 2 * math.pi, len(harmonics))
    times_s = np.arange(round(PERIOD_S / SAMPLE_TIME_S)) * SAMPLE_TIME_S
    omega = 2 * math.pi * harmonics / PERIOD_S
    return np.asarray(np.cos(np.outer(times_s, omega) + phases) @ (1 / harmonics))


def through_inverse(source: LinearLoop, wanted: FloatArray) -> FloatArray:
    """Return the reference that a source's exact inverse makes of a closed trajectory."""
    amplitudes = np.fft.rfft(wanted)
    omega = 2 * math.pi * np.fft.rfftfreq(len(wanted), SAMPLE_TIME_S)
    moving = np.abs(amplitudes) > 1e-9 * np.abs(amplitudes).max()
    amplitudes[moving] /= source.response(omega[moving])
    return np.asarray(np.fft.irfft(np.where(moving, amplitudes, 0.0), len(wanted)))


def tracking_error(target: LinearLoop, reference: FloatArray, wanted: FloatArray) -> float:
    """Fly laps of a closed reference from rest; return the relative RMS error of the last lap."""
    amplitudes = np.fft.rfft(reference)
    omega = 2 * math.pi * np.fft.rfftfreq(len(reference), SAMPLE_TIME_S)
    late = np.fft.irfft(amplitudes * np.exp(-1j * omega * target.delay_s), len(reference))
    played = np.tile(late, LAPS)
    times_s = np.arange(len(played)) * SAMPLE_TIME_S
    flown = np.zeros(len(played))
    for mode in target.modes:
        w = mode.omega_rad_s
        top = [mode.gain * mode.lead_s, mode.gain] if mode.lead_s else [mode.gain]
        flown += lsim((top, [1 / w**2, 2 * mode.damping / w, 1.0]), played, times_s)[1]
    away = flown[-len(wanted) :] - wanted
    return float(np.sqrt(np.mean(away**2)) / np.std(wanted))


def judged(family: str, sources: int, noise_m: float, seed: int, number: int) -> list[Judged]:
    """Study one fleet, and compare all its verdicts with simulated transfers."""
    rng = np.random.default_rng([seed, zlib.crc32(family.encode()), sources, number])
    fleet = random_fleet(family, sources, noise_m, rng)
    study = adaptive(fleet, rng)
    follow(study, fleet)
    wanted = random_trajectory(rng)
    spectrum = spectrum_of(wanted, SAMPLE_TIME_S)
    motion = DesiredMotion(
        "random", tuple(spectrum.omega_rad_s.tolist()), tuple(spectrum.power.tolist())
    )
    specs = {name: robot.spec for name, robot in fleet.robots.items()}
    there = StudyPlan("target", tuple(fleet.sources), BAND_RAD_S, 1, "x", motion)
    plans = [there, *(replace(there, target=s, sources=("target",)) for s in fleet.sources)]
    found = []
    for plan in plans:
        ranking = [SourceEstimate(source, 0.0, 0.0, 1.0, 0.0, 1) for source in plan.sources]
        verdicts = judge_transfers(plan, ranking, specs, study.responses, rng).verdicts
        for source, verdict in verdicts.items():
            loops = fleet.robots[source].loop, fleet.robots[plan.target].loop
            if not isinstance(loops[0], LinearLoop) or not isinstance(loops[1], LinearLoop):
                raise StudyError(f"{family} has no exact inverse to compare with")
            found.append(_compared(family, verdict, loops[0], loops[1], wanted))
    return found


def _compared(
    family: str,
    verdict: TransferVerdict,
    source: LinearLoop,
    target: LinearLoop,
    wanted: FloatArray,
) -> Judged:
    measured = tracking_error(target, through_inverse(source, wanted), wanted)
    expected = verdict.error_with
    return Judged(
        family=family,
        verdict=verdict.verdict,
        predicted=expected.median,
        within_bounds=expected.low <= measured <= expected.high,
        measured=measured,
        baseline=tracking_error(target, wanted, wanted),
    )


def row_of(family: str, verdicts: Sequence[Judged]) -> Row:
    """Summarise one family."""
    yes = [v for v in verdicts if v.verdict is Verdict.TRANSFER]
    no = [v for v in verdicts if v.verdict is Verdict.DO_NOT_TRANSFER]
    right = sum(v.helps for v in yes) + sum(not v.helps for v in no)
    return Row(
        family=family,
        verdicts=len(verdicts),
        given=len(yes) + len(no),
        right=right / max(len(yes) + len(no), 1),
        recommended=len(yes),
        harmful=sum(not v.helps for v in yes),
        worst_recommended=max((v.measured / v.baseline for v in yes), default=0.0),
        refused=len(no),
        refused_wrongly=sum(v.helps for v in no),
        error_off=float(np.median([abs(v.predicted / v.measured - 1) for v in verdicts])),
        within_bounds=float(np.mean([v.within_bounds for v in verdicts])),
    )


def table(rows: Sequence[Row]) -> Iterator[str]:
    """Yield the lines of the table."""
    yield (
        "family            verdicts  given   right  recommended  harmful  worst ratio  refused"
        "  wrongly  error off  in bounds"
    )
    for row in rows:
        yield (
            f"{row.family:<16} {row.verdicts:9d}  {row.given:5d}  {row.right:6.3f}"
            f"  {row.recommended:11d}  {row.harmful:7d}  {row.worst_recommended:11.3f}"
            f"  {row.refused:7d}  {row.refused_wrongly:7d}  {100 * row.error_off:7.2f} %"
            f"  {row.within_bounds:9.3f}"
        )


def main() -> None:
    """Parse the command line, run, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fleets", type=int, default=50, help="of each family")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--families", nargs="*", default=list(LINEAR), choices=list(LINEAR))
    parser.add_argument("--sources", type=int, default=5)
    parser.add_argument("--noise", default="high", choices=list(NOISE_LEVELS_M))
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    arguments = parser.parse_args()
    noise_m = NOISE_LEVELS_M[arguments.noise]
    rows = []
    with ProcessPoolExecutor(arguments.workers) as pool:
        for family in arguments.families:
            waiting = [
                pool.submit(judged, family, arguments.sources, noise_m, arguments.seed, number)
                for number in range(arguments.fleets)
            ]
            rows.append(row_of(family, [v for future in waiting for v in future.result()]))
    everything = f"{arguments.sources} sources, {arguments.noise} noise, {arguments.fleets} fleets"
    print(f"{everything} of each family", *table(rows), sep="\n")
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=2))


if __name__ == "__main__":
    main()
