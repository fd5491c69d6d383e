"""Processor time of short commands, of one installation or of two, in turn in the same run.

python -m benchmarks.start_up .venv/bin/nufleet [OTHER/bin/nufleet]
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import tempfile
from pathlib import Path

MODELS = {
    "first.json": {"num": [1], "den": [1, 2, 1], "dt": 0},
    "second.json": {"num": [1.1], "den": [1, 2.2, 1], "dt": 0},
}
COMMANDS = (("--help",), ("gap", *MODELS))


def processor_time_s(program: Path, arguments: tuple[str, ...], folder: Path) -> float:
    """Return the processor time in s that a command takes, of its system calls, too."""
    process = subprocess.Popen(
        [program, *arguments],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(f"{program} {' '.join(arguments)} failed")
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Measure, and print the median and the least time of each command."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("programs", nargs="+", type=Path, metavar="NUFLEET")
    parser.add_argument("--rounds", type=int, default=15)
    options = parser.parse_args()
    programs = [path.absolute() for path in options.programs]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for file, model in MODELS.items():
            (folder / file).write_text(json.dumps(model))
        for command in COMMANDS:
            found: dict[Path, list[float]] = {program: [] for program in programs}
            for _ in range(options.rounds):
                for program in programs:
                    found[program].append(processor_time_s(program, command, folder))
            medians = [statistics.median(times) for times in found.values()]
            for program, median in zip(programs, medians, strict=True):
                print(
                    f"{' '.join(command):24} {median:.3f} s (median), {min(found[program]):.3f} s "
                    f"(least), {median / medians[0]:.2f} x  {program}"
                )


if __name__ == "__main__":
    main()
