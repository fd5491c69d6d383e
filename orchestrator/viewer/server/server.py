"""Rerun's server in a process of its own: the data for viewers, and the page for browsers."""

from __future__ import annotations

import logging
import os
import signal
import subprocess
import sys
import tempfile
import time
from typing import IO
from urllib.parse import quote, urlsplit

from nufleet.orchestrator.viewer.server.claims import claim_port, host_in_url, reachable
from nufleet.orchestrator.viewer.server.rerun_program import rerun_environment, rerun_program
from nufleet.shared.errors import EndpointInUseError
from nufleet.shared.interrupts import postponed

START_TIMEOUT_S = 20.0
END_TIMEOUT_S = 5.0

MEMORY = "256MB"
"""Limit on the history that the server keeps for viewers that connect late."""

# Messages that the program prints once it listens.
_SERVING = "Listening for gRPC connections"
_HOSTING = "Hosting a web-viewer"

log = logging.getLogger(__name__)


class ViewerServer:
    """Takes data from one writer, or from a recording, and serves it; a context manager.

    The server ends with this process, even when this process is killed. Rerun could also serve from
    within this process, but then a viewer that hangs would make the study's process keep all unread
    data, and the page would be served on every network interface.
    """

    def __init__(
        self, source: str | None = None, *, bind_ip: str, data_port: int = 0, web_port: int | None
    ) -> None:
        """Prepare a server.

        Args:
            source: Path of a recording, or URL of another server, for which only the page is
                served; None to serve the data that are written to `live_url`.
            bind_ip: Address of the network interface to listen on. Browsers must reach the page
                under this address, because no other page may read the data.
            data_port: Port that viewers connect to; 0 for any free one.
            web_port: Port of the page; 0 for any free one, None for no page.
        """
        self._source = source
        self._bind_ip = bind_ip
        self._data_port = data_port
        self._web_port = web_port
        self._process: subprocess.Popen[bytes] | None = None
        self._output: IO[bytes] | None = None

    @property
    def live_url(self) -> str:
        """URL that native viewers and the writer connect to."""
        if self._source is not None and "://" in self._source:
            return self._source
        return f"rerun+http://{self._host}:{self._data_port}/proxy"

    @property
    def web_url(self) -> str | None:
        """URL of the page for browsers; None when there is none."""
        if self._web_port is None:
            return None
        # The page shows this source alone, and does not restore the layout of earlier runs.
        options = "hide_welcome_screen=true&persist=false&theme=dark"
        return f"{self._origin}/?url={quote(self.live_url, safe='')}&{options}"

    @property
    def url(self) -> str:
        """URL to open: that of the page or, without a page, that for native viewers."""
        return self.web_url or self.live_url

    @property
    def alive(self) -> bool:
        """Whether the server is running."""
        return self._process is not None and self._process.poll() is None

    def open(self) -> None:
        """Start to serve, and return when viewers can connect; calling it again has no effect.

        Raises:
            EndpointInUseError: A port is in use, or may not be listened on.
        """
        if self._process is not None:
            return
        self._output = tempfile.TemporaryFile()  # noqa: SIM115 - closed in close
        command, expected = self._command()
        try:
            self._start(command)
            self._wait_until_it_says(expected)
        except BaseException:  # an interrupt as well
            self.close()
            raise

    def _start(self, command: list[str]) -> None:
        tethered = "nufleet.orchestrator.viewer.server.tethered"
        with postponed():
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", tethered, *command],
                stdin=subprocess.PIPE,
                stdout=self._output,
                stderr=subprocess.STDOUT,
                env={**rerun_environment(), "RUST_LOG": "info"},
                # A session of its own keeps the terminal's Ctrl-C away from the server, so that
                # viewers still see how the study ends.
                start_new_session=True,
            )

    def _wait_until_it_says(self, expected: list[str]) -> None:
        deadline = time.monotonic() + START_TIMEOUT_S
        while not all(phrase in (said := self._said()) for phrase in expected):
            if not self.alive or time.monotonic() > deadline:
                raise EndpointInUseError(f"the viewer cannot listen on {self._bind_ip}: {said}")
            time.sleep(0.01)

    def close(self, *, timeout_s: float = END_TIMEOUT_S) -> None:
        """Stop serving; calling it again has no effect."""
        if self._process is not None and self._process.stdin is not None:
            self._process.stdin.close()
            try:
                self._process.wait(timeout_s)
            except subprocess.TimeoutExpired:
                log.warning("the server of the viewer did not end; killing it")
                # With it the server itself, which would outlive it while it hangs.
                os.killpg(self._process.pid, signal.SIGKILL)
                self._process.wait()
        self._process = None
        if self._output is not None:
            self._output.close()
            self._output = None

    def __enter__(self) -> ViewerServer:
        self.open()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def _host(self) -> str:
        return host_in_url(reachable(self._bind_ip))

    @property
    def _origin(self) -> str:
        return f"http://{self._host}:{self._web_port}"

    def _command(self) -> tuple[list[str], list[str]]:
        """Return the arguments for `tethered`, and Rerun's messages once it serves."""
        options = ["--bind", self._bind_ip]
        command = [str(rerun_program()), "--bind", self._bind_ip]
        expected = []
        if self._web_port is not None:
            self._web_port = claim_port(self._bind_ip, self._web_port)
        if self._source is None or "://" not in self._source:
            claimed = [self._web_port]
            self._data_port = claim_port(self._bind_ip, self._data_port, apart_from=claimed)
            command += ["--port", str(self._data_port), "--server-memory-limit", MEMORY]
            if self._web_port is not None:
                # Other pages open in the same browser must not read the fleet's data. Rerun always
                # admits pages of this machine under the names localhost and 127.0.0.1.
                command += ["--cors-allow-origin", self._origin]
            expected += [_SERVING]
        if self._web_port is None:
            command += ["--serve-grpc"]
        else:
            claimed = [self._web_port, self._data_port]
            upstream_port = claim_port(self._bind_ip, 0, apart_from=claimed)
            command += ["--serve-web", "--web-viewer-port", str(upstream_port)]
            expected += [_HOSTING]
            data_port = urlsplit(self.live_url).port or 0
            options += ["--page", str(self._web_port), "--upstream", str(upstream_port)]
            options += ["--data", str(data_port)]
        if self._source is not None:
            command += [self._source]
        return [*options, "--", *command], expected

    def _said(self) -> str:
        if self._output is None:
            return ""
        # The process writes at the shared file offset, so read without moving it.
        return os.pread(self._output.fileno(), 20_000, 0).decode(errors="replace").strip()
