"""Causes each kind of fault in a simulation."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from benchmarks.faults.simulation.network import NoAnswer, Node
from benchmarks.faults.simulation.robot import SimulatedRobot
from nufleet.shared.wire.codec import encode
from nufleet.shared.wire.messages import Done, StopRequest

if TYPE_CHECKING:
    from benchmarks.faults.simulation.schedule import Kind
    from benchmarks.faults.simulation.simulation import Simulation

ROUTER_DOWN_MAX_S = 3.0
STATES_LATE_MAX_S = 5.0
STATES_LOST_MAX_S = 8.0
RELEASED_AFTER_S = 4.0


@dataclass(frozen=True)
class Case:
    """The circumstances in which a fault is caused."""

    simulation: Simulation
    """Simulation in which it happens."""

    robot: SimulatedRobot
    """Robot that it concerns."""

    size: float
    """Duration of the fault in seconds, or its size, depending on the kind."""


Cause = Callable[[Case], None]


def _freeze_agent(case: Case) -> None:
    if case.robot.agent is not None:
        case.simulation.network.freeze(case.robot.agent.node, case.size)


def _cut_agent(case: Case) -> None:
    if case.robot.agent is not None:
        case.simulation.network.cut(case.robot.agent.node, case.size)


def _lose_states(case: Case) -> None:
    case.robot.states_lost_until_s = case.simulation.world.now_s + min(case.size, STATES_LOST_MAX_S)


def _delay_states(case: Case) -> None:
    case.robot.states_late = (
        case.simulation.world.now_s + case.size,
        min(case.size, STATES_LATE_MAX_S),
    )


def _break_sensor(case: Case) -> None:
    case.robot.bad_sensor = 1 if case.size < STATES_LATE_MAX_S else 2


def _fill_disk(case: Case) -> None:
    case.simulation.history.excuses.add((case.robot.name, "journal"))
    case.robot.disk.full = True
    case.simulation.world.after(case.size, lambda: setattr(case.robot.disk, "full", False))


def _fill_repository(case: Case) -> None:
    repository = case.simulation.repository
    repository.full = True
    case.simulation.world.after(case.size, lambda: setattr(repository, "full", False))


def _set_clock(case: Case) -> None:
    """Set the clock by up to hours: forward for one half of the robots, back for the other."""
    forward = int(case.robot.name.removeprefix("r")) % 2
    case.simulation.clock_set_s += case.size**3 if forward else -(case.size**3)


def _bring_rival(case: Case) -> None:
    case.simulation.orchestrate(
        f"rival-{case.simulation.world.events}", case.simulation.rival_repository
    )


def _bring_second(case: Case) -> None:
    case.simulation.orchestrate(
        f"second-{case.simulation.world.events}", case.simulation.repository
    )


def _kill_orchestrators(case: Case) -> None:
    for orchestrator in case.simulation.running:
        orchestrator.kill()


def _freeze_orchestrators(case: Case) -> None:
    for orchestrator in case.simulation.running:
        case.simulation.network.freeze(orchestrator.node, case.size)


def _cut_orchestrators(case: Case) -> None:
    for orchestrator in case.simulation.running:
        case.simulation.network.cut(orchestrator.node, case.size)


def _interrupt(case: Case) -> None:
    for orchestrator in case.simulation.running:
        orchestrator.interrupt()


class _Person:
    """A person at a terminal who stops a robot and releases it once it is safe."""

    def __init__(self, simulation: Simulation, robot: SimulatedRobot) -> None:
        self._simulation, self._robot = simulation, robot
        name = f"person-{simulation.world.events}"
        self._node: Node = simulation.network.join("orchestrator", name, self)

    def told(self, kind: str, name: str, alive: bool) -> None:
        """Ignore a token: a person does not watch tokens."""

    def asked(self, question: str, body: object, answer: Callable[[object], None]) -> None:
        """Leave a question unanswered: a person serves no queries."""
        answer(NoAnswer())

    def stop(self, *, kill: bool) -> None:
        request = StopRequest(sender=self._node.name, reason="smoke", kill=kill)
        self._ask("stop", (self._node.name, encode(request)), self._stopped)

    def release(self) -> None:
        self._ask("release", self._node.name, self._released)

    def _stopped(self, answer: object) -> None:
        if isinstance(answer, Done):
            now_s = self._simulation.world.now_s
            self._simulation.history.stop_confirmed(now_s, self._robot.name, self._node.name)

    def _released(self, answer: object) -> None:
        if not isinstance(answer, Done):
            self._simulation.world.after(1.0, self.release)
        elif self._node.running:
            self._simulation.network.end(self._node)

    def _ask(self, question: str, body: object, then: Callable[[object], None]) -> None:
        self._simulation.network.ask(
            self._node,
            "robot",
            self._robot.name,
            question,
            body,
            timeout_s=3.0,
            on_answer=then,
        )


def _stop(case: Case, *, kill: bool = False, after_s: float = 0.1) -> None:
    person = _Person(case.simulation, case.robot)
    case.simulation.world.after(after_s, partial(person.stop, kill=kill))
    case.simulation.world.after(after_s + case.size + RELEASED_AFTER_S, person.release)


def _cut_motors(case: Case) -> None:
    """Cut the motors; for a short fault once more, soon after they were released."""
    _stop(case, kill=True)
    if case.size < STATES_LATE_MAX_S:
        _stop(case, kill=True, after_s=case.size + RELEASED_AFTER_S + 0.3)


def _until(case: Case) -> float:
    return case.simulation.world.now_s + case.size


CAUSES: Mapping[Kind, Cause] = {
    "kill agent": lambda case: case.robot.kill(case.size),
    "freeze agent": _freeze_agent,
    "cut agent": _cut_agent,
    "lose states": _lose_states,
    "late states": _delay_states,
    "bad sensor": _break_sensor,
    "fill disk": _fill_disk,
    "restart router": lambda case: case.simulation.network.restart_router(
        min(case.size, ROUTER_DOWN_MAX_S)
    ),
    "kill orchestrator": _kill_orchestrators,
    "freeze orchestrator": _freeze_orchestrators,
    "cut orchestrator": _cut_orchestrators,
    "interrupt": _interrupt,
    "set clock": _set_clock,
    "fill repository": _fill_repository,
    "stop": _stop,
    "other repository": _bring_rival,
    "second orchestrator": _bring_second,
    "cut motors": _cut_motors,
    "bad health": lambda case: setattr(case.robot, "unready_until_s", _until(case)),
    "no health": lambda case: setattr(case.robot, "unreported_until_s", _until(case)),
    "other version": lambda case: case.robot.outdate(case.size),
}
