"""Runs Rerun's server, and serves its page, for as long as standard input stays open.

Rerun does not watch its parent process: without this wrapper it would outlive a parent that dies.
"""

from __future__ import annotations

import argparse
import subprocess
import sys

from nufleet.orchestrator.viewer.server.page import serve_page
from nufleet.shared.lifeline import when_stdin_closes

GRACE_S = 1.0
"""Time that the command has to end after SIGTERM before it is killed."""


def main(arguments: list[str]) -> int:
    """Run the command that follows the options until it ends, and return its exit code."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--bind", required=True)
    parser.add_argument("--page", type=int, help="serve the web viewer's page on this port")
    parser.add_argument("--upstream", type=int, help="where the web viewer itself listens")
    parser.add_argument("--data", type=int, help="the only other port the page may connect to")
    parser.add_argument("command", nargs="+")
    options = parser.parse_args(arguments)
    if options.page is not None:
        serve_page(
            options.bind,
            options.page,
            upstream_port=options.upstream,
            data_port=options.data,
        )
    with subprocess.Popen(options.command, stdin=subprocess.DEVNULL) as process:

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
