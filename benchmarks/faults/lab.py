"""A fleet of real processes whose every part can fail: a router, agents, orchestrators."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from benchmarks.faults.logbook import Entry, Stretch, die_at, install_driver, motions, read_logbook
from benchmarks.faults.namespaces import Namespace
from benchmarks.faults.program import PATIENCE_S, Program
from benchmarks.faults.study_process import TERM_S
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.robot_watch import RobotWatch
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import RobotState
from nufleet.shared.wire.transport import open_client

FLEET = "lab"
KEYS = FleetKeys(FLEET)

SECTION_V = {"target": 0.85, "near": 0.9, "far": 1.2}
"""Robots of Section V by their α; without noise, so that every study of them ends alike."""


class Lab:
    """Starts the parts of one fleet in a folder of their own; what is entered here is ended here.

    Robots keep logbooks of when they move; see `benchmarks.faults.logbook`.
    """

    def __init__(self, folder: Path, stack: ExitStack) -> None:
        self.folder = folder
        self.socket = folder / "r.sock"
        self.endpoint = f"unixsock-stream/{self.socket}"
        self._stack = stack
        self._robots: dict[str, dict[str, Any]] = {}
        self._commands = 0
        install_driver(folder)

    def close(self) -> None:
        """End everything that was started here, last begun first."""
        self._stack.close()

    @property
    def fleet_file(self) -> Path:
        """Where the fleet is described."""
        return self.folder / "fleet.toml"

    @property
    def state_folder(self) -> Path:
        """Where agents keep what has to survive them."""
        return self.folder / "state"

    def describe(self, robots: Mapping[str, Mapping[str, Any]], **beside: float | str) -> None:
        """Write the fleet file.

        Args:
            robots: Driver and settings of each robot, by name.
            beside: Settings of `LoggedRobot` for all of them, such as `rest_s`.
        """
        lines = ["schema = 1", f'name = "{FLEET}"']
        for name, robot in robots.items():
            logged = {**robot, "logbook": str(self.folder / f"{name}.logbook"), **beside}
            lines += [f"[robots.{name}]", 'driver = "logged"', f"settings = {_toml(logged)}"]
        self.fleet_file.write_text("\n".join(lines) + "\n")
        self._robots = {name: dict(robot) for name, robot in robots.items()}

    def describe_section_v(
        self, alphas: Mapping[str, float] = SECTION_V, **beside: float | str
    ) -> None:
        """Write a fleet of Section V robots, each given by its α; for `beside` see `describe`."""
        self.describe({name: double_integrator(a) for name, a in alphas.items()}, **beside)

    @property
    def robots(self) -> tuple[str, ...]:
        """Who is described."""
        return tuple(self._robots)

    def journal(self, robot: str) -> Path:
        """Return where a robot's agents write down what they accepted."""
        return self.state_folder / FLEET / robot / "journal"

    def router(self, *more: str, namespace: Namespace | None = None) -> Program:
        """Start a router that listens at `endpoint` and more; returns when it does."""
        listen = [part for one in (self.endpoint, *more) for part in ("--listen", one)]
        arguments = ["router", *listen, "--until-stdin-closes"]
        router = Program("router", arguments, self.folder, namespace=namespace)
        self._stack.enter_context(router)
        router.wait_for("router listening on")
        return router

    def agent(
        self,
        *robots: str,
        connect: str | None = None,
        realtime: float | None = None,
        namespace: Namespace | None = None,
        environment: Mapping[str, str] | None = None,
        state_folder: Path | None = None,
    ) -> Program:
        """Start one process for some robots; it may not be there yet."""
        arguments = ["agent", str(self.fleet_file), "--connect", connect or self.endpoint]
        arguments += [part for robot in robots for part in ("--robot", robot)]
        arguments += ["--state", str(state_folder or self.state_folder), "--until-stdin-closes"]
        if realtime is not None:
            arguments += ["--realtime", str(realtime)]
        what = f"agent of {' and '.join(robots)}"
        agent = Program(what, arguments, self.folder, namespace=namespace, environment=environment)
        return self._stack.enter_context(agent)

    def orchestrator(
        self, *robots: str, name: str = "orchestrator-1", connect: str | None = None
    ) -> Fleet:
        """Be an orchestrator of the fleet to the end; returns once these robots are there."""
        return self._stack.enter_context(self.joined(*robots, name=name, connect=connect))

    @contextmanager
    def joined(
        self, *robots: str, name: str = "orchestrator-1", connect: str | None = None
    ) -> Iterator[Fleet]:
        """Be an orchestrator of the fleet for a while."""
        with open_client(connect or self.endpoint, timeout_s=PATIENCE_S) as session:
            fleet = Fleet(session, KEYS, name)
            fleet.wait_for(robots, timeout_s=PATIENCE_S)
            yield fleet

    def command(self, *arguments: str) -> Program:
        """Start any other `nufleet` command."""
        self._commands += 1
        what = f"{arguments[0]} {self._commands}"
        return self._stack.enter_context(Program(what, list(arguments), self.folder))

    def study(
        self,
        study_id: str,
        database: Path,
        robots: tuple[str, ...],
        *,
        iterations: int,
        connect: str | None = None,
        term_s: float = TERM_S,
    ) -> Program:
        """Start an orchestrator that begins or resumes a study of robots, target first."""
        self._commands += 1
        arguments = ["--connect", connect or self.endpoint, "--database", str(database)]
        arguments += ["--study", study_id, "--iterations", str(iterations)]
        arguments += ["--term-s", str(term_s)]
        arguments += ["--owner", f"orchestrator-{self._commands}", "--robots", *robots]
        study = Program(
            f"{study_id} {self._commands}",
            arguments,
            self.folder,
            module="benchmarks.faults.study_process",
        )
        return self._stack.enter_context(study)

    def owner(
        self,
        robot: str,
        name: str,
        epoch: int,
        *,
        connect: str,
        namespace: Namespace | None = None,
    ) -> Program:
        """Start an orchestrator that moves a robot for as long as it may."""
        arguments = ["--fleet", FLEET, "--robot", robot, "--name", name, "--epoch", str(epoch)]
        owner = Program(
            name,
            [*arguments, "--connect", connect],
            self.folder,
            module="benchmarks.faults.remote_owner",
            namespace=namespace,
        )
        return self._stack.enter_context(owner)

    @staticmethod
    def wait_for_state(
        fleet: Fleet, robot: str, condition: Callable[[RobotState], bool]
    ) -> RobotState:
        """Wait until a robot publishes a state that fulfils a condition, and return it."""
        found: list[RobotState] = []

        def fulfilled(watch: RobotWatch) -> bool:
            state = watch.state
            if state is not None and condition(state):
                found.append(state)
            return bool(found)

        if not fleet.watch(robot).wait_until(fulfilled, timeout_s=PATIENCE_S):
            raise AssertionError(f"{robot} stays {fleet.watch(robot).state}")
        return found[0]

    def logbook(self, robot: str) -> list[Entry]:
        """Return what a robot wrote down."""
        return read_logbook(self.folder / f"{robot}.logbook")

    def kill_at(self, robot: str, moment: str) -> None:
        """Have a robot's agent be killed, once, at a moment that its logbook knows."""
        die_at(self.folder / f"{robot}.logbook", moment)

    def motions(self, robot: str) -> list[Stretch]:
        """Return the motions that a robot made, in all its agents' lives."""
        return motions(self.logbook(robot))


@contextmanager
def opened_lab(folder: Path) -> Iterator[Lab]:
    """Open a laboratory in a folder; everything in it ends with it, last begun first."""
    with ExitStack() as stack:
        yield Lab(folder, stack)


def double_integrator(alpha: float, **settings: Any) -> dict[str, Any]:
    """Return the entry of a Section V robot for `Lab.describe`."""
    own = {"alpha": alpha, "beta": 0.003, **settings}
    return {"driver": "double_integrator", "settings": own}


def _toml(value: Any) -> str:
    """Return a value as TOML on one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{key} = {_toml(one)}" for key, one in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_toml(one) for one in value) + "]"
    return json.dumps(value)
