"""Runs a command for as long as standard input stays open: `python -m …tethered COMMAND…`.

For programs that know nothing of their parent: when it dies, however it dies, they end.
"""

from __future__ import annotations

import subprocess
import sys

from shared.lifeline import when_stdin_closes

GRACE_S = 1.0


def main(command: list[str]) -> int:
    """Run the command to its end; returns its exit code."""
    with subprocess.Popen(command, stdin=subprocess.DEVNULL) as process:

        def end() -> None:
            process.terminate()
            try:
                process.wait(GRACE_S)
            except subprocess.TimeoutExpired:
                process.kill()

        when_stdin_closes(end)
        return process.wait()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
