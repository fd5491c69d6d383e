"""A stop that is asked for happens, regardless of its reason, its names and other robots."""

from __future__ import annotations

import json
import subprocess
import sys
import threading

import click
import pytest
from fleet_lab import SLOW, Lab, Orchestrator, released
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot

from nufleet.orchestrator.fleet.client import RELEASE_TIMEOUT_S, Fleet
from nufleet.orchestrator.jobs.stop import stop_and_print
from nufleet.robot_agent.agent import Agent
from nufleet.robot_agent.motion.watched_robot import SLOW_CALL_MAX_S
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import RobotStatus

ESCAPE = "\x1b[31mOWNED"


def nufleet(lab: Lab, *arguments: str | bytes) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "nufleet", *arguments, "--connect", lab.endpoint],
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
    )


def moving(lab: Lab, *robots: str) -> Orchestrator:
    """An orchestrator whose robots all move, and will for long."""
    for robot in robots:
        lab.agent(robot, PuppetRobot(), realtime=1.0)
    orchestrator = lab.orchestrator()
    for robot in robots:
        orchestrator.submit(robot, f"goal-{robot}", **SLOW)
        orchestrator.state(robot, lambda state: state.progress > 0)
    return orchestrator


def stopped(orchestrator: Orchestrator, robot: str) -> str:
    """Wait until a robot is stopped and at rest; return its reason."""
    return orchestrator.state(robot, lambda s: s.status is RobotStatus.STOPPED).reason


REASONS: dict[str, tuple[str | bytes, str]] = {
    "of a Latin-1 terminal": (b"M\xf6we", "M?we"),
    "too long": ("x" * 5000, "x" * 100),
    "empty": ("", ""),
    "control characters": ("gull\r\n\x07\x1b[2J", "gull  ??[2J"),
    "beyond the basic plane": ("🛑", "🛑"),
}


@pytest.mark.parametrize("kind", REASONS)
@pytest.mark.parametrize("everyone", [False, True])
def test_no_reason_keeps_a_robot_from_being_stopped(kind: str, everyone: bool, lab: Lab) -> None:
    orchestrator = moving(lab, "a")
    given, kept = REASONS[kind]
    done = nufleet(lab, "stop", "--all" if everyone else "a", "--reason", given)
    assert (done.returncode, done.stderr) == (0, "a is stopped\n")
    assert kept in stopped(orchestrator, "a")
    released(orchestrator.fleet, "a")


def test_a_name_that_cannot_be_one_keeps_no_other_robot_from_being_stopped(lab: Lab) -> None:
    orchestrator = moving(lab, "a", "b")
    done = nufleet(lab, "stop", "A", "nobody", "a", "b")
    for robot in ("a", "b"):
        stopped(orchestrator, robot)
        assert f"{robot} is stopped\n" in done.stderr
    assert "A DID NOT CONFIRM ITS STOP: robot 'A' is not a name" in done.stderr
    assert "nobody DID NOT CONFIRM ITS STOP: robot nobody is not there" in done.stderr
    assert done.returncode == 1


def test_a_robot_without_a_switch_is_stopped_and_said_to_be_so(lab: Lab) -> None:
    orchestrator = moving(lab, "a")
    done = nufleet(lab, "stop", "--all", "--kill")
    assert done.stderr == (
        "a: it was stopped, but its motors were not cut: the driver of this robot has no way of "
        "cutting its motors\n"
    )
    assert done.returncode == 1
    stopped(orchestrator, "a")


def test_a_stop_of_all_stops_every_fleet_at_the_router(lab: Lab) -> None:
    orchestrator = moving(lab, "a")
    other = PuppetRobot()
    with Agent(lab.session(), FleetKeys("other"), "b", other, realtime=None):
        done = nufleet(lab, "stop", "--all")
        assert done.returncode == 0, done.stderr
        assert sorted(done.stderr.splitlines()) == ["lab/a is stopped", "other/b is stopped"]
        stopped(orchestrator, "a")
        nufleet(lab, "release", "a", "--fleet-name", "lab")
        # Only one fleet is stopped if it is named.
        done = nufleet(lab, "stop", "--all", "--fleet-name", "other")
        assert (done.returncode, done.stderr) == (0, "b is stopped\n")
        orchestrator.state("a", lambda s: s.status is RobotStatus.IDLE)
        # A robot is stopped by its name, no matter which fleet it belongs to.
        done = nufleet(lab, "stop", "a")
        assert (done.returncode, done.stderr) == (0, "lab/a is stopped\n")
        stopped(orchestrator, "a")


def test_a_stop_that_nobody_can_confirm_is_an_error(lab: Lab) -> None:
    nobody = nufleet(lab, "stop", "--all")
    assert nobody.returncode == 1
    assert "no robot can confirm it: there are no robots at the router" in nobody.stderr
    lab.agent("a", PuppetRobot())
    elsewhere = nufleet(lab, "stop", "--all", "--fleet-name", "lap")
    assert elsewhere.returncode == 1
    assert "all robots of fleet lap" in elsewhere.stderr
    assert "there are fleets lab at the router" in elsewhere.stderr


def test_names_from_the_network_that_are_none_are_neither_printed_nor_counted(lab: Lab) -> None:
    orchestrator = moving(lab, "a")
    stranger = lab.session()
    stranger.declare_alive(f"nufleet/lab/robot/{ESCAPE}/alive")
    stranger.declare_alive(f"nufleet/{ESCAPE}/robot/b/alive")
    stranger.declare_alive(f"nufleet/lab/orchestrator/{ESCAPE}/alive")
    wait_until(lambda: len(stranger.alive("nufleet/*/robot/*/alive", timeout_s=PATIENCE_S)) == 3)
    status = nufleet(lab, "fleet", "status")
    assert status.returncode == 0, status.stderr
    assert json.loads(nufleet(lab, "fleet", "status", "--json").stdout)["robots"].keys() == {"a"}
    done = nufleet(lab, "stop", "--all")
    assert done.returncode == 0, done.stderr
    assert "a is stopped\n" in done.stderr
    for said in (status.stdout, status.stderr, done.stderr):
        assert "\x1b" not in said
    stopped(orchestrator, "a")
    assert orchestrator.fleet.robots() == ("a",)


def test_one_robot_that_is_not_released_keeps_no_other_from_it(lab: Lab) -> None:
    orchestrator = moving(lab, "a", "b")
    assert nufleet(lab, "stop", "--all").returncode == 0
    for robot in ("a", "b"):
        stopped(orchestrator, robot)
    done = nufleet(lab, "release", "nobody", "a", "b")
    assert done.returncode == 1
    assert "nobody was not released: robot nobody is not there" in done.stderr
    for robot in ("a", "b"):
        assert f"{robot} may move again\n" in done.stderr
        orchestrator.state(robot, lambda s: s.status is RobotStatus.IDLE)


def test_a_robot_that_is_reconnected_slowly_is_waited_for_and_delays_the_release_of_no_other(
    lab: Lab,
) -> None:
    slow, connects, others = PuppetRobot(), threading.Event(), threading.Event()
    lab.agent("slow", slow)
    lab.agent("b", PuppetRobot())
    slow.on_kill = lambda: None
    orchestrator = lab.orchestrator()
    orchestrator.fleet.stop("slow", "smoke", kill=True)
    orchestrator.fleet.stop("b", "smoke")

    def connect() -> None:
        connects.set()
        assert others.wait(PATIENCE_S)

    slow.on_connect = connect
    command = subprocess.Popen(
        [sys.executable, "-m", "nufleet", "release", "slow", "b", "--connect", lab.endpoint],
        stderr=subprocess.PIPE,
        text=True,
    )
    assert connects.wait(PATIENCE_S)
    orchestrator.state("b", lambda state: state.status is RobotStatus.IDLE)
    others.set()
    _, said = command.communicate(timeout=PATIENCE_S)
    assert command.returncode == 0, said
    assert {"slow may move again", "b may move again"} <= set(said.splitlines())


def test_a_release_waits_for_longer_than_a_driver_may_take_to_connect() -> None:
    assert RELEASE_TIMEOUT_S > SLOW_CALL_MAX_S


def test_a_robot_that_answers_late_delays_the_answer_of_no_other(
    lab: Lab, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    for robot in ("a", "b"):
        lab.agent(robot, PuppetRobot())
    lab.orchestrator()
    said, stop, echo = threading.Event(), Fleet.stop, click.echo

    def stop_late(fleet: Fleet, robot: str, reason: str, **kill: bool) -> None:
        if robot == "a":
            assert said.wait(PATIENCE_S)
        stop(fleet, robot, reason, **kill)

    def note(words: str, **where: bool) -> None:
        echo(words, **where)
        said.set()

    monkeypatch.setattr(Fleet, "stop", stop_late)
    monkeypatch.setattr(click, "echo", note)
    assert stop_and_print(lab.endpoint, "lab", None, "smoke")
    assert capfd.readouterr().err == "b is stopped\na is stopped\n"


def test_nothing_heavy_is_imported_before_robots_are_told_to_stop() -> None:
    script = (
        "import sys; import nufleet.orchestrator.cli.stop, nufleet.orchestrator.jobs.stop; "
        "print({m.partition('.')[0] for m in sys.modules})"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    loaded = done.stdout
    assert "'zenoh'" in loaded
    for heavy in ("numpy", "pydantic", "scipy", "rich", "sqlalchemy", "matplotlib", "rerun"):
        assert f"'{heavy}'" not in loaded
