"""Processor time of commands, of one installation or of two, in turn in the same run.

Of a ranking, that of its robots and of the router is part, and what all of them spend on loading
modules is told apart; the rest is its own computing.

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
RANK = ("rank", "--fleet", "paper_linear")
COMMANDS = (("--help",), ("gap", *MODELS), RANK, ("runs", "list"))

LOADING = "loading.txt"
HOOK = f"""
import builtins, importlib, os, threading, time

inside = threading.local()
began_s = time.process_time()


def note(spent_s):
    with open(os.path.join(os.path.dirname(__file__), {LOADING!r}), "a") as file:
        file.write(f"{{spent_s}}\\n")


def timed(load):
    def loading(*args, **kwargs):
        if getattr(inside, "one", False):
            return load(*args, **kwargs)
        inside.one, from_s = True, time.thread_time()
        try:
            return load(*args, **kwargs)
        finally:
            inside.one, spent_s = False, time.thread_time() - from_s
            if spent_s > 5e-4:
                note(spent_s)

    return loading


note(began_s)
builtins.__import__ = timed(builtins.__import__)
importlib.import_module = timed(importlib.import_module)
"""
"""Module that Python imports first: it notes how long each further import takes, in s, and how
long Python took until then. It notes at once, since a process may be killed."""


def processor_time_s(
    program: Path, arguments: tuple[str, ...], folder: Path, hooks: Path | None = None
) -> float:
    """Return the processor time in s of a command, of the processes that it starts, too.

    Args:
        program: Path of `nufleet`.
        arguments: Arguments of the command.
        folder: Folder in which it runs.
        hooks: Folder of modules that Python finds first; None for none.
    """
    process = subprocess.Popen(
        [program, *arguments],
        cwd=folder,
        env=os.environ if hooks is None else {**os.environ, "PYTHONPATH": str(hooks)},
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    _, status, used = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode != 0:
        raise SystemExit(f"{program} {' '.join(arguments)} failed")
    return used.ru_utime + used.ru_stime


def print_own_computing(program: Path, folder: Path) -> None:
    """Print how long a ranking takes, and as how much of its own computing."""
    with tempfile.TemporaryDirectory() as name:
        hooks = Path(name)
        (hooks / "sitecustomize.py").write_text(HOOK)
        whole_s = processor_time_s(program, RANK, folder, hooks)
        loading_s = sum(map(float, (hooks / LOADING).read_text().split()))
    own_s = whole_s - loading_s
    print(
        f"{' '.join(RANK)}: {whole_s:.2f} s, of which {loading_s:.2f} s load modules: "
        f"{whole_s / own_s:.2f} x its own computing  {program}"
    )


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
                    f"{' '.join(command):26} {median:.3f} s (median), {min(found[program]):.3f} s "
                    f"(least), {median / medians[0]:.2f} x  {program}"
                )
        for program in programs:
            print_own_computing(program, folder)


if __name__ == "__main__":
    main()
