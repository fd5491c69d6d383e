"""A hermetic network for each test: a router on a Unix socket of its own and nothing else."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from child_processes import children_of
from command_processes import Typed
from counted_fleet import Counted
from fleet_lab import Lab, Orchestrator, double_integrator
from polling import wait_until

from nufleet.shared.wire.session import Session
from nufleet.shared.wire.transport import open_router


@pytest.fixture(autouse=True)
def _nothing_is_left_running() -> Iterator[None]:
    threads = set(threading.enumerate())
    children = set(children_of())
    yield
    wait_until(lambda: set(threading.enumerate()) <= threads)
    wait_until(lambda: set(children_of()) <= children)


@pytest.fixture(autouse=True)
def _state_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Agents that a test starts as processes know nothing of another test's robots."""
    monkeypatch.setenv("NUFLEET_STATE", str(tmp_path / "state"))


@pytest.fixture
def endpoint(tmp_path: Path) -> str:
    return f"unixsock-stream/{tmp_path}/r.sock"


@pytest.fixture
def router(endpoint: str) -> Iterator[Session]:
    with open_router([endpoint]) as session:
        yield session


@pytest.fixture
def lab(router: Session, endpoint: str) -> Iterator[Lab]:
    with ExitStack() as stack:
        yield Lab(endpoint, stack)


@pytest.fixture
def running_fleet(lab: Lab) -> Orchestrator:
    """Agents over three double integrators r0 to r2, and an orchestrator that sees them."""
    for k, alpha in enumerate((0.85, 1.0, 0.97)):
        lab.agent(f"r{k}", double_integrator(alpha, seed=k))
    return lab.orchestrator()


@pytest.fixture
def counted(monkeypatch: pytest.MonkeyPatch) -> Counted:
    """What is read and asked for in this process from now on."""
    return Counted.begun(monkeypatch)


@pytest.fixture
def typed(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Typed:
    """Commands that run in this process."""
    return Typed(monkeypatch, capfd)
