"""However often and by whom an agent is told to end, its robots come to rest first, all at once."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest
from fleet_lab import submitted

from benchmarks.faults.lab import Lab, double_integrator
from benchmarks.faults.logbook import RESTS, TOLD_TO_REST
from benchmarks.faults.program import PATIENCE_S, Program, wait_until
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.shared.errors import NoReplyError, RefusedError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.messages import GoalRequest, RobotStatus

LONG = Excitation(axis="x", tones=(Tone(omega_rad_s=1.0),), settle_s=60.0)
ROBOTS = ("a", "b", "c")


@pytest.fixture(autouse=True)
def hangup() -> Iterator[None]:
    """A process that ignores SIGHUP, as under nohup, would have its agents ignore it too."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.fixture
def landing(lab: Lab) -> Path:
    """The file without which no robot comes to rest, so that a landing lasts as long as a test."""
    return lab.folder / "may-rest"


def all_move(lab: Lab, robots: tuple[str, ...]) -> Fleet:
    fleet = lab.orchestrator(*robots)
    for robot in robots:
        request = GoalRequest(goal_id=f"g-{robot}", owner=fleet.orchestrator_id, motion=LONG)
        submitted(fleet, robot, request)
    for robot in robots:
        lab.wait_for_state(fleet, robot, lambda state: state.progress > 0)
    return fleet


def times_s(lab: Lab, robot: str, what: str) -> list[float]:
    return [entry.time_s for entry in lab.logbook(robot) if entry.what == what]


def wait_for_landing(lab: Lab, robots: tuple[str, ...]) -> None:
    wait_until(lambda: all(times_s(lab, robot, TOLD_TO_REST) for robot in robots))


def wait_for_shutdown(fleet: Fleet, robots: tuple[str, ...]) -> None:
    """A robot may be told to rest for another reason, such as an agent that was not scheduled."""

    def refuses_all(robot: str) -> bool:
        request = GoalRequest(goal_id="late", owner=fleet.orchestrator_id, motion=LONG)
        try:
            fleet.submit(robot, request)
        except RefusedError as refused:
            return refused.code == "shutting-down"
        except NoReplyError:  # an agent that shuts down is no longer announced
            return True
        return False

    wait_until(lambda: all(map(refuses_all, robots)))


def close_stdin(program: Program) -> None:
    assert program._process is not None
    assert program._process.stdin is not None
    program._process.stdin.close()


def send(number: signal.Signals) -> Callable[[Program], None]:
    return lambda program: os.kill(program.pid, number)


def test_the_robots_of_one_agent_process_come_to_rest_together(lab: Lab, landing: Path) -> None:
    lab.describe_section_v(dict.fromkeys(ROBOTS, 0.9), rest_awaits=str(landing))
    lab.router()
    agent = lab.agent(*ROBOTS, realtime=1.0)
    all_move(lab, ROBOTS)
    close_stdin(agent)
    wait_for_landing(lab, ROBOTS)  # none waits until another one is at rest
    landing.touch()
    assert agent.wait() == 0
    told = [times_s(lab, robot, TOLD_TO_REST) for robot in ROBOTS]
    rests = [times_s(lab, robot, RESTS) for robot in ROBOTS]
    assert all(len(times) == 1 for times in (*told, *rests))


ENDS: dict[str, tuple[Callable[[Program], None], tuple[signal.Signals, ...], int]] = {
    "Ctrl-C, then killed": (send(signal.SIGINT), (signal.SIGTERM,), 130),
    "an impatient Ctrl-C": (send(signal.SIGINT), (signal.SIGINT, signal.SIGINT), 130),
    "a service manager twice": (send(signal.SIGTERM), (signal.SIGTERM, signal.SIGTERM), 130),
    "a terminal that is closed": (send(signal.SIGHUP), (signal.SIGHUP, signal.SIGTERM), 130),
    "its parent, then Ctrl-C": (close_stdin, (signal.SIGINT, signal.SIGTERM), 0),
}


@pytest.mark.parametrize("who", ENDS)
def test_an_agent_that_lands_is_not_ended_by_further_signals(
    who: str, lab: Lab, landing: Path
) -> None:
    first, more, code = ENDS[who]
    lab.describe_section_v(dict.fromkeys(ROBOTS, 0.9), rest_awaits=str(landing))
    lab.router()
    agent = lab.agent(*ROBOTS, realtime=1.0)
    fleet = all_move(lab, ROBOTS)
    first(agent)
    wait_for_landing(lab, ROBOTS)
    wait_for_shutdown(fleet, ROBOTS)
    for number in more:
        said = agent.said
        os.kill(agent.pid, number)
        wait_until(lambda: agent.said != said)  # noqa: B023
    landing.touch()
    assert agent.wait() == code, agent.said
    assert "landing: the robots are coming to rest" in agent.said
    assert "error" not in agent.said
    assert all(len(times_s(lab, robot, RESTS)) == 1 for robot in ROBOTS)


def test_a_hanging_driver_ends_the_agent_with_an_error_when_the_others_are_at_rest(
    lab: Lab, landing: Path
) -> None:
    hangs = {"kind": "hang", "from_sample": 30}
    faulty = {**double_integrator(0.9), "faults": [hangs]}
    lab.describe(
        {"a": {"driver": "faulty", "settings": faulty}, "b": double_integrator(0.9)},
        rest_awaits=str(landing),
    )
    lab.router()
    agent = lab.agent("a", "b", realtime=1.0)
    fleet = all_move(lab, ("a", "b"))
    lab.wait_for_state(fleet, "a", lambda state: state.status is RobotStatus.FAULT)
    for _ in range(2):
        os.kill(agent.pid, signal.SIGTERM)
    landing.touch()
    assert agent.wait() == 1
    assert "error: a: " in agent.said
    assert "the robot may not be at rest" in agent.said
    assert len(times_s(lab, "b", RESTS)) == 1
    assert "b: " not in agent.said.splitlines()[-1]


def test_a_fleet_that_lands_is_not_ended_by_further_signals(
    lab: Lab, landing: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("NUFLEET_STATE", str(tmp_path / "state"))
    lab.describe_section_v(dict.fromkeys(ROBOTS, 0.9), rest_awaits=str(landing))
    where = ("--listen", lab.endpoint, "--realtime", "1")
    up = lab.command("fleet", "up", str(lab.fleet_file), *where)
    up.wait_for("3 robots of fleet lab are up")
    children = psutil.Process(up.pid).children(recursive=True)
    all_move(lab, ROBOTS)
    os.kill(up.pid, signal.SIGINT)
    wait_for_landing(lab, ROBOTS)
    for number in (signal.SIGTERM, signal.SIGINT):
        said = up.said
        os.kill(up.pid, number)
        wait_until(lambda: up.said != said)  # noqa: B023
    landing.touch()
    assert up.wait() == 130
    assert "landing: the robots of this fleet are coming to rest" in up.said
    assert all(len(times_s(lab, robot, RESTS)) == 1 for robot in ROBOTS)
    gone, alive = psutil.wait_procs(children, timeout=PATIENCE_S)
    assert not alive
    assert len(gone) == 3
