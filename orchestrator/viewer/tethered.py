"""Runs a command for as long as standard input stays open: `python -m …tethered COMMAND…`.

For programs that know nothing of their parent: when it dies, however it dies, they end.
"""

from __future__ import annotations

import signal
import subprocess
import sys

from shared.lifeline import when_stdin_closes

GRACE_S = 1.0


def main(command: list[str]) -> int:
    """Run the command to its end; returns its exit code."""
    # The terminal's Ctrl-C is for the parent, which closes standard input when it is done.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with subprocess.Popen(command, stdin=subprocess.DEVNULL) as process:

        def end() -> None:
            process.terminate()
            try:
                process.wait(GRACE_S)
            except subprocess.TimeoutExpired:
                process.kill()

        signal.signal(signal.SIGTERM, lambda *_: process.terminate())
        when_stdin_closes(end)
        return process.wait()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
