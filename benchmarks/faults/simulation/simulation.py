"""Runs one schedule to its end and checks every invariant; shortens a schedule that breaks one."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, partial

from benchmarks.faults.simulation.causes import CAUSES, Case
from benchmarks.faults.simulation.history import History, Violation
from benchmarks.faults.simulation.network import LEASE_S, Network
from benchmarks.faults.simulation.orchestrator import SimulatedOrchestrator
from benchmarks.faults.simulation.repository import SimulatedRepository
from benchmarks.faults.simulation.robot import SimulatedRobot
from benchmarks.faults.simulation.schedule import Fault, Schedule
from benchmarks.faults.simulation.study import RankingStudy
from benchmarks.faults.simulation.world import World
from nufleet.orchestrator.repository.records import TrialStatus
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

STUDY = "study"
ENDS_WITHIN_S = 900.0
"""Time after the last fault within which a study has to end; it is resumed until it does."""

RESTS_WITHIN_S = 60.0
"""Time within which the last motion has to end after its orchestrator has, and idle robots have to
land; a frozen agent has to thaw first."""

WALL_S = 1e6
"""Time on the wall clock when a simulation begins."""

_PEOPLE_RESUME_S = (0.2, 4.0)


@cache
def spec(duration_max_s: float, idle_s: float | None) -> RobotSpec:
    """Return the description of every robot with this longest motion, which lands after `idle_s`.

    A robot without `idle_s` never takes off.
    """
    return RobotSpec(
        kind="simulated",
        axes=(AxisSpec(name="x", unit="m", amplitude_max=1, velocity_max=2, acceleration_max=9),),
        sample_time_s=0.02,
        omega_min_rad_s=0.5,
        omega_max_rad_s=30.0,
        duration_max_s=duration_max_s,
        settling_time_s=0.5,
        idle_s=idle_s,
        simulated=True,
    )


class Simulation:
    """One world with a fleet, and with people who restart a study until it is complete."""

    def __init__(self, schedule: Schedule, *, told: bool = False) -> None:
        self.schedule = schedule
        self.world = World(schedule.seed)
        self.history = History(told=told)
        self.network = Network(self.world, schedule.weather)
        names = [f"r{number}" for number in range(1, schedule.robots + 1)]
        robot_spec = spec(schedule.duration_max_s, schedule.idle_s)
        reports = schedule.idle_s is not None
        self.robots = {
            name: SimulatedRobot(self.world, self.network, self.history, name, robot_spec, reports)
            for name in names
        }
        self.repository = SimulatedRepository()
        self.rival_repository = SimulatedRepository()
        self.clock_set_s = 0.0
        self.orchestrators: list[SimulatedOrchestrator] = []
        self.stopped: set[str] = set()
        self.finished: SimulatedOrchestrator | None = None
        for fault in schedule.faults:
            self.world.at(fault.time_s, partial(self.cause, fault))

    def run(self) -> None:
        """Run to the end of the study; raises Violation."""
        self._begin()
        faults = self.schedule.faults
        last_s = faults[-1].time_s + faults[-1].size if faults else 0.0
        self.world.run(last_s + ENDS_WITHIN_S, lambda: self.finished is not None)
        if self.finished is None:
            states = {n: o.over for n, o in enumerate(self.orchestrators)}
            raise Violation(f"the study did not end by {self.world.now_s:.0f} s: {states}")
        # Messages still in transit arrive, and robots without an owner come to rest.
        for orchestrator in self.orchestrators:
            orchestrator.kill()
        arrived_s = self.world.now_s + self.schedule.weather.late_s + LEASE_S
        self.world.run(arrived_s + RESTS_WITHIN_S, lambda: self._at_rest_after(arrived_s))
        self._check_end(self.finished)

    def _at_rest_after(self, time_s: float) -> bool:
        return (
            self.world.now_s > time_s
            and all(motion.ended_s is not None for motion in self.history.motions)
            and not any(robot.in_the_air for robot in self.robots.values())
        )

    # People.

    def _begin(self) -> None:
        """Start an orchestrator, and another one whenever it ends before the study does."""
        name = f"orchestrator-{len(self.orchestrators) + 1}"
        orchestrator = self.orchestrate(name, self.repository)

        def look() -> None:
            if orchestrator.over is None:
                self.world.after(0.5, look)
            elif orchestrator.over.startswith(("complete", "failed")):
                self.finished = orchestrator
            else:
                self.world.after(self.world.between(*_PEOPLE_RESUME_S), self._begin)

        self.world.after(0.5, look)

    def orchestrate(self, name: str, repository: SimulatedRepository) -> SimulatedOrchestrator:
        """Start an orchestrator, which resumes the study from the content of its repository."""
        orchestrator = SimulatedOrchestrator(
            name,
            self.world,
            self.network,
            self.history,
            self.robots,
            repository,
            STUDY if repository is self.repository else "rival",
            lambda: WALL_S + self.world.now_s + self.clock_set_s,
            self.orchestrators,
        )
        self.orchestrators.append(orchestrator)
        return orchestrator

    def cause(self, fault: Fault) -> None:
        """Cause a fault, unless the study is over."""
        if self.finished is None:
            self.history.tell(self.world.now_s, f"fault: {fault.kind} {fault.size:.2f}")
            CAUSES[fault.kind](Case(self, self.robots[f"r{fault.robot}"], fault.size))

    @property
    def running(self) -> list[SimulatedOrchestrator]:
        """Orchestrators that run now."""
        return [known for known in self.orchestrators if known.over is None]

    # Invariants that must hold in the end.

    def _check_end(self, finished: SimulatedOrchestrator) -> None:
        trials = self.repository.trials
        complete = finished.over == "complete"
        in_the_air = [robot.name for robot in self.robots.values() if robot.in_the_air]
        if in_the_air:
            raise Violation(f"{', '.join(in_the_air)} never landed")
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
        if complete:
            undisturbed = RankingStudy(tuple(self.robots)).ranking
            expected = tuple(robot for robot in undisturbed if robot not in finished.dropped)
            if finished.ranking != expected:
                raise Violation(f"the ranking is {finished.ranking}, undisturbed {expected}")

    def _check_lost_result(self, robot: str, goal_id: str, reason: str, innocent: bool) -> None:
        excused = {"journal", "malformed"} & {c for r, c in self.history.excuses if r == robot}
        gone = ("did not return", "went silent", "is gone")
        if not innocent and not excused and not any(word in reason for word in gone):
            raise Violation(f"what {robot} measured for {goal_id} is lost: {reason}")


def violation(schedule: Schedule) -> str | None:
    """Return the invariant that a schedule breaks, in words; None when all hold."""
    try:
        Simulation(schedule).run()
    except Violation as broken:
        return str(broken)
    return None


def shortened(schedule: Schedule) -> Schedule:
    """Leave out faults until none can be left out without restoring every invariant."""
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
    """Return the events of a schedule, one per line, up to the violation if there is one."""
    simulation = Simulation(schedule, told=True)
    try:
        simulation.run()
    except Violation as broken:
        simulation.history.tell(simulation.world.now_s, f"VIOLATION {broken}")
    return simulation.history.story
