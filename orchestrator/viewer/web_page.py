"""Serves the page that shows a live study in a browser."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import tempfile
import time
from typing import IO
from urllib.parse import quote

from orchestrator.viewer.endpoint import claim_port
from orchestrator.viewer.rerun_program import rerun_environment, rerun_program
from shared.errors import EndpointInUseError

START_TIMEOUT_S = 20.0
END_TIMEOUT_S = 3.0
HOSTING = "Hosting a web-viewer"
"""What the program prints once it listens."""

log = logging.getLogger(__name__)


class WebPage:
    """The web viewer, as a process of its own, which ends with this one.

    Rerun can also host it in our process, but then only on every network interface.
    """

    def __init__(self, live_url: str, *, bind_ip: str, port: int) -> None:
        self._live_url = live_url
        self._bind_ip = bind_ip
        self._port = port
        self._process: subprocess.Popen[bytes] | None = None
        self._output: IO[bytes] | None = None

    @property
    def url(self) -> str:
        """The page, showing the study."""
        host = "127.0.0.1" if self._bind_ip == "0.0.0.0" else self._bind_ip  # noqa: S104
        # As in a notebook the page sends no usage statistics, and it keeps no layout of old runs.
        options = f"url={quote(self._live_url, safe='')}&notebook=true&persist=false"
        return f"http://{host}:{self._port}/?{options}"

    def open(self) -> None:
        """Start serving; returns when the page is there. Raises EndpointInUseError."""
        self._port = claim_port(self._bind_ip, self._port)
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - closed in close
        command = [
            *(sys.executable, "-m", "orchestrator.viewer.tethered", str(rerun_program())),
            *("--serve-web", self._live_url, "--bind", self._bind_ip),
            *("--web-viewer-port", str(self._port)),
        ]
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

    def _said(self) -> str:
        if self._output is None:
            return ""
        # The process writes at the same file offset, so it is read without moving that.
        return os.pread(self._output.fileno(), 4000, 0).decode(errors="replace").strip()
