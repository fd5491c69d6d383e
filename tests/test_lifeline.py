"""A test run that is killed outright leaves nothing behind."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import psutil
from polling import wait_until

RUN = """
import json, subprocess, sys, time
from lifeline import Lifeline

obedient = "import time; print(1, flush=True); time.sleep(600)"
stubborn = f"import signal; signal.signal(signal.SIGTERM, signal.SIG_IGN); {obedient}"
run = Lifeline(grace_s=0.5)
(run.folder / "file").write_text("left behind")
left = []
for program in (obedient, stubborn):
    command = [sys.executable, "-c", program]
    left.append(subprocess.Popen(command, stdout=subprocess.PIPE, start_new_session=True))
    left[-1].stdout.readline()
pids = [process.pid for process in left]
print(json.dumps({"folder": str(run.folder), "pids": pids}), flush=True)
time.sleep(600)
"""


def test_a_run_that_is_killed_leaves_no_process_and_no_file() -> None:
    others = subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE)
    run = subprocess.Popen(
        [sys.executable, "-c", RUN], stdout=subprocess.PIPE, cwd=Path(__file__).parent
    )
    with others, run:
        assert run.stdout is not None
        said = json.loads(run.stdout.readline())
        folder, pids = Path(said["folder"]), said["pids"]
        assert folder.is_dir()
        assert all(psutil.pid_exists(pid) for pid in pids)
        run.kill()
        wait_until(lambda: not any(psutil.pid_exists(pid) for pid in pids))
        wait_until(lambda: not folder.exists())
        # A process that another run started continues.
        assert others.poll() is None
        others.communicate(b"\n")
