"""A fleet as processes: started, found, and never left behind, however their parent ends."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from contextlib import suppress
from pathlib import Path
from typing import Any

import psutil
import pytest
from fleet_lab import SLOW, Orchestrator
from hypothesis import given
from hypothesis import strategies as st
from polling import PATIENCE_S, wait_until

from nufleet.orchestrator.fleet import processes as fleet_processes
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.processes import FleetProcesses, grouped, private_folder
from nufleet.shared.errors import EndpointInUseError
from nufleet.shared.robots.fleet_file import FleetFile, read_fleet_file
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import Outcome, RobotStatus
from nufleet.shared.wire.transport import open_client

FLEET = """
schema = 1
name = "lab"
[robots.a]
driver = "double_integrator"
settings = { alpha = 0.85, beta = 0.003 }
[robots.b]
driver = "double_integrator"
settings = { alpha = 1.0, beta = 0.003 }
"""

START_AND_SAY_SO = """
import sys, time
from pathlib import Path
from nufleet.orchestrator.fleet.processes import FleetProcesses

path, endpoint, with_router = Path(sys.argv[1]), sys.argv[2], sys.argv[3] == "router"
with FleetProcesses() as started:
    if with_router:
        started.start_router(endpoint)
    started.start_agents(path, [("a", "b")], endpoint, None)
    print("started", flush=True)
    time.sleep(600)
"""


@pytest.fixture
def fleet_file(tmp_path: Path) -> Path:
    path = tmp_path / "fleet.toml"
    path.write_text(FLEET)
    return path


def children(parent_pid: int | None = None) -> list[int]:
    """Return the ids of the processes that a process, by default this one, has started."""
    return [child.pid for child in psutil.Process(parent_pid).children()]


def is_gone(pid: int) -> bool:
    """Whether a process has ended; one whose parent was killed may wait to be buried."""
    try:
        return bool(psutil.Process(pid).status() == psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return True


def test_an_interrupt_while_a_process_starts_leaves_it_to_nobody(
    fleet_file: Path, endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    begun, start = list[int](), subprocess.Popen

    def interrupted(*arguments: Any, **options: Any) -> subprocess.Popen[bytes]:
        process = start(*arguments, **options)
        begun.append(process.pid)
        signal.raise_signal(signal.SIGINT)
        return process

    monkeypatch.setattr(fleet_processes.subprocess, "Popen", interrupted)
    with pytest.raises(KeyboardInterrupt), FleetProcesses() as started:
        started.start_agents(fleet_file, [("a",), ("b",)], endpoint, None)
    assert len(begun) == 1
    assert not psutil.pid_exists(begun[0])


def test_a_fleet_starts_works_and_ends_agents_first(fleet_file: Path, endpoint: str) -> None:
    others = children()
    with FleetProcesses() as started:
        started.start_router(endpoint)
        started.start_agents(fleet_file, [("a", "b")], endpoint, 1.0)
        pids = set(children()) - set(others)
        assert len(pids) == 2
        with open_client(endpoint, timeout_s=PATIENCE_S) as session:
            lab = Orchestrator(session, Fleet(session, FleetKeys("lab"), "orchestrator-1"))
            lab.fleet.wait_for(("a", "b"), timeout_s=PATIENCE_S)
            lab.submit("a", "g1", **SLOW)
            lab.state("a", lambda s: s.status is RobotStatus.RUNNING)
            lab.fleet.cancel("a", "g1")
            assert lab.result("a", "g1").outcome is Outcome.CANCELLED
            assert started.dead() == []
            lab.submit("b", "g2", **SLOW)
            started.stop()
            # Heard over the router, which therefore was still there while the robots came to rest.
            ending = "the agent is shutting down"
            lab.state("b", lambda s: (s.status, s.reason) == (RobotStatus.IDLE, ending))
        assert all(is_gone(pid) for pid in pids)
    started.stop()


def test_where_processes_meet_is_not_among_their_arguments(fleet_file: Path, endpoint: str) -> None:
    """An endpoint may hold a private key, and every user of the machine sees arguments."""
    others = children()
    with FleetProcesses() as started:
        started.start_router(endpoint)
        started.start_agents(fleet_file, [("a",)], endpoint, None)
        for pid in set(children()) - set(others):
            process = psutil.Process(pid)
            # Between its fork and its program a process shows neither.
            wait_until(lambda process=process: endpoint in process.environ().values())
            assert endpoint not in " ".join(process.cmdline())


def test_an_error_in_their_context_ends_all_processes(fleet_file: Path, endpoint: str) -> None:
    others, pids = children(), set[int]()

    def interrupted() -> None:
        with FleetProcesses() as started:
            started.start_agents(fleet_file, [("a",), ("b",)], endpoint, None)  # no router is there
            pids.update(set(children()) - set(others))
            assert not any(is_gone(pid) for pid in pids)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert len(pids) == 2
    assert all(is_gone(pid) for pid in pids)


@pytest.mark.parametrize("with_router", ["router", "no router"])
def test_a_killed_parent_leaves_no_process(
    with_router: str, fleet_file: Path, endpoint: str, tmp_path: Path
) -> None:
    script = tmp_path / "parent.py"
    script.write_text(START_AND_SAY_SO)
    with subprocess.Popen(
        [sys.executable, str(script), str(fleet_file), endpoint, with_router],
        stdout=subprocess.PIPE,
        text=True,
    ) as parent:
        try:
            assert parent.stdout is not None
            assert parent.stdout.readline() == "started\n"
            pids = children(parent.pid)
            assert len(pids) == (2 if with_router == "router" else 1)
            assert not any(is_gone(pid) for pid in pids)
            if with_router == "router":
                with open_client(endpoint, timeout_s=PATIENCE_S) as session:
                    fleet = Fleet(session, FleetKeys("lab"), "orchestrator-1")
                    fleet.wait_for(("a", "b"), timeout_s=PATIENCE_S)
        finally:
            parent.send_signal(signal.SIGKILL)
    wait_until(lambda: all(is_gone(pid) for pid in pids))


def test_a_process_that_does_not_end_is_killed_and_said_to_be(
    fleet_file: Path,
    endpoint: str,
    monkeypatch: pytest.MonkeyPatch,
    caplog: pytest.LogCaptureFixture,
) -> None:
    monkeypatch.setattr(fleet_processes, "GRACE_S", 0.2)
    others = children()
    with FleetProcesses() as started:
        started.start_agents(fleet_file, [("a",)], endpoint, None)
        (pid,) = set(children()) - set(others)
        psutil.Process(pid).suspend()
    assert is_gone(pid)
    assert "agent of a did not end within 0.2 s and was killed" in caplog.text


def test_what_ends_by_itself_is_reported_with_its_last_words(
    fleet_file: Path, endpoint: str
) -> None:
    with FleetProcesses() as started:
        started.start_agents(fleet_file, [("a", "nobody")], endpoint, None)
        wait_until(lambda: bool(started.dead()))
        (report,) = started.dead()
    assert report.startswith("agent of a, nobody ended with exit code 2: ")
    assert "no robot 'nobody'; there are a, b" in report


def test_a_router_that_cannot_listen_is_an_error_that_names_the_endpoint(
    router: object, endpoint: str
) -> None:
    with FleetProcesses() as started, pytest.raises(EndpointInUseError, match=endpoint):
        started.start_router(endpoint)


def looks_for_a_router(agent: subprocess.Popen[str]) -> bool:
    """Whether Zenoh's runtime, whose threads are called after what they do, has begun."""
    assert agent.poll() is None, agent.communicate()
    names = []
    for task in Path(f"/proc/{agent.pid}/task").iterdir():
        with suppress(FileNotFoundError, ProcessLookupError):  # the thread has just ended
            names.append((task / "comm").read_text())
    return any(name.startswith(("net-", "tx-", "rx-")) for name in names)


def test_a_waiting_agent_ends_with_ctrl_c(fleet_file: Path, endpoint: str) -> None:
    command = ("agent", str(fleet_file), "--connect", endpoint)
    with subprocess.Popen(
        [sys.executable, "-m", "nufleet", *command],
        stdin=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    ) as agent:
        try:
            wait_until(lambda: looks_for_a_router(agent))
            agent.send_signal(signal.SIGINT)
            _, said = agent.communicate(timeout=PATIENCE_S)
        finally:
            agent.kill()
    assert agent.returncode == 130
    assert said.strip() == "interrupted"


def test_a_private_folder_is_gone_afterwards() -> None:
    with private_folder() as first, private_folder() as second:
        assert first != second
        assert Path(first).is_dir()
        assert Path(first).stat().st_mode & 0o077 == 0
    assert not Path(first).exists()


def fleet_of(kinds: list[str]) -> FleetFile:
    robots = {f"r{k}": {"driver": kind} for k, kind in enumerate(kinds)}
    return FleetFile.model_validate_json(json.dumps({"schema": 1, "name": "lab", "robots": robots}))


@given(
    kinds=st.lists(st.sampled_from(["double_integrator", "quadrotor"]), min_size=1, max_size=20),
    processes=st.integers(1, 8),
)
def test_robots_are_dealt_to_processes_once_each_and_simulators_kept_together(
    kinds: list[str], processes: int
) -> None:
    groups = grouped(fleet_of(kinds), processes=processes)
    dealt = [robot for group in groups for robot in group]
    assert sorted(dealt) == sorted(f"r{k}" for k in range(len(kinds)))
    together = {f"r{k}" for k, kind in enumerate(kinds) if kind == "quadrotor"}
    assert all(set(group) == together or not set(group) & together for group in groups)
    alone = [group for group in groups if not set(group) & together]
    assert len(alone) == min(processes, len(kinds) - len(together))
    assert max(map(len, alone), default=0) - min(map(len, alone), default=0) <= 1


def test_a_fleet_needs_a_process(fleet_file: Path) -> None:
    with pytest.raises(ValueError, match="at least one process"):
        grouped(read_fleet_file(fleet_file), processes=0)
