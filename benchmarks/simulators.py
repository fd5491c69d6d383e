"""The time that third-party simulators take for a minute of a robot's time.

python -m benchmarks.simulators
"""

from __future__ import annotations

import argparse
import os
import time

import numpy as np

from benchmarks.faults.figure import Figure
from nufleet.shared.robots.drivers import load_driver, needed_environment
from nufleet.shared.robots.fleet_file import find_fleet_file, read_fleet_file, validated_settings

MINUTE_S = 60.0
MINUTE_MAX_S = 1.0
FLEETS = ("paper_quadrotors", "arms")


def main() -> None:
    """Have one robot of each fleet follow a sinusoid for a minute, some times; print the worst."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--times", type=int, default=5)
    arguments = parser.parse_args()
    print(f"{os.cpu_count()} cores, load {os.getloadavg()[0]:.1f}")
    figures = [_minute(fleet, arguments.times) for fleet in FLEETS]
    for figure in figures:
        print(figure)
    raise SystemExit(1 if any(figure.holds is False for figure in figures) else 0)


def _minute(fleet: str, times: int) -> Figure:
    path = find_fleet_file(fleet)
    file = read_fleet_file(path)
    # Some libraries read it when they are first imported; an agent gets it from its launcher.
    os.environ.update(needed_environment(file, file.robots))
    name, entry = next(iter(file.robots.items()))
    driver = load_driver(entry.driver)
    settings = validated_settings(driver.settings, path, name, entry.settings)
    robot = driver.build({name: settings}, np.random.default_rng(0))[name]
    robot.connect()
    spec = robot.spec
    times_s = np.arange(0.0, MINUTE_S, spec.sample_time_s)
    references = np.zeros((len(times_s), len(spec.axes)))
    references[:, 0] = 0.2 * np.sin(2.0 * times_s)
    took_s = []
    for _ in range(times):
        began_s = time.perf_counter()
        robot.run(references)
        took_s.append(time.perf_counter() - began_s)
        robot.rest()
    return Figure(
        f"a minute of {name} of {fleet} (worst)",
        max(took_s),
        "s",
        MINUTE_MAX_S,
        {"median": f"{float(np.median(took_s)):.2g} s", "times": times},
    )


if __name__ == "__main__":
    main()
