"""A hermetic network for each test: a router on a Unix socket of its own and nothing else."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import psutil
import pytest
from polling import PATIENCE_S, wait_until

from orchestrator.fleet import Fleet
from robot_agent.agent import Agent
from robot_agent.robot import Robot
from shared.excitation import Excitation, Tone
from shared.keys import FleetKeys
from shared.messages import GoalAccepted, GoalRequest, GoalResult, RobotState
from shared.transport import Session, open_client, open_router
from sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings

KEYS = FleetKeys("lab")


@pytest.fixture(autouse=True)
def _nothing_is_left_running() -> Iterator[None]:
    threads = set(threading.enumerate())
    children = set(psutil.Process().children(recursive=True))
    yield
    wait_until(lambda: set(threading.enumerate()) <= threads)
    wait_until(lambda: set(psutil.Process().children(recursive=True)) <= children)


@pytest.fixture
def endpoint(tmp_path: Path) -> str:
    return f"unixsock-stream/{tmp_path}/r.sock"


@pytest.fixture
def router(endpoint: str) -> Iterator[Session]:
    with open_router([endpoint]) as session:
        yield session


@dataclass
class Lab:
    """Starts agents and orchestrators on the test's own network, and ends what is left of them."""

    endpoint: str
    stack: ExitStack
    robots: dict[str, Robot] = field(default_factory=dict)

    def session(self) -> Session:
        return self.stack.enter_context(open_client(self.endpoint, timeout_s=PATIENCE_S))

    def agent(self, name: str, robot: Robot, *, realtime: float | None = None) -> Agent:
        self.robots[name] = robot
        agent = Agent(self.session(), KEYS, name, robot, realtime=realtime)
        return self.stack.enter_context(agent)

    def orchestrator(self, name: str = "orchestrator-1", *robots: str) -> Orchestrator:
        """A client that sees these robots, or all that were started here."""
        session = self.session()
        fleet = Fleet(session, KEYS, name)
        fleet.wait_for(robots or tuple(self.robots), timeout_s=PATIENCE_S)
        return Orchestrator(session, fleet)


@dataclass
class Orchestrator:
    """One orchestrator: its session and the fleet as it sees it."""

    session: Session
    fleet: Fleet

    def request(self, goal_id: str, **excitation: object) -> GoalRequest:
        """A test that takes a double integrator or a puppet about two seconds of its time."""
        settings = {"axis": "x", "tones": (Tone(omega_rad_s=20.0),), "settle_s": 0.5}
        return GoalRequest(
            goal_id=goal_id,
            owner=self.fleet.orchestrator_id,
            excitation=Excitation.model_validate({**settings, **excitation}),
        )

    def submit(self, robot: str, goal_id: str, **excitation: object) -> GoalAccepted:
        return self.fleet.submit(robot, self.request(goal_id, **excitation))

    def state(self, robot: str, condition: Callable[[RobotState], bool]) -> RobotState:
        """Wait for a state of a robot that fulfils a condition, and return it."""
        watch = self.fleet.watch(robot)

        def fulfilled() -> bool:
            return watch.state is not None and condition(watch.state)

        assert watch.wait_until(lambda _: fulfilled(), timeout_s=PATIENCE_S), watch.state
        assert watch.state is not None
        return watch.state

    def result(self, robot: str, goal_id: str) -> GoalResult:
        """Wait for the end of a goal and return its result."""
        self.state(robot, lambda state: state.last_goal_id == goal_id)
        return self.fleet.result(robot, goal_id)

    def run(self, robot: str, goal_id: str, **excitation: object) -> GoalResult:
        self.submit(robot, goal_id, **excitation)
        return self.result(robot, goal_id)


@pytest.fixture
def lab(router: Session, endpoint: str) -> Iterator[Lab]:
    with ExitStack() as stack:
        yield Lab(endpoint, stack)


def double_integrator(alpha: float, seed: int) -> DoubleIntegrator:
    settings = DoubleIntegratorSettings(alpha=alpha, beta=0.003, noise_std_m=1e-3)
    return DoubleIntegrator(settings, np.random.default_rng(seed))


@pytest.fixture
def running_fleet(lab: Lab) -> Orchestrator:
    """Agents over three double integrators r0 to r2, and an orchestrator that sees them."""
    for k, alpha in enumerate((0.85, 1.0, 0.97)):
        lab.agent(f"r{k}", double_integrator(alpha, seed=k))
    return lab.orchestrator()
