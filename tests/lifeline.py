"""Ends what a test run started and did not end, because it was killed outright.

Every process that a test starts inherits an environment variable that names the run's folder. A
process beside the run holds the other end of a pipe; when the run is gone, however it went, that
process ends all who name the folder, and removes the folder.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import suppress
from pathlib import Path

import psutil

RUN = "NUFLEET_TEST_RUN"


class Lifeline:
    """Begins a run, which lasts as long as this process; `folder` is where it may leave things.

    What is left of it afterwards has `grace_s` to end by itself before it is killed.
    """

    def __init__(self, grace_s: float = 10.0) -> None:
        self.folder = Path(tempfile.mkdtemp(prefix="nufleet-tests-"))
        self.folder.chmod(0o711)  # a server of the tests' runs as another user
        # It belongs to no run: a worker of pytest-xdist is itself what another run started.
        environment = {name: value for name, value in os.environ.items() if name != RUN}
        self._process = subprocess.Popen(
            [sys.executable, __file__, self.folder, str(grace_s)],
            env=environment,
            stdin=subprocess.PIPE,
            start_new_session=True,
        )
        os.environ[RUN] = str(self.folder)


def started_with(variable: str, value: str) -> list[psutil.Process]:
    """Return the processes that live and inherited an environment variable of this value."""
    found = []
    for process in psutil.process_iter():
        with suppress(psutil.Error):  # it has ended, or belongs to another user
            if process.environ().get(variable) == value:
                found.append(process)
    return found


def main() -> None:
    """Wait for the end of a run, and clear up."""
    folder, grace_s = sys.argv[1], float(sys.argv[2])
    sys.stdin.read()
    for process in (left := started_with(RUN, folder)):
        with suppress(psutil.NoSuchProcess):
            process.terminate()
    psutil.wait_procs(left, timeout=grace_s)
    while left := started_with(RUN, folder):
        for process in left:
            with suppress(psutil.NoSuchProcess):
                process.kill()
        psutil.wait_procs(left, timeout=grace_s)
    shutil.rmtree(folder, ignore_errors=True)


if __name__ == "__main__":
    main()
