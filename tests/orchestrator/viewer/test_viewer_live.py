"""Live viewers see the study, and the study continues even if they fail."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import threading
import urllib.request
from collections.abc import Iterator
from contextlib import closing
from http.client import HTTPConnection
from pathlib import Path
from urllib.parse import urlsplit

import psutil  # type: ignore[import-untyped]
import pytest
from bare_viewer import READ_MESSAGES, BareViewer
from child_processes import children_of
from polling import PATIENCE_S, wait_until
from recording_reader import column, scalars
from study_events import iteration_event, samples_event

from nufleet.orchestrator.viewer.server.open import open_web
from nufleet.orchestrator.viewer.writer import RerunWriter, ServeOptions
from nufleet.shared.errors import EndpointInUseError, InvalidInputError

EPHEMERAL = ServeOptions(grpc_port=0)

RARE = "zebra-quokka"
"""A name that resembles nothing else, so that it survives compression as it is."""


@pytest.fixture
def taken_port() -> Iterator[int]:
    with socket.socket() as owner:
        owner.bind(("127.0.0.1", 0))
        owner.listen()
        yield owner.getsockname()[1]


def port_of(url: str | None) -> int:
    assert url is not None
    port = urlsplit(url.replace("rerun+http", "http")).port
    assert port is not None
    return port


def servers_of(pid: int) -> list[psutil.Process]:
    return children_of(pid, named="rerun")


def test_a_viewer_that_connects_late_gets_the_study_from_its_beginning() -> None:
    with RerunWriter("run-1", recording=None, serve=EPHEMERAL) as writer:
        writer.emit(iteration_event(sources=(RARE,)))
        # Once the first has seen it, it is past.
        for _ in range(2):
            with BareViewer(port_of(writer.live_url)) as viewer:
                viewer.subscribe(more=2**20)
                assert b"run-1" in viewer.read_until(RARE.encode())


def test_the_page_is_served_on_this_machine_alone_and_may_connect_to_its_data_alone() -> None:
    others = set(children_of())  # such as a database of other tests
    with RerunWriter("run-1", recording=None, serve=ServeOptions(0, 0)) as writer:
        assert writer.web_url is not None
        with urllib.request.urlopen(writer.web_url) as page:  # noqa: S310 - our own
            assert b"Rerun" in page.read()
            policy = page.headers["Content-Security-Policy"]
        assert f"connect-src 'self' blob: data: http://*:{port_of(writer.live_url)};" in policy
        script_url = writer.web_url.split("?")[0] + "re_viewer.js"
        with urllib.request.urlopen(script_url) as script:  # noqa: S310 - our own
            assert script.headers["Content-Type"].endswith("javascript")
            assert b"wasm_bindgen" in script.read()
        listening = [
            connection.laddr
            for process in set(children_of()) - others
            for connection in process.net_connections("tcp")
            if connection.status == "LISTEN"
        ]
        assert {address.ip for address in listening} == {"127.0.0.1"}
        ports = {port_of(writer.live_url), port_of(writer.web_url)}
        assert ports <= {address.port for address in listening}
    assert set(children_of()) <= others


def may_read(live_url: str | None, origin: str) -> bool:
    """Return whether a browser lets a page of that origin read what is served live."""
    assert live_url is not None
    data = urlsplit(live_url.replace("rerun+http", "http")).netloc
    asked = {
        "Origin": origin,
        "Access-Control-Request-Method": "POST",
        "Access-Control-Request-Headers": "content-type,x-grpc-web",
    }
    with closing(HTTPConnection(data, timeout=PATIENCE_S)) as connection:
        connection.request("OPTIONS", READ_MESSAGES, headers=asked)
        answer = connection.getresponse()
        admitted = answer.getheader("Access-Control-Allow-Origin")
    return admitted in ("*", origin)


@pytest.mark.parametrize("bind_ip", ["127.0.0.1", "127.0.0.2"])
def test_no_page_but_those_of_this_machine_may_read_the_data(bind_ip: str) -> None:
    with RerunWriter("run-1", recording=None, serve=ServeOptions(0, 0, bind_ip)) as writer:
        assert writer.web_url is not None
        page = urlsplit(writer.web_url)
        assert may_read(writer.live_url, f"http://{page.netloc}")
        for origin in (
            "http://evil.example",
            f"http://evil.example:{page.port}",
            f"http://{bind_ip}.evil.example:{page.port}",
            f"https://evil.example:{page.port}",
            "null",
        ):
            assert not may_read(writer.live_url, origin), origin


def test_a_page_of_another_process_shows_a_running_study() -> None:
    with (
        RerunWriter("run-1", recording=None, serve=EPHEMERAL) as writer,
        open_web(str(writer.live_url), browse=False) as page,
    ):
        assert page.web_url is not None
        assert may_read(writer.live_url, f"http://{urlsplit(page.web_url).netloc}")
        assert not may_read(writer.live_url, "http://evil.example")


@pytest.mark.parametrize("taken", ["grpc", "web"])
def test_a_taken_port_is_found_before_anything_is_recorded(
    tmp_path: Path, taken_port: int, taken: str
) -> None:
    serve = ServeOptions(taken_port, None) if taken == "grpc" else ServeOptions(0, taken_port)
    writer = RerunWriter("run-1", recording=tmp_path / "run.rrd", serve=serve)
    with pytest.raises(EndpointInUseError, match=f"127.0.0.1:{taken_port}"):
        writer.open()
    assert not (tmp_path / "run.rrd").exists()
    assert servers_of(os.getpid()) == []


def test_a_foreign_address_cannot_be_listened_on() -> None:
    # 192.0.2.0/24 is reserved for documentation (RFC 5737).
    serve = ServeOptions(0, None, bind_ip="192.0.2.1")
    with pytest.raises(EndpointInUseError, match=r"192\.0\.2\.1"):
        RerunWriter("run-1", recording=None, serve=serve).open()


def test_a_recording_under_a_name_that_no_system_accepts_is_refused_in_words(
    tmp_path: Path,
) -> None:
    with pytest.raises(InvalidInputError, match=r"cannot be written to .*: File name too long"):
        RerunWriter("run-1", recording=tmp_path / f"{'r' * 300}.rrd", serve=None).open()


def test_no_server_is_left_when_the_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError):
        RerunWriter("run-1", recording=tmp_path, serve=EPHEMERAL).open()
    assert servers_of(os.getpid()) == []


@pytest.mark.parametrize("stuck", ["viewers", "server"])
def test_what_is_stuck_costs_neither_the_study_nor_its_recording(
    tmp_path: Path, stuck: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "run.rrd"
    writer = RerunWriter("run-1", recording=path, serve=EPHEMERAL)
    writer.open()
    port = port_of(writer.live_url)
    with BareViewer(port), BareViewer(port) as silent:
        silent.subscribe()
        if stuck == "server":
            for server in servers_of(os.getpid()):
                server.suspend()
        tests = 300
        for k in range(tests):
            writer.emit(samples_event("s1", t_s=30.0 * k, samples=2000))
            if k % 100 == 99:
                writer.emit(iteration_event(k))
        recording = writer._to_recording
        assert recording is not None
        # How long it may take is a matter of the machine; what follows is one of what is stuck.
        wait_until(lambda: not recording._kept and not recording._droppable)
        # Left to itself Rerun waits 25 s for a viewer that is stopped, and for ever for a server.
        live_close_s = 20.0 if stuck == "viewers" else 0.1
        monkeypatch.setattr("nufleet.orchestrator.viewer.writer.LIVE_CLOSE_S", live_close_s)
        assert writer.close(PATIENCE_S) == (stuck == "viewers")
    assert len(scalars(path, "/tests/response/s1/x")[1]) == 2000 * tests
    assert len(column(path, "/psi/worst/s1/median", "Scalars:scalars")) == tests // 100
    assert servers_of(os.getpid()) == []
    assert not [t for t in threading.enumerate() if t.name.startswith("viewer-")]


def test_a_server_that_dies_is_reported_and_the_recording_goes_on(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "run.rrd"
    with RerunWriter("run-1", recording=path, serve=EPHEMERAL) as writer:
        (server,) = servers_of(os.getpid())
        server.kill()
        server.wait(PATIENCE_S)
        sent = 0

        def missed() -> bool:
            nonlocal sent
            writer.emit(iteration_event(sent))
            sent += 1
            return writer.dropped >= 3

        wait_until(missed)
        # How long the recording takes for what was sent meanwhile is a matter of the machine.
        writer.close(PATIENCE_S)
    assert "the server of the viewer has ended" in caplog.text
    assert len(column(path, "/psi/worst/s1/median", "Scalars:scalars")) == sent


STUDY = """
import signal, sys, time
sys.path.insert(0, sys.argv[1])
from pathlib import Path
from study_events import iteration_event
from nufleet.orchestrator.viewer.writer import RerunWriter, ServeOptions

def end(*_):
    raise SystemExit(3)

signal.signal(signal.SIGTERM, end)
with RerunWriter("run-1", recording=Path(sys.argv[2]), serve=ServeOptions(0)) as writer:
    writer.emit(iteration_event())
    print("ready", flush=True)
    time.sleep(60)
"""


def started_study(path: Path) -> subprocess.Popen[bytes]:
    study = subprocess.Popen(
        [sys.executable, "-c", STUDY, str(Path(__file__).parent), str(path)],
        stdout=subprocess.PIPE,
    )
    assert study.stdout is not None
    assert study.stdout.readline() == b"ready\n"
    return study


def test_a_study_that_is_terminated_leaves_a_whole_recording(tmp_path: Path) -> None:
    with started_study(tmp_path / "run.rrd") as study:
        study.send_signal(signal.SIGTERM)
        assert study.wait(PATIENCE_S) == 3
    # A recording without its footer would be read with a warning, which is an error here.
    assert len(column(tmp_path / "run.rrd", "/psi/worst/s1/median", "Scalars:scalars")) == 1


def test_a_study_that_is_killed_leaves_no_server(tmp_path: Path) -> None:
    with started_study(tmp_path / "run.rrd") as study:
        servers = servers_of(study.pid)
        assert len(servers) == 1
        study.kill()
    _, alive = psutil.wait_procs(servers, timeout=PATIENCE_S)
    assert alive == []


def test_a_recording_is_shown_in_a_browser_until_it_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "run.rrd"
    with RerunWriter("run-1", recording=path, serve=None) as writer:
        writer.emit(iteration_event(sources=(RARE,)))
    with open_web(path, browse=False) as server:
        assert server.web_url is not None
        with urllib.request.urlopen(server.web_url) as page:  # noqa: S310 - our own
            assert page.status == 200
        with BareViewer(port_of(server.live_url)) as viewer:
            viewer.subscribe(more=2**20)
            viewer.read_until(RARE.encode())
    assert servers_of(os.getpid()) == []
