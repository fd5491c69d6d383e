"""A closed fleet on three machines: base, two robots, and a stranger on the same network."""

from __future__ import annotations

import json
import shutil
from contextlib import ExitStack
from pathlib import Path

import pytest
from click.testing import CliRunner

from benchmarks.faults.namespaces import Namespace, star
from benchmarks.faults.program import Program
from nufleet.shared.command_line import command_line

INVENTORY = """
schema = 1
name = "lab"
[router]
addresses = ["10.213.0.1"]
[orchestrators.desk]
"""
ROBOT = '[robots.{0}]\ndriver = "double_integrator"\nsettings = {{ alpha = 1.0, beta = 0.003 }}\n'
ROBOTS = ("drone-7", "drone-8")


def nufleet(*arguments: str) -> None:
    done = CliRunner().invoke(command_line(), arguments)
    assert done.exit_code == 0, (done.output, done.exception)


def test_from_an_inventory_to_a_closed_fleet_on_three_machines(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    base, config = tmp_path / "base", tmp_path / "base" / "config" / "nufleet"
    config.mkdir(parents=True)
    monkeypatch.chdir(base)
    Path("lab.toml").write_text(INVENTORY + "".join(ROBOT.format(robot) for robot in ROBOTS))
    nufleet("fleet", "init", "lab.toml")
    nufleet("fleet", "enroll", "desk", "--out", str(config))

    with star(*ROBOTS, "stranger") as network, ExitStack() as programs:

        def start(
            what: str, where: Path, machine: Namespace, *arguments: str, **environment: str
        ) -> Program:
            # As on a machine of its own: nothing is known here but what lies in this folder.
            known = {"XDG_CONFIG_HOME": str(where / "config"), "NUFLEET_OPEN": "0", **environment}
            program = Program(what, [*arguments], where, namespace=machine, environment=known)
            return programs.enter_context(program)

        for cable in network.cables.values():  # all machines reach the base at one address
            cable.far.ip("route", "add", "default", "via", cable.address[:-1] + "1")
        configuration = "lab.authority/router/router.json5"
        router = start(
            *("router", base, network.hub, "router", "--config", configuration),
            "--until-stdin-closes",
        )
        router.wait_for("router listening on")

        agents = []
        for robot in ROBOTS:
            own = tmp_path / robot
            own.mkdir()
            folder = own / "config" / "nufleet"
            nufleet("fleet", "request", robot, "--folder", str(folder))
            nufleet("fleet", "enroll", robot, "--request", str(folder / f"{robot}.request"))
            shutil.move(f"{robot}.nufleet", folder)
            (own / "fleet.toml").write_text(f'schema = 1\nname = "lab"\n{ROBOT.format(robot)}')
            agents.append(
                start(
                    *(robot, own, network.cables[robot].far, "agent", "fleet.toml"),
                    *("--state", str(own / "state"), "--until-stdin-closes"),
                )
            )
        for agent in agents:
            agent.wait_for("of fleet lab at identity/")

        stranger = tmp_path / "stranger"
        stranger.mkdir()
        plain = ("--connect", "tcp/10.213.0.1:7447", "--open")
        tls = ("--connect", "tls/10.213.0.1:7447")
        attempts = [
            start(f"stranger {k}", stranger, network.cables["stranger"].far, *arguments)
            for k, arguments in enumerate(
                [("stop", "--all", *plain), ("fleet", "status", *tls)],
            )
        ]
        assert [attempt.wait() for attempt in attempts] == [1, 1]
        assert all("no router answers" in attempt.said for attempt in attempts)

        status = start("status", base, network.hub, "fleet", "status", "--json")
        assert status.wait() == 0
        states = json.loads(status.said[status.said.index('{"schema"') :])["robots"]
        assert {robot: state["status"] for robot, state in states.items()} == {
            "drone-7": "idle",
            "drone-8": "idle",
        }
        stop = start("stop", base, network.hub, "stop", "--all")
        assert stop.wait() == 0
        assert all(f"{robot} is stopped" in stop.said for robot in ROBOTS)
