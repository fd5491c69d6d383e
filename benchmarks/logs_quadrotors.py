"""The simulated quadrotors, ranked by one flight log each: ψ* beside its true value.

    SCIPY_ARRAY_API=1 python -m benchmarks.logs_quadrotors --seconds 25

Every quadrotor flies one drawing with its baseline controller and its measurement noise. The truth
is what tests without noise gave, as the fleet file `paper_quadrotors` says.
"""

from __future__ import annotations

import argparse
import os

import numpy as np

from benchmarks.logs import GRID_POINTS, SAMPLES
from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.orchestrator.flights.legs import trajectory
from nufleet.orchestrator.study.selection_belief import SelectionBelief
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.record_response import Stretch, estimate_record_response
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.paths.installed import find_drawing
from nufleet.shared.robots.drivers import load_driver, needed_environment
from nufleet.shared.robots.fleet_file import find_fleet_file, read_fleet_file, validated_settings
from nufleet.shared.robots.spec import RobotSpec

TRUTH = {
    "source-1": 0.115,
    "source-2": 0.188,
    "source-3": 0.313,
    "source-4": 0.164,
    "source-5": 0.697,
}


def main() -> None:
    """Fly, estimate, rank, print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--drawing", default="shell")
    parser.add_argument("--speed", type=float, default=0.6, help="in m/s")
    parser.add_argument("--seconds", type=float, default=25.0)
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    fleet = find_fleet_file("paper_quadrotors")
    file = read_fleet_file(fleet)
    # Some libraries read it when they are first imported; an agent gets it from its launcher.
    os.environ.update(needed_environment(file, file.robots))
    driver = load_driver("quadrotor")
    robots = driver.build(
        {
            name: validated_settings(driver.settings, fleet, name, entry.settings)
            for name, entry in file.robots.items()
        },
        np.random.default_rng(arguments.seed),
    )
    points = read_drawing(find_drawing(arguments.drawing))
    band = (0.1, 5.4) if file.study is None else file.study.band_rad_s
    grid, rng = np.linspace(*band, GRID_POINTS), np.random.default_rng(arguments.seed)
    draws = {}
    for name, robot in robots.items():
        robot.connect()
        path = _flown(trajectory(points, arguments.speed, robot.spec, name), arguments, robot.spec)
        output = robot.run(path)
        record = estimate_record_response(
            [Stretch(path[:, 0], output[:, 0])],
            robot.spec.sample_time_s,
            band,
            robot.spec.settling_time_s,
        )
        response = record.response
        print(
            f"{name}: {record.duration_s:.1f} s, {len(response.z)} frequencies, {response.quality}"
        )
        known = RobotKnowledge(name, robot.spec, band[1])
        known.learn(response, rng)
        draws[name] = known.model.draw(grid, SAMPLES, rng)
    belief = SelectionBelief.of(grid, draws.pop("target"), draws)
    leader, confidence = belief.leader(0.01, 0.05)
    print(f"load {os.getloadavg()[0]:.1f}; selects {leader} with confidence {confidence:.3f}")
    print("source      psi*   std    truth  deviations")
    for source, psi in zip(belief.sources, belief.psi_star, strict=True):
        mean, std = float(psi.mean()), float(psi.std())
        away = (mean - TRUTH[source]) / std
        print(f"{source:<10} {mean:.3f}  {std:.3f}  {TRUTH[source]:.3f}  {away:+.1f}")


def _flown(path: FloatArray, arguments: argparse.Namespace, spec: RobotSpec) -> FloatArray:
    """Return a path flown back and forth for exactly this time."""
    both = np.concatenate([path, path[::-1]])
    samples = round(arguments.seconds / spec.sample_time_s)
    return np.asarray(np.tile(both, (-(-samples // len(both)), 1))[:samples])


if __name__ == "__main__":
    main()
