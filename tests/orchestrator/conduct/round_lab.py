"""Agents over a real router, and an orchestrator that has them play rounds of one study."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from kept_study import kept_study
from polling import PATIENCE_S
from puppet_robot import PuppetRobot

from nufleet.orchestrator.conduct.dispatcher import Dispatcher
from nufleet.orchestrator.conduct.replay import OpenTest, round_of
from nufleet.orchestrator.conduct.trial_log import TrialLog
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.repository.records import TrialRecord, TrialStatus
from nufleet.orchestrator.repository.repository import Repository
from nufleet.orchestrator.repository.study_store import StudyStore
from nufleet.orchestrator.study.interface import Question
from nufleet.orchestrator.study.outcomes import TestOutcome
from nufleet.robot_agent.agent import Agent
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.session import Session
from nufleet.shared.wire.transport import open_client, open_router

KEYS = FleetKeys("lab")
ROBOTS = ("r1", "r2", "r3")
STUDY = "run-1"
TEST = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),))


@dataclass
class Lab:
    """A router, three agents and a client, all in this process."""

    endpoint: str
    robots: dict[str, PuppetRobot]
    client: Session
    fleet: Fleet
    stack: ExitStack
    repository: Repository
    epoch: int = 1
    attempts: list[tuple[str, int, str]] = field(default_factory=list)
    agents: dict[str, Agent] = field(default_factory=dict)

    @property
    def studies(self) -> StudyStore:
        return self.repository.studies

    @property
    def epochs(self) -> dict[str, int]:
        return dict.fromkeys((*ROBOTS, "r9"), self.epoch)

    @property
    def specs(self) -> dict[str, RobotSpec]:
        known = {name: robot.spec for name, robot in self.robots.items()}
        return {**known, "r9": PuppetRobot().spec}

    def log(self) -> TrialLog:
        return TrialLog(self.studies, STUDY, self.epochs)

    def dispatcher(self) -> Dispatcher:
        return Dispatcher(
            self.fleet, self.log(), self.specs, on_attempt_failed=lambda *a: self.attempts.append(a)
        )

    def run(self, **tests: Excitation) -> dict[str, TestOutcome]:
        """Have robots play a round, as an orchestrator that was just started does."""
        return self.dispatcher().run(self.open_tests(**tests))

    def open_tests(self, **tests: Excitation) -> tuple[OpenTest, ...]:
        """The tests of the only round, as what is stored leaves them."""
        stored: dict[tuple[int, str], list[TrialRecord]] = {}
        for trial in self.studies.trials(STUDY):
            stored.setdefault((1, trial.intent.robot), []).append(trial)
        return round_of(STUDY, Question(1, tests), stored).tests

    def trials(self) -> list[tuple[str, TrialStatus]]:
        return [(t.intent.goal_id, t.status) for t in self.studies.trials(STUDY)]

    def next_orchestrator(self, name: str = "orchestrator-next") -> None:
        """Let another orchestrator take over; the one before is gone, and its token with it."""
        self.client.close()
        self.epoch += 1
        self.client = self.stack.enter_context(open_client(self.endpoint, timeout_s=PATIENCE_S))
        self.fleet = Fleet(self.client, KEYS, name)
        self.fleet.wait_for(ROBOTS, timeout_s=PATIENCE_S)
        self.fleet.hold(self.epochs)


@contextmanager
def agent_of(
    endpoint: str,
    name: str,
    robot: PuppetRobot,
    *,
    realtime: float | None,
    state_folder: Path | None = None,
) -> Iterator[Agent]:
    """Serve a robot for a while."""
    with (
        open_client(endpoint, timeout_s=PATIENCE_S) as session,
        Agent(session, KEYS, name, robot, realtime=realtime, state_folder=state_folder) as agent,
    ):
        yield agent


def start_lab(stack: ExitStack, tmp_path: Path, realtime: float | None) -> Lab:
    endpoint = f"unixsock-stream/{tmp_path}/r.sock"
    stack.enter_context(open_router([endpoint]))
    return join_lab(stack, tmp_path, realtime, endpoint, endpoint)


def join_lab(
    stack: ExitStack, tmp_path: Path, realtime: float | None, robots_at: str, endpoint: str
) -> Lab:
    """Start agents and a client at routers that run already."""
    robots = {name: PuppetRobot() for name in ROBOTS}
    agents = {
        name: stack.enter_context(agent_of(robots_at, name, robot, realtime=realtime))
        for name, robot in robots.items()
    }
    client = stack.enter_context(open_client(endpoint, timeout_s=PATIENCE_S))
    fleet = Fleet(client, KEYS, "orchestrator-test")
    fleet.wait_for(ROBOTS, timeout_s=PATIENCE_S)
    repository = stack.enter_context(kept_study(tmp_path, STUDY, (*ROBOTS, "r9")))
    lab = Lab(endpoint, robots, client, fleet, stack, repository, agents=agents)
    fleet.hold(lab.epochs)
    return lab
