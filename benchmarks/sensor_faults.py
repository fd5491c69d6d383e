"""What a faulty sensor does to an estimate that is accepted: how often, and how far off it is.

Every fault of `nufleet.sims.faults` that a sensor can have, at several intensities, on the target
of Section V, whose response is known in closed form. A test that is refused does no harm; one that
is accepted must hold the truth in its disc, whose radius is for 5 % of misses.

    python -m benchmarks.sensor_faults --seeds 100
    python -m benchmarks.sensor_faults --kind spikes --noise 0.01
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.robot_agent.robot import Robot
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings, closed_loop
from nufleet.sims.faults import Fault
from nufleet.sims.faulty_robot import FaultyRobot

TONES = {
    "1 tone": (3.0,),
    "5 tones": (0.5, 1.0, 2.0, 4.0, 8.0),
}
SEGMENTS = 4
HARMLESS_CHORDAL = 1e-3
"""A bias below this changes no ranking; the estimator reports a change of z from here on too."""

MISSES_EXPECTED = 0.05
INVISIBLE = ("late", "always 3")
"""Faults that cannot be seen: a constant delay of the sensor looks like a slower robot."""

ONE_FAULT: TypeAdapter[Fault] = TypeAdapter(Fault)


@dataclass(frozen=True)
class Case:
    """One fault at one intensity. Lengths are shares of the largest output without noise."""

    kind: str
    intensity: str
    fault: dict[str, Any]
    scaled: tuple[str, ...] = ()

    def at(self, scale: float) -> Fault:
        """Return the fault for an output of this size."""
        lengths = {name: scale * self.fault[name] for name in self.scaled}
        return ONE_FAULT.validate_json(json.dumps({**self.fault, **lengths}))


def cases(measured_from: int, measured: int) -> Iterator[Case]:
    """Yield every case for a test that measures `measured` samples from `measured_from` on."""
    yield Case("none", "", {"kind": "noisy", "std": 0.0})
    for std in (0.03, 0.3, 1.0):
        yield Case("noisy", f"{std:g}", {"kind": "noisy", "std": std}, ("std",))
    yield from frozen_cases(measured_from + measured // 3, measured)
    yield from saturated_cases()
    yield from spike_cases()
    yield from late_cases(measured_from, measured)
    for probability, run in product((0.001, 0.01, 0.1, 0.3), (1, 5, 20)):
        held = {"kind": "held", "probability": probability, "run": run}
        yield Case("held", f"{100 * probability:g} % of {run}", held)


def frozen_cases(begins: int, measured: int) -> Iterator[Case]:
    """Yield sensors that stay where they are for a while, exactly or with noise."""
    for share, noise in product((0.01, 0.03, 0.1, 0.5), (0.0, 0.01)):
        length = max(1, round(share * measured))
        fault = {"kind": "frozen", "from_sample": begins, "samples": length, "noise": noise}
        label = f"{100 * share:g} %" + (" + noise" if noise else "")
        yield Case("frozen", label, fault, ("noise",))


def saturated_cases() -> Iterator[Case]:
    """Yield sensors whose range ends on both sides or on one."""
    for bound in (0.99, 0.95, 0.9, 0.7, 0.4):
        both = {"kind": "saturated", "low": -bound, "high": bound}
        yield Case("saturated", f"±{bound:g}", both, ("low", "high"))
        above = {"kind": "saturated", "low": -9.0, "high": bound}
        yield Case("saturated", f"above {bound:g}", above, ("low", "high"))


def spike_cases() -> Iterator[Case]:
    """Yield spikes on top of the output, and such that take its place."""
    for probability, height in product((0.001, 0.01, 0.1), (0.3, 3.0, 100.0)):
        spikes = {"kind": "spikes", "probability": probability, "height": height}
        yield Case("spikes", f"{100 * probability:g} % of ±{height:g}", spikes, ("height",))
    for probability, level in product((0.001, 0.01, 0.1, 0.3), (0.0, 1.0)):
        replaced = {
            "kind": "spikes",
            "probability": probability,
            "height": level,
            "replace": True,
        }
        yield Case("spikes", f"{100 * probability:g} % read {level:g}", replaced, ("height",))


def late_cases(measured_from: int, measured: int) -> Iterator[Case]:
    """Yield delays that vary, that begin during the test, and one that is always there."""
    for most in (1, 2, 4, 8, 20):
        yield Case("late", f"0 to {most}", {"kind": "late", "late_max": most})
    constant = {"kind": "late", "late_min": 3, "late_max": 3}
    for begins in (0.3, 0.6):
        fault = {**constant, "from_sample": measured_from + round(begins * measured)}
        yield Case("late", f"3 from {100 * begins:g} % on", fault)
    yield Case(*INVISIBLE, constant)


@dataclass(frozen=True)
class Found:
    """What became of one case over all seeds.

    `missed` is the share of tones of usable tests whose disc misses the truth; `error` the median
    over usable tests of their largest chordal error.
    """

    case: Case
    tones: str
    noise: float
    usable: float
    missed: float
    error: float
    reasons: tuple[tuple[str, int], ...]
    warnings: tuple[tuple[str, int], ...]

    @property
    def is_hole(self) -> bool:
        """Whether accepted estimates are wrong by more than they say and by more than nothing."""
        if (self.case.kind, self.case.intensity) == INVISIBLE:
            return False
        return (
            self.usable > 0
            and self.missed > 3 * MISSES_EXPECTED
            and (self.error > HARMLESS_CHORDAL)
        )


def measure(seeds: int, noise: float, name: str, kind: str | None) -> Iterator[Found]:
    """Yield what becomes of every case at one level of noise, a share of the output."""
    omegas = TONES[name]
    excitation = Excitation(
        axis="x",
        tones=tuple(
            Tone(omega_rad_s=omega, phase_rad=np.pi * k**2 / len(omegas))
            for k, omega in enumerate(omegas)
        ),
        segments=SEGMENTS,
    )
    quiet = DoubleIntegrator(settings(0.0), np.random.default_rng(0))
    plan = plan_excitation(excitation, quiet.spec, "target")
    reference = reference_of(plan)
    quiet.connect()
    scale = float(np.max(np.abs(quiet.run(reference[:, np.newaxis]))))
    truth = closed_loop(settings(0.0)).frequency_response(np.array(omegas))
    for case in cases(plan.first_measured_sample, plan.segments * plan.segment_samples):
        if kind not in (None, case.kind):
            continue
        estimates = []
        for seed in range(seeds):
            rng = np.random.default_rng([seed, 17])
            inside: Robot = DoubleIntegrator(settings(noise * scale), rng)
            robot = FaultyRobot(inside, (case.at(scale),), np.random.default_rng([seed, 18]))
            robot.connect()
            response = robot.run(reference[:, np.newaxis])[:, 0]
            estimates.append(estimate_frequency_response(reference, response, plan))
        yield judged(case, name, noise, truth, estimates)


def judged(
    case: Case, tones: str, noise: float, truth: np.ndarray, estimates: list[FrequencyResponse]
) -> Found:
    """Compare the estimates that were accepted with the truth."""
    usable = [estimate for estimate in estimates if estimate.quality.usable]
    misses = [np.mean(np.abs(e.z - truth) > e.radius(MISSES_EXPECTED)) for e in usable]
    errors = [np.max(chordal_distance(e.z, truth)) for e in usable]
    reasons = Counter(f.code for e in estimates for f in e.quality.reasons)
    warnings = Counter(f.code for e in usable for f in e.quality.warnings)
    return Found(
        case=case,
        tones=tones,
        noise=noise,
        usable=len(usable) / len(estimates),
        missed=float(np.mean(misses)) if misses else 0.0,
        error=float(np.median(errors)) if errors else 0.0,
        reasons=tuple(reasons.most_common(3)),
        warnings=tuple(warnings.most_common(2)),
    )


def settings(noise_std_m: float) -> DoubleIntegratorSettings:
    """Return the target of Section V with measurement noise."""
    return DoubleIntegratorSettings(alpha=0.85, beta=0.003, noise_std_m=noise_std_m)


def main() -> None:
    """Parse the command line and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=40)
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0, 0.001, 0.01])
    parser.add_argument("--kind", help="only this kind of fault")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    arguments = parser.parse_args()
    print("noise    tones    fault       intensity          usable  missed  error   codes")
    rows, holes = [], 0
    for noise in arguments.noise:
        for name in TONES:
            for found in measure(arguments.seeds, noise, name, arguments.kind):
                codes = ", ".join(f"{code} {count}" for code, count in found.reasons)
                codes += "".join(f" ({code} {count})" for code, count in found.warnings)
                holes += found.is_hole
                print(
                    f"{noise:<8g} {name:8} {found.case.kind:11} {found.case.intensity:18} "
                    f"{100 * found.usable:5.0f} % {100 * found.missed:5.0f} % {found.error:8.1e} "
                    f"{'HOLE ' if found.is_hole else ''}{codes}",
                    flush=True,
                )
                rows.append(
                    {
                        "noise": noise,
                        "tones": name,
                        "kind": found.case.kind,
                        "intensity": found.case.intensity,
                        "usable": found.usable,
                        "missed": found.missed,
                        "chordal_error": found.error,
                        "is_hole": found.is_hole,
                    }
                )
    print(f"{holes} of {len(rows)} cases are accepted and wrong by more than they claim")
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=2))


if __name__ == "__main__":
    main()
