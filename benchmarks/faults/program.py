"""nufleet as processes that can be killed, frozen, cut off and restarted."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import psutil

from benchmarks.faults.namespaces import Namespace

PATIENCE_S = 120.0
"""Ends what hangs, and nothing else: what is waited for normally takes milliseconds."""

_ROOT = Path(__file__).parents[2]


class Program:
    """One command, started and ended as often as one likes; a context manager that ends it.

    It holds a pipe to this process and ends with it, however that ends.
    """

    def __init__(
        self,
        what: str,
        arguments: list[str],
        folder: Path,
        *,
        module: str = "nufleet",
        namespace: Namespace | None = None,
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """Prepare a process without starting it.

        Args:
            what: Name for messages and for the file in `folder` that keeps its output.
            arguments: Command-line arguments of the module.
            folder: Working directory, in which drivers may be installed.
            module: Name of the module to run.
            namespace: Network namespace of the process; None for that of this process.
            environment: Variables that are added to the environment of this process.
        """
        self.what = what
        self._arguments = [sys.executable, "-m", module, *arguments]
        self._folder, self._namespace = folder, namespace
        path = os.pathsep.join([str(folder), str(_ROOT), os.environ.get("PYTHONPATH", "")])
        # The networks of these processes are their own, so their fleets may be open.
        added = {"PYTHONPATH": path, "NUFLEET_OPEN": "1", **(environment or {})}
        self._environment = {**os.environ, **added}
        self._log = folder / f"{what.replace(' ', '-')}.log"
        self._said_before = 0
        self._process: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Program:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def start(self) -> None:
        """Start it; it must not run."""
        if self._process is not None:
            raise RuntimeError(f"{self.what} runs already")
        if self._namespace is None:
            self._popen()
        else:
            # A thread's children see the network that it sees; the other threads keep theirs.
            with ThreadPoolExecutor(1) as pool:
                pool.submit(self._namespace.enter).result()
                pool.submit(self._popen).result()

    @property
    def pid(self) -> int:
        """Process id of the running process."""
        if self._process is None:
            raise RuntimeError(f"{self.what} does not run")
        return self._process.pid

    @property
    def running(self) -> bool:
        """Whether it runs; False also when it ended by itself."""
        return self._process is not None and self._process.poll() is None

    @property
    def said(self) -> str:
        """All that it printed, in all its lives."""
        return self._log.read_text(errors="replace") if self._log.exists() else ""

    def wait_for(self, words: str) -> None:
        """Wait until it has printed something in its present life."""
        wait_until(lambda: words in self.said[self._said_before :] or not self.running)
        if words not in self.said[self._said_before :]:
            raise AssertionError(f"{self.what} ended: {self.said[-2000:]}")

    def kill(self) -> None:
        """End it at once, as a crash or a power cut would."""
        self._signal(signal.SIGKILL)
        self._buried()

    def freeze(self) -> None:
        """Let it do nothing until it is thawed."""
        self._signal(signal.SIGSTOP)
        # The kernel stops its threads one after the other.
        wait_until(lambda: psutil.Process(self.pid).status() == psutil.STATUS_STOPPED)

    def thaw(self) -> None:
        """Let it continue."""
        self._signal(signal.SIGCONT)

    def interrupt(self) -> None:
        """Press Ctrl-C."""
        self._signal(signal.SIGINT)

    def wait(self) -> int:
        """Wait until it ends by itself; return its exit code."""
        if self._process is None:
            raise RuntimeError(f"{self.what} does not run")
        code = self._process.wait(PATIENCE_S)
        self._buried()
        return code

    def end(self) -> None:
        """Tell the process to end, and make sure that it does."""
        if self._process is None:
            return
        self.thaw()
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            self.kill()
            raise AssertionError(f"{self.what} did not end: {self.said[-2000:]}") from None
        self._buried()

    def _popen(self) -> None:
        self._said_before = len(self.said)
        with self._log.open("ab") as log:
            self._process = subprocess.Popen(
                self._arguments,
                cwd=self._folder,
                env=self._environment,
                stdin=subprocess.PIPE,
                stdout=log,
                stderr=subprocess.STDOUT,
                start_new_session=True,
            )

    def _signal(self, number: signal.Signals) -> None:
        if self._process is not None:
            self._process.send_signal(number)

    def _buried(self) -> None:
        if self._process is not None:
            if self._process.stdin is not None:
                self._process.stdin.close()
            self._process.wait(PATIENCE_S)
            self._process = None


def wait_until(condition: Callable[[], bool], *, timeout_s: float = PATIENCE_S) -> float:
    """Return when a condition holds, with the seconds that it took; raise AssertionError if never.

    The time is good to a millisecond or so.
    """
    began_s = time.monotonic()
    while not condition():
        if time.monotonic() - began_s > timeout_s:
            raise AssertionError(f"it did not happen within {timeout_s:g} s")
        time.sleep(0.001)
    return time.monotonic() - began_s
