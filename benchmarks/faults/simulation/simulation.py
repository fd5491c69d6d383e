"""Runs one schedule to its end and checks every invariant; shortens one that breaks any."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace

from benchmarks.faults.simulation.history import History, Violation
from benchmarks.faults.simulation.network import Network, NoAnswer
from benchmarks.faults.simulation.orchestrator import SimulatedOrchestrator
from benchmarks.faults.simulation.repository import SimulatedRepository
from benchmarks.faults.simulation.robot import SimulatedRobot
from benchmarks.faults.simulation.schedule import Fault, Schedule
from benchmarks.faults.simulation.study import RankingStudy
from benchmarks.faults.simulation.world import World
from orchestrator.repository.records import TrialStatus
from shared.messages import Done
from shared.robot_spec import AxisSpec, RobotSpec

STUDY = "study"
ENDS_WITHIN_S = 900.0
"""How long after the last fault a study may take: it is resumed until it is complete."""

_PEOPLE_RESUME_S = (0.2, 4.0)


def spec(duration_max_s: float) -> RobotSpec:
    """Return what every simulated robot says of itself."""
    return RobotSpec(
        kind="simulated",
        axes=(AxisSpec(name="x", unit="m", amplitude_max=1, velocity_max=2, acceleration_max=9),),
        sample_time_s=0.02,
        omega_min_rad_s=0.5,
        omega_max_rad_s=30.0,
        duration_max_s=duration_max_s,
        settling_time_s=0.5,
        simulated=True,
    )


SPECS: Mapping[float, RobotSpec] = {d: spec(d) for d in (7.0, 60.0)}


class Simulation:
    """One world with a fleet, people, and a study that they want to see complete."""

    def __init__(self, schedule: Schedule, *, told: bool = False) -> None:
        self.schedule = schedule
        self.world = World(schedule.seed)
        self.history = History(told=told)
        self.network = Network(self.world, schedule.weather)
        names = [f"r{number}" for number in range(1, schedule.robots + 1)]
        robot_spec = SPECS[schedule.duration_max_s]
        self.robots = {
            name: SimulatedRobot(self.world, self.network, self.history, name, robot_spec)
            for name in names
        }
        self.repository = SimulatedRepository()
        self.rival_repository = SimulatedRepository()
        self.clock_set_s = 0.0
        self.orchestrators: list[SimulatedOrchestrator] = []
        self.stopped: set[str] = set()
        self.finished: SimulatedOrchestrator | None = None
        for fault in schedule.faults:
            self.world.at(fault.time_s, lambda fault=fault: self._cause(fault))

    def run(self) -> None:
        """Run to the end of the study; raises Violation."""
        self._begin()
        faults = self.schedule.faults
        last_s = faults[-1].time_s + faults[-1].size if faults else 0.0
        self.world.run(last_s + ENDS_WITHIN_S, lambda: self.finished is not None)
        if self.finished is None:
            states = {n: o.over for n, o in enumerate(self.orchestrators)}
            raise Violation(f"the study did not end by {self.world.now_s:.0f} s: {states}")
        # Whatever is still on its way arrives, and robots without an owner come to rest.
        for orchestrator in self.orchestrators:
            orchestrator.kill()
        self.world.run(self.world.now_s + 30.0, lambda: False)
        self._check_end(self.finished)

    # People.

    def _begin(self) -> None:
        """Start an orchestrator, and another one whenever it ended before the study did."""
        name = f"orchestrator-{len(self.orchestrators) + 1}"
        orchestrator = self._orchestrate(name, self.repository)

        def look() -> None:
            if orchestrator.over is None:
                self.world.after(0.5, look)
            elif orchestrator.over.startswith(("complete", "failed")):
                self.finished = orchestrator
            else:
                self.world.after(self.world.between(*_PEOPLE_RESUME_S), self._begin)

        self.world.after(0.5, look)

    def _orchestrate(self, name: str, repository: SimulatedRepository) -> SimulatedOrchestrator:
        orchestrator = SimulatedOrchestrator(
            name,
            self.world,
            self.network,
            self.history,
            self.robots,
            repository,
            STUDY if repository is self.repository else "rival",
            lambda: 1000.0 + self.world.now_s + self.clock_set_s,
        )
        self.orchestrators.append(orchestrator)
        return orchestrator

    def _stop(self, robot: SimulatedRobot, release_after_s: float) -> None:
        """Somebody stops a robot, and releases it later, until it says that it is."""
        self.stopped.add(robot.name)
        person = self.network.join("orchestrator", f"person-{self.world.events}", _Person())

        def stopped(answer: object) -> None:
            if isinstance(answer, Done):
                self.history.stop_confirmed(self.world.now_s, robot.name)

        def release() -> None:
            self.history.release_asked(self.world.now_s, robot.name)
            ask("release", released)

        def released(answer: object) -> None:
            if not isinstance(answer, Done):
                self.world.after(1.0, release)
            elif person.running:
                self.network.end(person)

        def ask(question: str, then: Callable[[object], None]) -> None:
            self.network.ask(
                person,
                "robot",
                robot.name,
                question,
                person.name,
                timeout_s=3.0,
                on_answer=then,
            )

        self.world.after(0.1, lambda: ask("stop", stopped))
        self.world.after(release_after_s + 4.0, release)

    # Faults.

    def _cause(self, fault: Fault) -> None:
        if self.finished is not None:
            return
        self.history.tell(self.world.now_s, f"fault: {fault.kind} {fault.size:.2f}")
        robot = self.robots[f"r{fault.robot}"]
        agent, now_s = robot.agent, self.world.now_s
        ours = [o for o in self.orchestrators if o.over is None]
        match fault.kind:
            case "kill agent":
                robot.kill(fault.size)
            case "freeze agent" if agent is not None:
                self.network.freeze(agent.node, fault.size)
            case "cut agent" if agent is not None:
                self.network.cut(agent.node, fault.size)
            case "lose states":
                robot.states_lost_until_s = now_s + min(fault.size, 8.0)
            case "late states":
                robot.states_late = (now_s + fault.size, min(fault.size, 5.0))
            case "bad sensor":
                robot.bad_sensor = 1 + (fault.size > 5.0)
            case "fill disk":
                robot.disk.full = True
                self.world.after(fault.size, lambda: setattr(robot.disk, "full", False))
            case "restart router":
                self.network.restart_router(min(fault.size, 3.0))
            case "set clock":
                self.clock_set_s += (fault.size if fault.robot % 2 else -fault.size) ** 3
            case "fill repository":
                self.repository.full = True
                self.world.after(fault.size, lambda: setattr(self.repository, "full", False))
            case "stop":
                self._stop(robot, fault.size)
            case "other repository":
                self._orchestrate(f"rival-{self.world.events}", self.rival_repository)
            case "second orchestrator":
                self._orchestrate(f"second-{self.world.events}", self.repository)
            case "kill orchestrator":
                for orchestrator in ours:
                    orchestrator.kill()
            case "freeze orchestrator":
                for orchestrator in ours:
                    self.network.freeze(orchestrator.node, fault.size)
            case "cut orchestrator":
                for orchestrator in ours:
                    self.network.cut(orchestrator.node, fault.size)
            case "interrupt":
                for orchestrator in ours:
                    orchestrator.interrupt()

    # What must hold in the end.

    def _check_end(self, finished: SimulatedOrchestrator) -> None:
        trials = self.repository.trials
        complete = finished.over == "complete"
        for trial in trials.values():
            if complete and not trial.status.ended:
                raise Violation(f"trial {trial.intent.goal_id} never ended: {trial.status}")
        for motion in self.history.motions:
            if motion.ended_s is None:
                raise Violation(f"{motion.robot} never came to rest from {motion.goal_id}")
            known = trials.get(motion.goal_id)
            if known is None:
                continue
            innocent = known.status is TrialStatus.LOST and "silent" in known.reason
            if motion.completed and known.status is not TrialStatus.MEASURED and complete:
                self._check_lost_result(motion.robot, motion.goal_id, known.reason, innocent)
        if complete and not finished.dropped:
            undisturbed = RankingStudy(tuple(self.robots))
            expected = undisturbed.ranking
            if finished.ranking != expected:
                raise Violation(f"the ranking is {finished.ranking}, undisturbed {expected}")

    def _check_lost_result(self, robot: str, goal_id: str, reason: str, innocent: bool) -> None:
        disks_filled = any(f.kind == "fill disk" for f in self.schedule.faults)
        gone = ("did not return", "went silent", "is gone")
        if not innocent and not disks_filled and not any(word in reason for word in gone):
            raise Violation(f"what {robot} measured for {goal_id} is lost: {reason}")


class _Person:
    """Somebody at a terminal, who only asks."""

    def told(self, kind: str, name: str, alive: bool) -> None:
        """Nobody looks."""

    def asked(self, question: str, body: object, answer: Callable[[object], None]) -> None:
        """Nobody asks a person."""
        answer(NoAnswer())


def violation(schedule: Schedule) -> str | None:
    """Return which invariant a schedule breaks; None when all hold."""
    try:
        Simulation(schedule).run()
    except Violation as broken:
        return str(broken)
    return None


def shortened(schedule: Schedule) -> Schedule:
    """Return a schedule with as few faults as break an invariant still."""
    smaller = True
    while smaller:
        smaller = False
        for number in range(len(schedule.faults)):
            faults = schedule.faults[:number] + schedule.faults[number + 1 :]
            if violation(replace(schedule, faults=faults)) is not None:
                schedule, smaller = replace(schedule, faults=faults), True
                break
    return schedule


def story(schedule: Schedule) -> list[str]:
    """Return what happens in a schedule, line by line, up to the violation if there is one."""
    simulation = Simulation(schedule, told=True)
    try:
        simulation.run()
    except Violation as broken:
        simulation.history.tell(simulation.world.now_s, f"VIOLATION {broken}")
    return simulation.history.story
