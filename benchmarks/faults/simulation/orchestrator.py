"""An orchestrator process: what it hears, how it is interrupted, and how it ends."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.faults.simulation.conducting import Conduct
from benchmarks.faults.simulation.history import History, Motion, Violation
from benchmarks.faults.simulation.leasing import Leasing
from benchmarks.faults.simulation.network import Network, Node, OnAnswer
from benchmarks.faults.simulation.repository import SimulatedRepository
from benchmarks.faults.simulation.robot import SimulatedRobot
from benchmarks.faults.simulation.world import World
from nufleet.orchestrator.fleet.goal_events import Heard, TokenBack, TokenLost
from nufleet.robot_agent.rules.freezes import FROZEN_S
from nufleet.shared.wire.messages import RobotState

ON_ITS_WAY_S = 0.1 + FROZEN_S
"""Longest time between the sending of a goal and its motion: the delay of the network, and of a
process frozen for a moment."""

REST_WITHIN_S = 0.5
"""Time after an interrupt within which a reachable robot begins to come to rest."""


@dataclass
class Sight:
    """An orchestrator's knowledge of one robot, as `RobotWatch` keeps it."""

    alive: bool = False
    """Whether the robot's token is present."""

    heard_s: float = -math.inf
    """Time of the latest news of the robot."""

    boot_id: str = ""
    """Id of the agent process that published the latest state."""

    sequence: int = -1
    """Sequence number of the latest state."""


class SimulatedOrchestrator:
    """One process that ranks; `over` is how it ended, None while it runs."""

    def __init__(
        self,
        name: str,
        world: World,
        network: Network,
        history: History,
        robots: dict[str, SimulatedRobot],
        repository: SimulatedRepository,
        study_id: str,
        clock: Callable[[], float],
        everyone: Sequence[SimulatedOrchestrator],
    ) -> None:
        self.name = name
        self.world, self.network, self.history = world, network, history
        self.over: str | None = None
        self.interrupted = False
        self.commands = False
        self.robots = robots
        self.sights = {robot: Sight() for robot in robots}
        self._tokens: set[str] = set()
        self._failure: Exception | None = None
        self._leasing = Leasing(self, repository, clock, everyone)
        self._conduct = Conduct(self, repository, study_id)
        self.node: Node = network.join("orchestrator", name, self)
        for robot in robots.values():
            robot.listeners.append(self)
        world.after(0.2, lambda: self.node.do(self._leasing.describe_all))

    @property
    def ranking(self) -> tuple[str, ...]:
        """Sources in the order that the study found; empty before it is complete."""
        return self._conduct.ranking

    @property
    def dropped(self) -> dict[str, str]:
        """Reason for each robot that the study left out."""
        return self._conduct.dropped

    # Ending.

    def kill(self) -> None:
        """End the process at once, without sending anything."""
        self.end("killed")

    def interrupt(self) -> None:
        """Interrupt the study, as Ctrl-C and a lost lease do."""
        self.node.do(self._interrupt)

    def _interrupt(self) -> None:
        if self.over is not None or self.interrupted:
            return
        self.interrupted, self.commands = True, False
        now_s = self.world.now_s
        self.history.tell(now_s, f"{self.name} is interrupted")
        on_its_way_s = self.network.weather.late_s + ON_ITS_WAY_S
        self.history.interrupted[self.name] = now_s + on_its_way_s
        self._conduct.interrupt()
        weather = self.network.weather
        if not (weather.lost or weather.late):
            for motion in self.history.motions:
                if motion.owner == self.name and motion.resting_s is None:
                    self._must_rest(motion)
        self.end_if_idle()

    def _must_rest(self, motion: Motion) -> None:
        """Check that a robot that stays reachable begins to come to rest soon."""
        robot = self.robots[motion.robot]

        def reached() -> bool:
            return (
                robot.agent is not None
                and self.network.reaches(robot.agent.node)
                and not robot.agent.node.frozen
                and self.network.reaches(self.node)
                and not self.node.frozen
            )

        agent, asked_s = robot.agent, self.world.now_s
        if not reached():
            return

        def look() -> None:
            late = motion.resting_s is None and motion.ended_s is None
            if late and reached() and robot.agent is agent and not agent.node.quiet_since:  # type: ignore[union-attr]
                raise Violation(
                    f"{self.world.now_s:.3f}: {motion.robot} moves on {REST_WITHIN_S} s after the "
                    f"interrupt at {asked_s:.3f}"
                )

        self.world.after(REST_WITHIN_S, look)

    def end(self, how: str) -> None:
        if self.over is not None:
            return
        self.over = how
        self.history.tell(self.world.now_s, f"{self.name} ends: {how}")
        if how != "killed":
            self._leasing.release()
        self.commands = False
        self.network.end(self.node)
        for robot in self.robots.values():
            robot.listeners.remove(self)

    def end_if_idle(self) -> None:
        if self._conduct.idle and (self.interrupted or self._failure is not None):
            how = "interrupted" if self._failure is None else str(self._failure)
            now_s = self.world.now_s
            for robot in self.robots:
                unsure = robot in self._conduct.abandoned
                # A robot that confirmed nothing may have received the interrupt too late; it comes
                # to rest when it loses its owner.
                self.history.interrupt_returned(robot, self.name, now_s + (4.0 if unsure else 0.0))
            # The process may outlive the study, as a notebook does, so its token stays for a while.
            lingers_s = 0.0 if self._conduct.abandoned else self.world.between(0.0, 15.0)
            self.world.after(lingers_s, lambda: self.end(how))

    def fail(self, error: Exception) -> None:
        """End because of an error, after all robots have been brought to rest."""
        self._failure = self._failure or error
        self._interrupt()

    # Events from the network.

    def told(self, kind: str, name: str, alive: bool) -> None:
        if kind == "orchestrator":
            (self._tokens.add if alive else self._tokens.discard)(name)
            return
        sight = self.sights[name]
        sight.alive, sight.heard_s = alive, self.world.now_s
        self._conduct.take(name, TokenBack() if alive else TokenLost())

    def asked(self, question: str, body: Any, answer: OnAnswer) -> None:
        raise AssertionError("an orchestrator receives no requests")

    def heard(self, robot: str, state: RobotState) -> None:
        """Receive a robot's state; ignore one older than the last of the same agent process."""
        sight = self.sights[robot]
        if sight.boot_id == state.boot_id and state.sequence <= sight.sequence:
            return
        sight.boot_id, sight.sequence = state.boot_id, state.sequence
        sight.heard_s = self.world.now_s
        self._conduct.take(robot, Heard(state))

    def is_alive(self, orchestrator: str) -> bool:
        """Return whether another orchestrator's token is present according to the network."""
        return orchestrator in self._tokens

    @property
    def orchestrator_id(self) -> str:
        """Name of this orchestrator, under the name that the attribute has in `Fleet`."""
        return self.name

    # What leasing and conducting need of the process.

    def ask(
        self, robot: str, question: str, body: Any, timeout_s: float, then: Callable[[Any], None]
    ) -> None:
        """Ask a robot; `then` receives its answer, or `NoAnswer` after `timeout_s`."""
        self.network.ask(
            self.node, "robot", robot, question, body, timeout_s=timeout_s, on_answer=then
        )

    def begin_study(self) -> None:
        """Begin the study on the robots that are now leased."""
        self._conduct.begin(self._leasing.epochs)
