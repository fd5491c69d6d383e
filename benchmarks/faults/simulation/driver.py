"""A robot's driver and the thread that calls it: the product's procedures on a virtual clock."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.faults.simulation.history import History, Motion, Violation
from nufleet.robot_agent.decisions import Assignment
from nufleet.robot_agent.motion.perform import Played, Samples, performed
from nufleet.robot_agent.motion.sortie import Sortie
from nufleet.robot_agent.motion.steps import Steps
from nufleet.robot_agent.motion.watched_robot import WatchedRobot
from nufleet.robot_agent.motion_worker import reconnected
from nufleet.robot_agent.robot import Robot
from nufleet.robot_agent.rules.freezes import HEARING_S
from nufleet.robot_agent.rules.goal_machine import Goal
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotDownError
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Outcome

if TYPE_CHECKING:
    from benchmarks.faults.simulation.robot import SimulatedAgent
    from benchmarks.faults.simulation.world import World

GoOn = Callable[[Any, Exception | None], None]
"""Callback that receives what a call returned or raised."""

_ZERO = np.zeros(1)
_NONE = np.empty(0)
_NO_SAMPLES = Samples(_NONE, _NONE)


class SimulatedDriver(Robot):
    """The driver of one agent process: what it is asked is checked, and takes no time here."""

    def __init__(self, name: str, spec: RobotSpec, history: History, world: World) -> None:
        self._name, self._spec, self._history, self._world = name, spec, history, world
        self.cut = False
        self.in_the_air = False

    @property
    def spec(self) -> RobotSpec:
        return self._spec

    def connect(self) -> None:
        self._history.connected(self._world.now_s, self._name)
        self.cut = self.in_the_air = False

    def begin(self) -> None:
        self._ask("begin")

    def measure_output(self) -> FloatArray:
        if self.cut:
            raise RobotDownError("the driver finds its motors cut")
        return _ZERO

    def step(self, reference: FloatArray) -> FloatArray:
        self._ask("move")
        if self._spec.idle_s is not None and not (self.in_the_air or self.cut):
            raise Violation(f"{self._world.now_s:.3f}: {self._name} moves and has not begun")
        return self.measure_output()

    def end(self) -> None:
        self._ask("end")

    def rest(self) -> None:
        self._ask("rest")

    def kill(self) -> None:
        self.cut = True

    def disconnect(self) -> None:
        self.in_the_air = False

    def _ask(self, what: str) -> None:
        self._history.asked(self._world.now_s, self._name, what)


@dataclass(frozen=True, eq=False)
class _Job:
    """What the thread does next."""

    steps: Steps[Any]
    """Steps that ask the driver for one call after another."""

    then: Callable[[Any], None]
    """Callback for their result."""

    goal: Goal | None = None
    """Goal of the motion; None for a job that moves nothing."""


class Playing:
    """One motion between its first sample and its last, as a `Performance`."""

    def __init__(self, agent: SimulatedAgent, robot: WatchedRobot, assignment: Assignment) -> None:
        self.assignment = assignment
        self.record: Motion | None = None
        self.go_on: GoOn | None = None
        self._agent, self._robot = agent, robot
        self._samples = 0

    @property
    def moves(self) -> bool:
        """Whether samples are played at present."""
        return self.go_on is not None

    def play(self) -> tuple[Outcome, str]:
        """Play the first sample, and return `_ON`; or return how the motion ended before it."""
        order = self.assignment.switch.order
        if order is not None:
            return order
        self._robot.step(_ZERO)
        goal = self.assignment.goal
        now_s, name = self._agent.world.now_s, self._agent.name
        if now_s < self._agent.node.thawed_s + HEARING_S:
            raise Violation(f"{now_s:.3f}: {name} begins {goal.goal_id} right after a freeze")
        self.record = self._agent.history.began(now_s, name, goal.goal_id, goal.owner)
        return _ON

    def end(self) -> None:
        """Play no more samples: the motion was played to its end, halted, or the robot is down."""
        go_on, record = self.go_on, self.record
        if go_on is None or record is None:
            return
        now_s, plan = self._agent.world.now_s, self.assignment.plan
        self.go_on, record.resting_s = None, now_s
        self._samples = min(int((now_s - record.began_s) / plan.sample_time_s), plan.samples)
        order = self.assignment.switch.order
        if order is not None:
            go_on(order, None)
            return
        try:
            self._robot.measure_output()
        except RobotDownError as down:
            go_on(None, down)
        else:
            self._samples = plan.samples
            go_on((Outcome.COMPLETED, ""), None)

    def measured(self) -> Samples:
        """Return as many zeros as samples were played."""
        zeros = np.zeros(self._samples) if self._samples else _NONE
        return Samples(zeros, zeros)


_ON = (Outcome.COMPLETED, "it continues")


class MotionThread:
    """The only thread of an agent that asks its driver to move, as `MotionWorker` has it."""

    def __init__(self, agent: SimulatedAgent, robot: WatchedRobot, driver: SimulatedDriver) -> None:
        self.playing: Playing | None = None
        self._agent, self._robot, self._driver = agent, robot, driver
        self._world = agent.world
        self._idle_s = driver.spec.idle_s
        self._sortie = Sortie(robot)
        self._jobs: deque[_Job] = deque()
        self._job: _Job | None = None
        self._jobs_done = 0

    @property
    def in_the_air(self) -> bool:
        """Whether the robot has taken off, has not landed, and has not fallen."""
        return self._driver.in_the_air and not self._driver.cut

    # Jobs, one after another.

    def begin(self, assignment: Assignment) -> None:
        """Play a motion as soon as the previous job is over."""

        def performed_now() -> Steps[Played]:
            playing = self.playing = Playing(self._agent, self._robot, assignment)
            resting = self._agent.decisions.resting
            return performed(self._robot, playing, assignment.switch, on_resting=resting)

        switch, hindrance = assignment.switch, self._agent.frozen
        steps = self._sortie.move(switch, hindrance, _NO_SAMPLES, performed_now)
        self._put(_Job(steps, lambda played: self._ended(assignment, played), assignment.goal))

    def reconnect(self, answer: Callable[[Any], None]) -> None:
        """Reconnect a robot with a fault, and answer its release."""
        self._put(_Job(reconnected(self._sortie, self._agent.decisions), answer))

    def look(self) -> None:
        """Play no more samples of a motion that was halted; the present one is played."""
        playing = self.playing
        if playing is None or not playing.moves or playing.assignment.switch.order is None:
            return
        if self._idle_s is None:
            playing.end()
        else:
            self._after(self._world.between(0.0, self._driver.spec.sample_time_s), playing.end)

    def die(self) -> None:
        """End at once; the robot comes to rest by itself."""
        if self.playing is not None and self.playing.record is not None:
            self.playing.record.ended_s = self._world.now_s

    def _ended(self, assignment: Assignment, played: Played) -> None:
        record = None if self.playing is None else self.playing.record
        self.playing = None
        if record is not None:
            record.ended_s = self._world.now_s
        self._agent.ended(assignment, played, record)

    def _put(self, job: _Job) -> None:
        self._jobs.append(job)
        self._next()

    def _next(self) -> None:
        if self._job is not None:
            return
        if self._jobs:
            self._job = self._jobs.popleft()
            self._jobs_done += 1
            self._go_on(None, None)
        elif self._sortie.begun and self._idle_s is not None:
            done = self._jobs_done
            self._after(self._idle_s, lambda: self._land(done))

    def _land(self, done: int) -> None:
        if self._job is None and self._jobs_done == done:
            self._put(_Job(self._sortie.end(), self._agent.landed))

    # The steps of one job, each of which takes its time.

    def _go_on(self, answer: Any, error: Exception | None) -> None:
        job = self._job
        if job is None:
            raise Violation("steps continue, and there are none")
        while True:
            try:
                call = job.steps.send(answer) if error is None else job.steps.throw(error)
            except StopIteration as end:
                self._job = None
                job.then(end.value)
                self._next()
                return
            name = call.__name__
            if name == "begin" and job.goal is not None:
                history, now_s = self._agent.history, self._world.now_s
                history.may_move(now_s, self._agent.name, job.goal.goal_id, job.goal.owner)
            try:
                answer, error = call(), None
            except Violation:
                raise
            except Exception as raised:  # noqa: BLE001 - the steps decide what follows from it
                answer, error = None, raised
                continue
            if answer is _ON:
                self._play()
                return
            lasts_s = self._lasts_s(name)
            if lasts_s > 0.0:
                self._after(lasts_s, partial(self._returned, name))
                return

    def _play(self) -> None:
        playing = self.playing
        if playing is None:
            raise Violation("a motion plays that was not begun")
        playing.go_on = self._go_on

        def played() -> None:
            self._agent.note_gap()
            playing.end()

        self._after(playing.assignment.plan.duration_s, played)

    def _lasts_s(self, call: str) -> float:
        match call:
            case "rest":
                return self._world.between(0.01, 1.5)
            case "begin" | "end" if self._idle_s is not None:
                return self._world.between(0.3, 5.0)
            case "connect" | "disconnect":
                return self._world.between(0.05, 1.0)
        return 0.0

    def _returned(self, call: str) -> None:
        """A call returns, or finds that the motors were cut meanwhile, as most drivers do."""
        error = None
        if self._driver.cut and call != "disconnect" and self._world.random.random() < 0.7:
            try:
                self._robot.measure_output()
            except RobotDownError as down:
                error = down
        elif call in ("begin", "end"):
            self._driver.in_the_air = call == "begin"
        self._go_on(None, error)

    def _after(self, delay_s: float, job: Callable[[], None]) -> None:
        self._world.after(delay_s, lambda: self._agent.node.do(job))
