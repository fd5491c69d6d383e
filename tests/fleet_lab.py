"""Agents and orchestrators on a test's own network, and what tests ask of them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.robot_agent.agent import Agent
from nufleet.robot_agent.robot import Robot
from nufleet.shared.errors import NoReplyError, RefusedError, RobotLostError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.robots.fleet_file import RobotPolicy
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import GoalAccepted, GoalRequest, GoalResult, Outcome, RobotState
from nufleet.shared.wire.motions import Tracking
from nufleet.shared.wire.session import Session
from nufleet.shared.wire.transport import open_client
from nufleet.sims import drawings
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings

KEYS = FleetKeys("lab")

SLOW = {"tones": (Tone(omega_rad_s=1.0),)}
"""A test of more than half a minute, for what happens while one runs in real time."""


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
            motion=Excitation.model_validate({**settings, **excitation}),
        )

    def submit(self, robot: str, goal_id: str, **excitation: object) -> GoalAccepted:
        return submitted(self.fleet, robot, self.request(goal_id, **excitation))

    def state(self, robot: str, condition: Callable[[RobotState], bool]) -> RobotState:
        """Wait for a state of a robot that fulfils a condition, and return it."""
        watch = self.fleet.watch(robot)

        def fulfilled() -> bool:
            return watch.state is not None and condition(watch.state)

        assert watch.wait_until(lambda _: fulfilled(), timeout_s=PATIENCE_S), watch.state
        assert watch.state is not None
        return watch.state

    def next_life(self, robot: str, boot_id: str) -> RobotState:
        """Wait until another agent than that of `boot_id` answers for a robot; return its state."""

        def answers() -> bool:
            try:
                return self.fleet.describe(robot).boot_id != boot_id
            except (NoReplyError, RobotLostError):  # none of them does, or both do
                return False

        wait_until(answers)
        return self.state(robot, lambda state: state.boot_id != boot_id)

    def result(self, robot: str, goal_id: str) -> GoalResult:
        """Wait for the end of a goal and return its result."""
        self.state(robot, lambda state: state.last_goal_id == goal_id)
        return self.fleet.result(robot, goal_id)

    def draw(self, robot: str, share: float) -> float:
        """Have a robot draw a pear with its baseline controller; return the RMS error in m.

        `share` is the size as a share of the drawing's own.
        """
        path = travel(
            share * read_drawing(drawings.PEAR), speed=0.7, acceleration_max=1.5, sample_time_s=0.02
        )
        motion = Tracking(desired=path, inverse="baseline")
        owner = self.fleet.orchestrator_id
        submitted(self.fleet, robot, GoalRequest(goal_id="drawing", owner=owner, motion=motion))
        drawn = self.result(robot, "drawing")
        assert (drawn.outcome, drawn.reason) == (Outcome.COMPLETED, "")
        return float(np.sqrt(np.mean((drawn.response - path) ** 2)))

    def run(self, robot: str, goal_id: str, **excitation: object) -> GoalResult:
        self.submit(robot, goal_id, **excitation)
        return self.result(robot, goal_id)


@dataclass
class Lab:
    """Starts agents and orchestrators on the test's own network, and ends what is left of them."""

    endpoint: str
    stack: ExitStack
    robots: dict[str, Robot] = field(default_factory=dict)

    def session(self) -> Session:
        return self.stack.enter_context(open_client(self.endpoint, timeout_s=PATIENCE_S))

    def agent(
        self,
        name: str,
        robot: Robot,
        *,
        realtime: float | None = None,
        state_folder: Path | None = None,
        policy: RobotPolicy | None = None,
    ) -> Agent:
        self.robots[name] = robot
        agent = Agent(
            self.session(),
            KEYS,
            name,
            robot,
            realtime=realtime,
            state_folder=state_folder,
            policy=policy,
        )
        return self.stack.enter_context(agent)

    def orchestrator(self, name: str = "orchestrator-1", *robots: str) -> Orchestrator:
        """A client that sees these robots, or all that were started here."""
        session = self.session()
        fleet = Fleet(session, KEYS, name)
        fleet.wait_for(robots or tuple(self.robots), timeout_s=PATIENCE_S)
        return Orchestrator(session, fleet)


def submitted(fleet: Fleet, robot: str, request: GoalRequest) -> GoalAccepted:
    """Send a goal, again for as long as its refusal is for a moment only.

    A robot may see an orchestrator later than that one sees the robot, and the agent may have been
    kept from running by what else the machine does.
    """
    accepted: list[GoalAccepted] = []

    def answered() -> bool:
        try:
            accepted.append(fleet.submit(robot, request))
        except RefusedError as error:
            if error.code not in ("owner-not-alive", "frozen"):
                raise
        return bool(accepted)

    wait_until(answered)
    return accepted[0]


def released(fleet: Fleet, robot: str) -> None:
    """Release a robot after a stop, of which a second copy may still be on its way."""

    def answered() -> bool:
        try:
            fleet.release(robot)
        except RefusedError as error:
            if error.code != "stopped":
                raise
            return False
        return True

    wait_until(answered)


def assert_never_moved(orchestrator: Orchestrator, robot: str) -> None:
    """Fail when a robot has been given a goal, by a state that it published from now on."""
    heard = orchestrator.state(robot, lambda state: True)
    # The next one may have been on its way already.
    state = orchestrator.state(robot, lambda s: s.sequence >= heard.sequence + 2)
    assert (state.goal_id, state.last_goal_id, state.robot_time_s) == (None, None, 0.0)


def double_integrator(alpha: float, seed: int) -> DoubleIntegrator:
    settings = DoubleIntegratorSettings(alpha=alpha, beta=0.003, noise_std_m=1e-3)
    return DoubleIntegrator(settings, np.random.default_rng(seed))


class Gate:
    """Holds a puppet at a sample until it is opened."""

    def __init__(self, robot: PuppetRobot, at_sample: int = 0) -> None:
        self.reached = threading.Event()
        self.opened = threading.Event()
        self._at = at_sample
        robot.on_sample = self._wait

    def _wait(self, sample: int) -> None:
        if sample == self._at:
            self.reached.set()
            assert self.opened.wait(PATIENCE_S)


def refusal(call: Callable[[], object]) -> str:
    """The code with which a call is refused, once the agent has run for long enough to say why."""
    codes: list[str] = []

    def answered() -> bool:
        with pytest.raises(RefusedError) as raised:
            call()
        assert raised.value.reason
        codes.append(raised.value.code)
        return codes[-1] != "frozen"

    wait_until(answered)
    return codes[-1]
