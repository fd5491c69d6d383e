"""Section V of the paper over many seeds: is the selection right, how far off are the estimates?

Every test is a real one: planned under the robot's limits, played on the simulated robot sample by
sample, and estimated from the samples. Only the network is left out.

    python -m benchmarks.section_v --seeds 50
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from nufleet.orchestrator.study.interface import Report, StudyPlan
from nufleet.orchestrator.study.paper_algorithm import PaperStudy
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.arrays import FloatArray
from nufleet.shared.distance.chordal import worst_case_chordal_distance
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings

PARAMETERS = {
    "target": (0.85, 0.003),
    "source-1": (1.0, 0.003),
    "source-2": (0.97, 0.004),
    "source-3": (0.9, 0.001),
}
PAPER = {"source-1": 0.069, "source-2": 0.017, "source-3": 0.087}
BAND_RAD_S = (0.05, 10.0)


def test_robot(
    robot: DoubleIntegrator, omega_rad_s: float, noise: float, rng: np.random.Generator
) -> FrequencyResponse:
    """Play one sinusoid; `noise` is white, on y, as a share of the reference's amplitude."""
    excitation = Excitation(axis="x", tones=(Tone(omega_rad_s=omega_rad_s),), segment_min_s=2.0)
    plan = plan_excitation(excitation, robot.spec, "benchmark")
    reference = reference_of(plan)
    robot.connect()
    response = robot.run(reference[:, None])[:, 0]
    robot.disconnect()
    noisy = response + noise * plan.amplitude * rng.standard_normal(len(response))
    return estimate_frequency_response(reference, noisy, plan)


def run(seed: int, iterations: int, noise: float) -> list[Report]:
    """Run one study and return its reports."""
    rng = np.random.default_rng(seed)
    robots = {
        name: DoubleIntegrator(DoubleIntegratorSettings(alpha=alpha, beta=beta), rng)
        for name, (alpha, beta) in PARAMETERS.items()
    }
    sources = tuple(name for name in robots if name != "target")
    study = PaperStudy(StudyPlan("target", sources, BAND_RAD_S, iterations, "x"), rng)
    reports = []
    while (question := study.ask()) is not None:
        (omega,) = question.omega_rad_s
        responses = {name: test_robot(robots[name], omega, noise, rng) for name in question.robots}
        bad = {n: r.quality.reasons for n, r in responses.items() if not r.quality.usable}
        if bad:
            raise SystemExit(f"seed {seed}: an unusable test: {bad}")
        reports.append(study.tell(responses, {}))
    return reports


def closed_form() -> dict[str, float]:
    """Return each source's true worst-case chordal distance."""
    models = {
        name: DoubleIntegrator(
            DoubleIntegratorSettings(alpha=alpha, beta=beta), np.random.default_rng(0)
        )
        .spec.axes[0]
        .model
        for name, (alpha, beta) in PARAMETERS.items()
    }
    target = models.pop("target")
    return {
        name: worst_case_chordal_distance(target, model, BAND_RAD_S)[0]
        for name, model in models.items()
        if target is not None and model is not None
    }


def table(seeds: int, iterations: int, noise: float) -> dict[str, object]:
    """Run all seeds at one noise level; print and return what came out."""
    truth = closed_form()
    estimates: dict[str, list[float]] = {name: [] for name in truth}
    right = np.zeros((seeds, iterations), dtype=bool)
    for seed in range(seeds):
        reports = run(seed, iterations, noise)
        best = min(truth, key=lambda name: truth[name])
        right[seed] = [report.selected == best for report in reports]
        for estimate in reports[-1].ranking:
            estimates[estimate.robot].append(estimate.psi)
    print(f"\nnoise {100 * noise:g} % of the amplitude, {seeds} seeds, {iterations} iterations")
    print("  right source, by iteration: " + " ".join(f"{100 * s:.0f}%" for s in right.mean(0)))
    print("  source     closed form   paper   median   5 %..95 %         median |err|  worst |err|")
    rows: dict[str, object] = {}
    for name, exact in truth.items():
        found: FloatArray = np.array(estimates[name])
        error = np.abs(found / exact - 1)
        low, high = np.quantile(found, [0.05, 0.95])
        print(
            f"  {name:<10} {exact:10.4f}   {PAPER[name]:.3f}   {np.median(found):.4f}   "
            f"{low:.4f}..{high:.4f}   {100 * np.median(error):9.2f} %  {100 * error.max():9.2f} %"
        )
        rows[name] = {"closed_form": exact, "estimates": found.tolist()}
    return {
        "noise": noise,
        "seeds": seeds,
        "right_by_iteration": right.mean(0).tolist(),
        "sources": rows,
    }


def main() -> None:
    """Parse the command line and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seeds", type=int, default=50)
    parser.add_argument("--iterations", type=int, default=7)
    parser.add_argument("--noise", type=float, nargs="*", default=[0.0, 0.01])
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    arguments = parser.parse_args()
    tables = [table(arguments.seeds, arguments.iterations, noise) for noise in arguments.noise]
    if arguments.json:
        arguments.json.write_text(json.dumps(tables, indent=2))


if __name__ == "__main__":
    main()
