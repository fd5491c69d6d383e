"""What deploy/ ships works with the program it ships for."""

from __future__ import annotations

import re
import shlex
import subprocess
from importlib.metadata import PackageNotFoundError, requires
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name
from polling import PATIENCE_S, wait_until

from deploy import lock
from nufleet.orchestrator.fleet.processes import GRACE_S
from nufleet.robot_agent.motion.watched_robot import SLOW_CALL_MAX_S
from nufleet.shared.command_line import command_line
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.fleet_file import read_fleet_file
from nufleet.shared.wire import codec
from nufleet.shared.wire.limits import FULL_LINK_WAIT_US, MAX_MESSAGE_BYTES
from nufleet.shared.wire.transport import open_client, open_configured_router

DEPLOY = Path(__file__).parents[1] / "deploy"
UNITS = sorted(DEPLOY.glob("systemd/*.service"))


def test_the_router_configuration_opens_a_router_that_clients_reach(tmp_path: Path) -> None:
    shipped = (DEPLOY / "zenoh" / "router.json5").read_text()
    assert "tcp/0.0.0.0:7447" in shipped
    private = tmp_path / "router.json5"
    private.write_text(shipped.replace("tcp/0.0.0.0:7447", "tcp/127.0.0.1:0"))
    with open_configured_router(private, allow_open=False) as router:
        (endpoint,) = router.listening_on()
        with (
            open_client(endpoint, timeout_s=PATIENCE_S) as one,
            open_client(endpoint, timeout_s=PATIENCE_S) as other,
        ):
            one.declare_alive("nufleet/lab/robot/r1/alive")
            # A token takes a moment to reach the router and the other side of it.
            wait_until(
                lambda: (
                    other.alive("nufleet/*/robot/*/alive", timeout_s=PATIENCE_S)
                    == ["nufleet/lab/robot/r1/alive"]
                )
            )


def test_the_shipped_router_waits_for_and_takes_as_much_as_our_own() -> None:
    shipped = (DEPLOY / "zenoh" / "router.json5").read_text()
    assert f"block: {{ wait_before_close: {FULL_LINK_WAIT_US} }}" in shipped
    assert f"max_message_size: {MAX_MESSAGE_BYTES} }}" in shipped
    # What `encode` refuses is not lost without a word on its way.
    assert codec.MAX_MESSAGE_BYTES + 2**16 < MAX_MESSAGE_BYTES


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_a_service_runs_a_command_that_exists_with_options_that_it_takes(unit: Path) -> None:
    line = next(ln for ln in unit.read_text().splitlines() if ln.startswith("ExecStart="))
    program, name, *arguments = shlex.split(line.removeprefix("ExecStart="))
    assert program.endswith("/bin/nufleet")
    root = command_line()
    command = root.get_command(
        root.make_context("nufleet", ["--verbose"], resilient_parsing=True), name
    )
    assert command is not None
    command.make_context(name, list(arguments))


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_what_a_service_writes_is_nobody_elses_to_read(unit: Path) -> None:
    lines = unit.read_text().splitlines()
    assert "UMask=0077" in lines
    if "StateDirectory=nufleet" in lines:
        assert "StateDirectoryMode=0700" in lines


@pytest.mark.parametrize("unit", UNITS, ids=lambda unit: unit.name)
def test_a_service_has_no_more_rights_than_it_needs(unit: Path) -> None:
    """`systemd-analyze security --offline=true` rates the agent 2.1 and the router 1.3."""
    lines = set(unit.read_text().splitlines())
    assert {
        *("NoNewPrivileges=yes", "CapabilityBoundingSet=", "RestrictNamespaces=yes"),
        *("SystemCallFilter=@system-service", "SystemCallArchitectures=native"),
        *("ProtectSystem=strict", "ProtectHome=yes", "ProtectProc=invisible", "ProtectClock=yes"),
        *("ProtectKernelModules=yes", "ProtectKernelTunables=yes", "ProtectControlGroups=yes"),
        *("PrivateTmp=yes", "RestrictSUIDSGID=yes", "LockPersonality=yes", "User=nufleet"),
    } <= lines
    assert any(line.startswith("MemoryMax=") for line in lines)


def test_an_open_router_is_reached_by_its_own_machine_alone() -> None:
    compose = (DEPLOY / "containers" / "compose.yaml").read_text()
    ports = [line.strip() for line in compose.splitlines() if "ports:" in line]
    assert ports == ['ports: ["127.0.0.1:7447:7447"]']
    with pytest.raises(InvalidInputError, match=r"tcp/0\.0\.0\.0:7447 is open.*--open"):
        open_configured_router(DEPLOY / "zenoh" / "router.json5", allow_open=False).__enter__()


def test_an_agents_service_and_its_container_keep_its_state() -> None:
    unit = (DEPLOY / "systemd" / "nufleet-agent@.service").read_text()
    assert "StateDirectory=nufleet\n" in unit
    assert " --state %S/nufleet\n" in unit
    kept = next(
        line.split("=")[1]
        for line in (DEPLOY / "containers" / "Dockerfile").read_text().splitlines()
        if line.startswith("ENV NUFLEET_STATE=")
    )
    compose = (DEPLOY / "containers" / "compose.yaml").read_text()
    agent = compose.split("x-agent:")[1].split("services:")[0]
    assert f'volumes: ["state:{kept}"]' in agent


def test_whoever_ends_an_agent_gives_its_robots_the_time_to_land() -> None:
    """Or to find that they do not: only then may it be killed."""
    unit = (DEPLOY / "systemd" / "nufleet-agent@.service").read_text()
    compose = (DEPLOY / "containers" / "compose.yaml").read_text()
    for patience_s in (
        GRACE_S,
        float(unit.split("TimeoutStopSec=")[1].split()[0]),
        float(compose.split("stop_grace_period: ")[1].split("s")[0]),
    ):
        assert patience_s >= SLOW_CALL_MAX_S + 20.0


def test_the_compose_file_names_robots_that_its_fleet_file_has() -> None:
    compose = (DEPLOY / "containers" / "compose.yaml").read_text()
    fleet = read_fleet_file(DEPLOY.parent / "sims" / "fleets" / "paper_linear.toml")
    named = {
        line.split('"--robot", "')[1].split('"')[0]
        for line in compose.splitlines()
        if '"--robot", "' in line
    }
    assert named == set(fleet.robots)


def pinned(text: str) -> dict[str, str]:
    """Version of each distribution of a requirements or constraints file, by normalised name."""
    lines = (line for line in text.splitlines() if "==" in line and not line.startswith("#"))
    pairs = (line.removesuffix(" \\").split("==") for line in lines)
    return {canonicalize_name(name): version for name, version in pairs}


def test_hashed_requirements_are_those_of_the_constraints_and_hold_all_that_is_needed() -> None:
    text = (DEPLOY / "requirements.txt").read_text()
    constraints = pinned((DEPLOY.parent / "constraints.txt").read_text())
    hashed = pinned(text)
    assert {name: constraints.get(name) for name in hashed} == hashed
    assert {canonicalize_name(Requirement(one).name) for one in lock.needed()} <= hashed.keys()
    one = r"[A-Za-z0-9._-]+==[^ \n]+( \\\n    --hash=sha256:[0-9a-f]{64})+\n"
    assert re.fullmatch(f"(#.*\n)+({one})+", text)


def test_what_is_installed_from_hashed_requirements_needs_nothing_else() -> None:
    hashed = pinned((DEPLOY / "requirements.txt").read_text())
    for name in hashed:
        try:
            required = requires(name) or []
        except PackageNotFoundError:  # of an extra that these tests do not need
            continue
        for one in map(Requirement, required):
            if one.marker is None or one.marker.evaluate({"extra": ""}):
                assert canonicalize_name(one.name) in hashed, f"{name} needs {one}"


def test_containers_are_built_from_hashed_files_on_an_image_that_is_named_by_its_digest() -> None:
    dockerfile = (DEPLOY / "containers" / "Dockerfile").read_text()
    images = [line.split()[1] for line in dockerfile.splitlines() if line.startswith("FROM ")]
    assert images == ["${BASE}"]
    assert "ARG BASE\nFROM" in dockerfile  # without a default, which would age
    assert "pip install --no-cache-dir --require-hashes -r requirements.txt" in dockerfile
    assert "${NUFLEET_BASE:?" in (DEPLOY / "containers" / "compose.yaml").read_text()
    check = dockerfile.split("RUN ")[1].split("WORKDIR")[0].replace("\\\n", " ")
    for image, accepted in (
        (f"python:3.11-slim@sha256:{'0' * 64}", True),
        ("python:3.11-slim", False),
        ("python:3.11-slim@sha256:0123", False),
    ):
        done = subprocess.run(["sh", "-c", check], env={"BASE": image}, capture_output=True)
        assert (done.returncode == 0) == accepted, image
