"""Runs the agents of one process until they are told to end."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from pathlib import Path

import click

from robot_agent.agent import Agent
from robot_agent.fleet_robots import build_robots
from shared.fleet_file import read_fleet_file
from shared.keys import FleetKeys
from shared.lifeline import when_stdin_closes
from shared.transport import open_client


def serve(
    fleet_file: Path,
    names: tuple[str, ...],
    *,
    connect: str,
    realtime: float | None,
    until_stdin_closes: bool,
    state_folder: Path,
) -> None:
    """Serve robots until standard input closes (when asked) or the process is interrupted.

    Each robot has a session of its own, so that one that is cut off takes no other with it. What it
    has to remember lies in `state_folder`, under the names of its fleet and its own.
    """
    fleet = read_fleet_file(fleet_file)
    chosen = names or tuple(fleet.robots)
    robots = build_robots(fleet, fleet_file, chosen)
    ended = threading.Event()
    if until_stdin_closes:
        when_stdin_closes(ended.set)
    keys = FleetKeys(fleet.name)
    with ExitStack() as stack:
        for name, robot in robots.items():
            session = stack.enter_context(open_client(connect, timeout_s=None, given_up=ended))
            own = state_folder / fleet.name / name
            stack.enter_context(
                Agent(
                    session,
                    keys,
                    name,
                    robot,
                    realtime=realtime,
                    state_folder=own,
                    allow_unguarded=fleet.robots[name].allow_unguarded,
                )
            )
        click.echo(f"serving {', '.join(chosen)} of fleet {fleet.name} at {connect}", err=True)
        ended.wait()
