"""`nufleet agent`: serve one or more robots of a fleet file."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

import click

from nufleet.shared.command_line import folder_option


@click.command()
@click.argument("fleet_file", metavar="FLEET")
@click.option(
    "--robot",
    "robots",
    multiple=True,
    metavar="NAME",
    help="Serve this robot of the file; may be given several times.  [default: all of them]",
)
@click.option(
    "--connect",
    envvar="NUFLEET_ROUTER",
    metavar="ENDPOINT",
    help="Router of an open fleet.  [env: NUFLEET_ROUTER; default: tcp/127.0.0.1:7447]",
)
@click.option(
    "--identity",
    "identities",
    multiple=True,
    type=click.Path(dir_okay=False, path_type=Path),
    envvar="NUFLEET_IDENTITY",
    metavar="FILE",
    help="Identity of the robot in a closed fleet; one for each robot if there are several.  [env: "
    "NUFLEET_IDENTITY; default: those of the file's robots in ~/.config/nufleet]",
)
@click.option(
    "--open",
    "allow_open",
    is_flag=True,
    envvar="NUFLEET_OPEN",
    help="Accept a router that every machine of the network can use without proof of who it is.  "
    "[env: NUFLEET_OPEN]",
)
@click.option(
    "--realtime",
    type=click.FloatRange(min=0, min_open=True),
    metavar="FACTOR",
    help="Run simulated robots at this multiple of real time.  [default: as fast as they can]",
)
@folder_option(
    "--state",
    "state_folder",
    envvar="NUFLEET_STATE",
    help="Folder for everything that has to survive this process: the goals of each robot, whether "
    "it is stopped, what it has learned. Only one agent at a time may use a robot's part of it.  "
    "[env: NUFLEET_STATE; default: nufleet in XDG_STATE_HOME or ~/.local/state]",
)
@click.option(
    "--forget-owner",
    is_flag=True,
    help="Make the robots given with --robot forget which orchestrator commanded them and under "
    "which epoch, then exit. For a robot that has stored an epoch that no repository issues; end "
    "its agent first.",
)
@click.option("--until-stdin-closes", is_flag=True, hidden=True)
def agent(
    fleet_file: str,
    robots: tuple[str, ...],
    connect: str | None,
    identities: tuple[Path, ...],
    allow_open: bool,
    state_folder: Path | None,
    forget_owner: bool,
    **options: Any,
) -> None:
    """Serve robots of FLEET (a file, or an installed fleet's name) to the fleet.

    Runs until Ctrl-C. It waits for the router when there is none yet, and survives its restarts.
    The robot is brought to rest when this agent ends, when the orchestrator that commands it
    disappears, and when anyone stops it. A stop outlasts the agent; so does what it did, so that
    no goal moves the robot twice.
    """
    from nufleet.robot_agent.network.addresses import agent_addresses
    from nufleet.shared.robots.drivers import needed_environment
    from nufleet.shared.robots.fleet_file import find_fleet_file, read_fleet_file
    from nufleet.shared.state_folder import default_state_folder

    path = find_fleet_file(fleet_file)
    state_folder = state_folder or default_state_folder()
    if forget_owner:
        from nufleet.robot_agent.journal.forgotten_owners import forget_owners

        return forget_owners(path, robots, state_folder)
    fleet = read_fleet_file(path)
    addresses = agent_addresses(fleet, robots, connect, identities, allow_open=allow_open)
    robots = tuple(addresses)
    needed = needed_environment(fleet, [r for r in robots if r in fleet.robots])
    missing = {name: value for name, value in needed.items() if os.environ.get(name) != value}
    if missing:
        # Some simulators read these variables while they are imported, so this process starts over
        # with the variables set.
        os.execve(sys.executable, sys.orig_argv, {**os.environ, **missing})

    from nufleet.robot_agent.serve import serve

    return serve(fleet, path, addresses=addresses, state_folder=state_folder, **options)
