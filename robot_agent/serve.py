"""Builds robots of a fleet file, and runs the agents that serve them in one process."""

from __future__ import annotations

import gc
import os
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, nullcontext
from functools import partial
from pathlib import Path

import click
import numpy as np

from nufleet.robot_agent.agent import Agent
from nufleet.robot_agent.motion.promptness import Promptness
from nufleet.robot_agent.network.squad import Squad
from nufleet.robot_agent.robot import Robot
from nufleet.shared.errors import FleetFileError, NufleetError, RobotError
from nufleet.shared.interrupts import Interrupts
from nufleet.shared.lifeline import when_stdin_closes
from nufleet.shared.redaction import without_secrets
from nufleet.shared.robots.drivers import load_driver, settings_of, shared_thing
from nufleet.shared.robots.fleet_file import FleetFile
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.session import Session
from nufleet.shared.wire.transport import open_client

LANDING = "landing: the robots are coming to rest, and then this process ends by itself"

SWITCH_PER_ROBOT_S = 2e-4
"""Time in s, per robot of a process of simulated ones, that a thread waits for Python's interpreter
before it asks for it again, so that all that wait ask 5000 times a second at most. At Python's own
5 ms, the threads of 500 moving robots fill a processor with nothing else, and all come too late."""
MANY_ROBOTS = 100
"""Number of simulated robots above which their process gives way to other programs."""
NICENESS = 5
"""Niceness of such a process. Linux divides the processors among threads, not among programs, and
the command that stops hundreds of robots is a single thread."""


def build_robots(fleet: FleetFile, path: Path, names: tuple[str, ...]) -> dict[str, Robot]:
    """Build some robots of a fleet file.

    A robot's noise depends on the fleet's seed and on the robot's place in the file, not on the
    other robots of its process. Robots that share one simulator are the exception: they share its
    stream of noise, too.

    Args:
        fleet: Content of the fleet file.
        path: Path of the file, for errors.
        names: Names of the robots to build.

    Returns:
        The robots, disconnected, by name, in the order of `names`.

    Raises:
        FleetFileError: A name is not in the file, or a driver or setting is invalid.
    """
    unknown = [name for name in names if name not in fleet.robots]
    if unknown:
        raise FleetFileError(
            f"{path}: no robot {unknown[0]!r}; there are {', '.join(fleet.robots)}"
        )
    by_driver: dict[str, list[str]] = {}
    for name in (name for name in fleet.robots if name in names):
        by_driver.setdefault(fleet.robots[name].driver, []).append(name)
    places = {name: place for place, name in enumerate(fleet.robots)}
    built: dict[str, Robot] = {}
    for driver_name, members in by_driver.items():
        driver = load_driver(driver_name)
        settings = settings_of(fleet, path, members, driver)
        groups: dict[str, list[str]] = {}
        for name in members:
            shared = shared_thing(driver, partial(settings.__getitem__, name))
            groups.setdefault(f"alone: {name}" if shared is None else shared, []).append(name)
        for group in groups.values():
            rng = np.random.default_rng([fleet.seed, places[group[0]]])
            built.update(driver.build({name: settings[name] for name in group}, rng))
    return {name: built[name] for name in names}


def serve(
    fleet: FleetFile,
    path: Path,
    *,
    addresses: Mapping[str, str],
    realtime: float | None,
    until_stdin_closes: bool,
    state_folder: Path,
) -> None:
    """Serve robots until the process is interrupted or, on request, standard input closes.

    Each real robot has a session of its own, so that losing one session affects no other robot.
    Simulated robots with the same address share one, since every session has its own cost. Once the
    shutdown has begun it cannot be interrupted again: it lasts until every robot is at rest, or was
    found not to come to rest.

    Args:
        fleet: Content of the fleet file.
        path: Path of the file, for errors.
        addresses: Robots to serve, by name, with the address of the fleet for each: an endpoint, or
            the address of the robot's identity.
        realtime: Multiple of real time at which simulated robots play; None for as fast as they
            can.
        until_stdin_closes: Whether to end when standard input closes.
        state_folder: Folder for the state that has to survive the agents; each robot's lies in a
            subfolder named after its fleet and itself.
    """
    robots = build_robots(fleet, path, tuple(addresses))
    ended = threading.Event()
    if until_stdin_closes:
        when_stdin_closes(ended.set)
    keys = FleetKeys(fleet.name)
    with (
        considerate(tuple(robots.values())),
        Interrupts(LANDING) as interrupts,
        ExitStack() as opened,
        closed_together() as agents,
    ):
        sessions, promptness = Sessions(opened, ended, keys), Promptness()
        try:
            for name, robot in robots.items():
                own = state_folder / fleet.name / name
                session, squad = sessions.session(addresses[name], shared=robot.spec.simulated)
                agent = Agent(
                    session,
                    keys,
                    name,
                    robot,
                    realtime=realtime,
                    state_folder=own,
                    policy=fleet.robots[name],
                    squad=squad,
                    prompt=nullcontext if robot.spec.simulated else promptness.motion,
                )
                agents.append(agent.__enter__())
            at = ", ".join(sorted({without_secrets(address) for address in addresses.values()}))
            names = ", ".join(addresses)
            # What was loaded stays; a look for garbage in it would interrupt a control loop.
            gc.freeze()
            click.echo(f"serving {names} of fleet {fleet.name} at {at}", err=True)
            ended.wait()
        finally:
            interrupts.hold()


@contextmanager
def considerate(robots: Sequence[Robot]) -> Iterator[None]:
    """Let the threads of many robots wait for longer, unless one is real and has to be prompt."""
    before_s = sys.getswitchinterval()
    if all(robot.spec.simulated for robot in robots):
        sys.setswitchinterval(max(before_s, SWITCH_PER_ROBOT_S * len(robots)))
        if len(robots) > MANY_ROBOTS:
            os.nice(NICENESS)
    try:
        yield
    finally:
        sys.setswitchinterval(before_s)


class Sessions:
    """The sessions of one process, opened when the first robot needs them."""

    def __init__(self, opened: ExitStack, given_up: threading.Event, keys: FleetKeys) -> None:
        """Open none yet.

        Args:
            opened: Stack on which they are closed.
            given_up: Event that ends the attempts to reach a router.
            keys: Keys of the fleet.
        """
        self._opened, self._given_up, self._keys = opened, given_up, keys
        self._shared: dict[str, tuple[Session, Squad]] = {}

    def session(self, address: str, *, shared: bool) -> tuple[Session, Squad | None]:
        """Return a session at an address, which all share that may, and their squad.

        A robot with a session of its own is alone in a squad of its own.

        Raises:
            NoRouterError: No router answers, or it does not list the identity.
        """
        if shared and address in self._shared:
            return self._shared[address]
        session = open_client(address, timeout_s=None, given_up=self._given_up)
        entered = self._opened.enter_context(session)
        entered.check_admitted()
        if not shared:
            return entered, None
        squad = self._opened.enter_context(Squad(entered, self._keys))
        self._shared[address] = entered, squad
        return entered, squad


@contextmanager
def closed_together() -> Iterator[list[Agent]]:
    """Yield a list for agents that serve; at the end, all agents in it are closed at the same time.

    Raises:
        RobotError: Some robots could not be left at rest; the error names each of them.
    """
    agents: list[Agent] = []
    try:
        yield agents
    finally:
        _close_together(agents)


def _close_together(agents: Sequence[Agent]) -> None:
    # Halt all before closing any, so that no robot keeps flying while another comes to rest.
    for agent in agents:
        agent.halt()
    if not agents:
        return
    with ThreadPoolExecutor(len(agents), thread_name_prefix="closing") as pool:
        closing = {agent.name: pool.submit(agent.close) for agent in agents}
    errors = {name: error for name, one in closing.items() if (error := one.exception())}
    for error in errors.values():
        if not isinstance(error, NufleetError):
            raise error
    if errors:
        raise RobotError("; ".join(f"{name}: {error}" for name, error in errors.items()))
