"""Serves the page that shows a recording or a live study in a browser."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import tempfile
import time
from types import TracebackType
from typing import IO
from urllib.parse import quote

from orchestrator.viewer.endpoint import claim_port, host_in_url, reachable
from orchestrator.viewer.rerun_program import rerun_environment, rerun_program
from shared.errors import EndpointInUseError

START_TIMEOUT_S = 20.0
END_TIMEOUT_S = 5.0
HOSTING = "Hosting a web-viewer"
"""What the program prints once it listens."""

log = logging.getLogger(__name__)


class WebPage:
    """The web viewer, as a process of its own, which ends with this one; a context manager.

    Rerun can also host it in our process, but then only on every network interface.
    """

    def __init__(self, source: str, *, bind_ip: str, port: int) -> None:
        self._source = source
        self._bind_ip = bind_ip
        self._port = port
        self._data_url = source
        self._process: subprocess.Popen[bytes] | None = None
        self._output: IO[bytes] | None = None

    @property
    def url(self) -> str:
        """The page, showing the recording or the study."""
        # As in a notebook the page sends no usage statistics, and it keeps no layout of old runs.
        options = f"url={quote(self._data_url, safe='')}&notebook=true&persist=false"
        return f"{self._origin}/?{options}"

    @property
    def _origin(self) -> str:
        return f"http://{host_in_url(reachable(self._bind_ip))}:{self._port}"

    def open(self) -> None:
        """Start serving; returns when the page is there. Raises EndpointInUseError."""
        self._port = claim_port(self._bind_ip, self._port)
        command = [
            *(sys.executable, "-m", "orchestrator.viewer.tethered", str(rerun_program())),
            *("--serve-web", self._source, "--bind", self._bind_ip),
            *("--web-viewer-port", str(self._port)),
        ]
        if "://" not in self._source:
            data_port = claim_port(self._bind_ip, 0)
            self._data_url = live_url(self._bind_ip, data_port)
            command += ["--port", str(data_port), "--cors-allow-origin", self._origin]
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - closed in close
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=self._output,
            stderr=subprocess.STDOUT,
            env=rerun_environment(),
        )
        deadline = time.monotonic() + START_TIMEOUT_S
        while HOSTING not in (said := self._said()):
            if self._process.poll() is not None or time.monotonic() > deadline:
                self.close()
                raise EndpointInUseError(
                    f"the viewer's web page did not start on {self._bind_ip}:{self._port}: {said}"
                )
            time.sleep(0.02)

    def wait(self) -> None:
        """Wait until somebody ends the page's process."""
        if self._process is not None:
            self._process.wait()

    def close(self) -> None:
        """Stop serving. Calling it twice does nothing more."""
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()
            try:
                self._process.wait(END_TIMEOUT_S)
            except subprocess.TimeoutExpired:
                log.warning("the viewer's web page did not end; killing it")
                self._process.kill()
                self._process.wait()
            self._process = None
        if self._output is not None:
            self._output.close()
            self._output = None

    def __enter__(self) -> WebPage:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _said(self) -> str:
        if self._output is None:
            return ""
        # The process writes at the same file offset, so it is read without moving that.
        return os.pread(self._output.fileno(), 4000, 0).decode(errors="replace").strip()


def live_url(bind_ip: str, port: int) -> str:
    """Return what a viewer on this machine connects to."""
    return f"rerun+http://{host_in_url(reachable(bind_ip))}:{port}/proxy"
