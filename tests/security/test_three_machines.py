"""Fleets on three machines: a closed one beside a stranger, and an open one of linked routers.

The commands are those of `deploy/README.md`, where the second robot, and in the end the router,
are started by hand, as `docs/security.md` tells, and of `docs/scale.md`.
"""

from __future__ import annotations

import json
import os
import shlex
import shutil
import subprocess
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner
from page_blocks import ROOT, Block, blocks
from polling import wait_until

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
ROBOT = '[robots.{0}]\ndriver = "double_integrator"\nsettings = {{ alpha = {1}, beta = 0.003 }}\n'
ROBOTS = {"drone-7": 1.0, "drone-8": 0.9}
OVER_THE_NETWORK = {("fleet", "status"), ("rank",), ("stop",), ("agent",)}


def follow(page: str) -> list[Block]:
    """The blocks of a page that its reader types or writes to a file."""
    return [b for b in blocks(ROOT / page) if b.is_run or b.note.startswith("file: ")]


class Machine:
    """A machine with files of its own, below a folder, and a place in the network.

    `sudo` changes no user, and systemd is played: a unit runs the command of its file.
    """

    def __init__(self, folder: Path, network: Namespace, until: Callable[[Program], None]) -> None:
        self.folder, self.here = folder, folder / "opt" / "nufleet"
        self._network, self._until = network, until
        self._units: dict[str, Program] = {}
        for made in (self.here, folder / "etc" / "systemd" / "system"):
            made.mkdir(parents=True)
        (self.here / "deploy").symlink_to(ROOT / "deploy")

    def follow(self, block: Block, **replaced: str) -> str:
        """Type the lines of a block; return what the programs among them printed."""
        code = block.code.replace("\\\n", " ")
        for old, new in replaced.items():
            code = code.replace(old, new)
        parts = (part for line in code.splitlines() for part in line.split(" && "))
        return "".join(self.type(part) for part in parts)

    def type(self, line: str) -> str:
        """Type one command, which has to succeed."""
        words = self._words(line)
        words = words[words[0] == "sudo" :]
        words = words[2 * (words[0] == "-u") :]
        match Path(words[0]).name, *words[1:]:
            case "chown", *_:  # users are this machine's
                return ""
            case "install", "--directory", "--owner", _, *more:
                subprocess.run(["install", "--directory", *more], check=True)
                return ""
            case "cp", *_:
                subprocess.run(words, check=True, cwd=self.here)
                return ""
            case "systemctl", *_, "stop", unit:
                self._units.pop(unit).end()
                return ""
            case "systemctl", *_, unit:
                self._start(unit)
                return ""
            case "nufleet", *arguments:
                return self._run(arguments)
        raise AssertionError(f"a test cannot type {line!r}")

    def serve(self, line: str) -> Program:
        """Start what serves until the test is over, and wait until it does."""
        program = self.program(f"{line} --until-stdin-closes")
        self._until(program)
        return program

    def program(self, line: str) -> Program:
        """Return the program that a line starts, without starting it."""
        return self._program(self._words(line)[1:])

    def _words(self, line: str) -> list[str]:
        """The words of a line; each file is the one of this machine."""
        words = (word.replace("~/", "/home/") for word in shlex.split(line))
        return [f"{self.folder}{word}" if word.startswith("/") else word for word in words]

    def _program(self, arguments: list[str]) -> Program:
        # As on a machine of its own: nothing is known here but what lies in this folder.
        home = str(self.folder / "home" / ".config")
        known = {"XDG_CONFIG_HOME": home, "NUFLEET_OPEN": "0"}
        return Program(
            f"{arguments[0]} {len(list(self.here.glob('*.log')))}",
            arguments,
            self.here,
            namespace=self._network,
            environment=known,
        )

    def _run(self, arguments: list[str]) -> str:
        if any(arguments[: len(words)] == [*words] for words in OVER_THE_NETWORK):
            with self._program(arguments) as program:
                assert program.wait() == 0, program.said
                return program.said
        os.chdir(self.here)
        done = CliRunner().invoke(command_line(), arguments)
        assert done.exit_code == 0, (done.output, done.exception)
        return done.output

    def _start(self, unit: str) -> None:
        name, _, instance = unit.partition("@")
        units = self.folder / "etc" / "systemd" / "system"
        file = units / f"{name}{'@' if instance else ''}.service"
        lines = file.read_text().splitlines()
        command = next(line for line in lines if line.startswith("ExecStart="))
        command = command.removeprefix("ExecStart=").replace("%i", instance)
        self._units[unit] = self.serve(command.replace("%S", "/var/lib"))


Rack = Callable[[str, str], Machine]
"""Function that returns the machine at a place of the network, its files in a folder of that
name, and what a program says there once it serves."""


@contextmanager
def machines(folder: Path, *names: str) -> Iterator[Rack]:
    """Cable machines to a first one, which all others reach at its first address, 10.213.0.1."""
    with star(*names) as network, ExitStack() as programs:
        for cable in network.cables.values():
            cable.far.ip("route", "add", "default", "via", cable.address[:-1] + "1")

        def machine(name: str, says: str) -> Machine:
            place = network.cables[name].far if name in network.cables else network.hub

            def start(program: Program) -> None:
                programs.enter_context(program).wait_for(says)

            return Machine(folder / name, place, start)

        yield machine


@pytest.fixture
def back_here(monkeypatch: pytest.MonkeyPatch) -> None:
    """Return to the present working directory when the test is over."""
    monkeypatch.chdir(Path.cwd())


@pytest.mark.usefixtures("back_here")
def test_from_an_inventory_to_a_closed_fleet_on_three_machines(tmp_path: Path) -> None:
    closing, fleet_file, key, enrolment, serving, listing, forgetting = follow("deploy/README.md")
    with machines(tmp_path, *ROBOTS, "stranger") as machine, ExitStack() as programs:
        base = machine("base", "router listening on")
        robots = "".join(ROBOT.format(*robot) for robot in ROBOTS.items())
        (base.here / "lab.toml").write_text(INVENTORY + robots)
        base.follow(closing)

        drone_7 = machine("drone-7", "of fleet lab at identity/")
        etc = drone_7.folder / "etc" / "nufleet"
        drone_7.follow(key)
        (etc / "fleet.toml").write_text(fleet_file.code)
        shutil.move(etc / "drone-7.request", base.here)
        base.follow(enrolment)
        shutil.move(base.here / "drone-7.nufleet", etc)
        drone_7.follow(serving)

        # By hand, as docs/security.md tells.
        drone_8 = machine("drone-8", "of fleet lab at identity/")
        config = drone_8.folder / "home" / ".config" / "nufleet"
        (drone_8.here / "lab.toml").write_text(f'schema = 1\nname = "lab"\n{robots}')
        drone_8.type("nufleet fleet request drone-8 --folder ~/.config/nufleet")
        shutil.move(config / "drone-8.request", base.here)
        base.type("nufleet fleet enroll drone-8 --request drone-8.request")
        shutil.move(base.here / "drone-8.nufleet", config)
        drone_8.serve("nufleet agent lab.toml")

        stranger = machine("stranger", "")
        plain = "--connect tcp/10.213.0.1:7447 --open"
        tls = "--connect tls/10.213.0.1:7447"
        attempts = [
            programs.enter_context(stranger.program(line))
            for line in (f"nufleet stop --all {plain}", f"nufleet fleet status {tls}")
        ]
        assert [attempt.wait() for attempt in attempts] == [1, 1]
        assert all("no router answers" in attempt.said for attempt in attempts)

        shown = base.follow(listing, **{"0.1 5.4": "0.1 5.4 --no-rehearsal --no-recording"})
        assert "selected: drone-7" in shown
        assert all(robot in shown for robot in ROBOTS)

        drone_7.follow(forgetting)
        status = base.type("nufleet fleet status --json")
        states = json.loads(status[status.index('{"schema"') :])["robots"]
        assert {robot: state["status"] for robot, state in states.items()} == dict.fromkeys(
            ROBOTS, "idle"
        )
        stopped = base.type("nufleet stop --all")
        assert all(f"{robot} is stopped" in stopped for robot in ROBOTS)

        base.type("systemctl stop nufleet-router")
        base.serve("nufleet router --config lab.authority/router/router.json5")


ROUTERS = (
    "hall$ nufleet router --listen tcp/10.213.0.1:7447 --open",
    "dock-a$ nufleet router --listen tcp/10.213.0.2:7447 --connect tcp/10.213.0.1:7447 --open",
    "dock-b$ nufleet router --listen tcp/10.213.1.2:7447 --connect tcp/10.213.0.1:7447 --open",
)


@pytest.mark.usefixtures("back_here")
def test_a_robot_at_one_router_is_seen_from_another_that_a_third_one_links(tmp_path: Path) -> None:
    with machines(tmp_path, "dock-a", "dock-b") as machine:
        places = {}
        for where, command in (typed.split("$ ") for typed in ROUTERS):
            places[where] = machine(where, "router listening on")
            places[where].serve(command)
        robot = '[robots.drone-7]\ndriver = "double_integrator"\n'
        (places["dock-a"].here / "lab.toml").write_text(
            f'schema = 1\nname = "lab"\n{robot}settings = {{ alpha = 1.0, beta = 0.003 }}\n'
        )
        agent = "nufleet agent lab.toml --connect tcp/10.213.0.2:7447 --open --until-stdin-closes"
        with places["dock-a"].program(agent) as serving:
            serving.wait_for("of fleet lab at")
            status = "nufleet fleet status --connect tcp/10.213.1.2:7447 --open"
            wait_until(lambda: "drone-7" in places["dock-b"].type(status))
