"""The commands that close a fleet, in the order in which a user types them."""

from __future__ import annotations

import os
import shutil
from contextlib import ExitStack
from pathlib import Path

import pytest
from click.testing import CliRunner, Result
from closed_lab import KEYS, inventory_text
from polling import PATIENCE_S
from ports import free_port
from puppet_robot import PuppetRobot

from nufleet.robot_agent.agent import Agent
from nufleet.shared.command_line import command_line
from nufleet.shared.errors import NoRouterError, NufleetError
from nufleet.shared.wire.handshake import why_refused
from nufleet.shared.wire.identity import address_of, read_identity
from nufleet.shared.wire.transport import open_client, open_configured_router

CONFIGURATION = Path("lab.authority/router/router.json5")


def nufleet(*arguments: str, **environment: str) -> Result:
    done = CliRunner().invoke(command_line(), arguments, env=environment)
    if done.exception is not None and not isinstance(done.exception, SystemExit | NufleetError):
        raise done.exception
    return done


def succeeded(*arguments: str, **environment: str) -> str:
    done = nufleet(*arguments, **environment)
    assert done.exit_code == 0, (done.output, done.exception)
    return done.output


@pytest.fixture
def here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "200")
    (tmp_path / "lab.toml").write_text(inventory_text(free_port(), "a"))
    return tmp_path


def test_a_fleet_is_closed_and_its_principals_are_known_by_their_identities(here: Path) -> None:
    assert "router --config lab.authority/router/router.json5" in succeeded(
        "fleet", "init", "lab.toml"
    )
    succeeded("fleet", "request", "a", "--folder", "robot")
    assert "until" in succeeded("fleet", "enroll", "a", "--request", "robot/a.request")
    shutil.move("a.nufleet", "robot")
    for name in ("desk", "anna", "screen"):
        succeeded("fleet", "enroll", name, "--out", "ids")
    with ExitStack() as stack:
        stack.enter_context(open_configured_router(CONFIGURATION, allow_open=False))
        session = stack.enter_context(
            open_client(address_of(Path("robot/a.nufleet")), timeout_s=PATIENCE_S)
        )
        stack.enter_context(Agent(session, KEYS, "a", PuppetRobot(), realtime=None))

        assert '"a": {"robot":"a"' in succeeded(
            "fleet", "status", "--json", "--identity", "ids/screen.nufleet"
        ).replace('{"robot": "a"', '{"robot":"a"')
        who = succeeded("fleet", "who", NUFLEET_IDENTITY="ids/desk.nufleet")
        rows = {
            cells[1].strip(): [cell.strip() for cell in cells[2:-1]]
            for line in who.splitlines()
            if len(cells := line.replace("┃", "│").split("│")) > 4
        }
        assert (rows["a"][0], rows["a"][2]) == ("robot", "yes")
        assert (rows["desk"][0], rows["desk"][2]) == ("orchestrator", "yes")
        assert (rows["screen"][0], rows["screen"][2]) == ("watcher", "no")
        assert rows["otto"][1] == "not enrolled"
        assert "90 d left" in rows["anna"][1]

        asked = nufleet("fleet", "who", NUFLEET_IDENTITY="ids/screen.nufleet")
        assert "not known" in asked.output
        assert "does not tell screen who is connected" in str(asked.exception)

        for command in (
            ("train", "--robot", "a"),
            ("transfer", "--target", "a", "--source", "none"),
        ):
            refused = nufleet(*command, "--identity", "ids/anna.nufleet")
            assert "anna may not ask robots of fleet lab to move" in str(refused.exception)
            assert "because it is an operator in the inventory" in str(refused.exception)
            assert "flies" not in refused.output  # nothing is announced that will not happen

        for name, found in (
            ("ids/desk.nufleet", "lab: a"),
            ("robot/a.nufleet", "lab: a robot may not see the others"),
            ("ids/gone.nufleet", "gone.nufleet: cannot be read"),
        ):
            said = " ".join(nufleet("doctor", "--identity", name).output.split())
            assert found in said

        config = here / "config" / "nufleet"
        config.mkdir(parents=True)
        for name in ("anna.nufleet", "anna.key"):
            shutil.copy(Path("ids", name), config)
        assert "a is stopped" in succeeded("stop", "--all")
        assert nufleet("release", "a").exit_code == 1
        # With a second identity, of a fleet whose router is down, a stop neither asks nor waits.
        elsewhere = (config / "anna.nufleet").read_text().replace("127.0.0.1", "127.0.0.9")
        (config / "aaa.nufleet").write_text(elsewhere)
        shutil.copy("ids/anna.key", config / "aaa.key")
        both = nufleet("stop", "a")
        assert both.exit_code == 1
        stopped = both.output.index("a is stopped")
        assert stopped < both.output.index("anna cannot reach the router at tls/127.0.0.9")
        assert "a may move again" in succeeded("release", "a", "--identity", "ids/desk.nufleet")
        said = nufleet("stop", "--all", "--identity", "ids/screen.nufleet")
        assert said.exit_code == 1
        assert "screen may not ask 'stop'" in said.output


def test_a_revoked_identity_is_told_so_after_the_router_was_restarted(here: Path) -> None:
    succeeded("fleet", "init", "lab.toml")
    succeeded("fleet", "enroll", "desk")
    assert "restart the router now" in succeeded("fleet", "revoke", "desk")
    with open_configured_router(CONFIGURATION, allow_open=False):
        done = nufleet("fleet", "status", "--identity", "desk.nufleet")
        assert isinstance(done.exception, NoRouterError)
        assert "is not in the list of the router" in str(done.exception)
        assert "it was revoked" in str(done.exception)
        (here / "desk.key").unlink()
        succeeded("fleet", "enroll", "desk")
        assert "fleet lab" in succeeded("fleet", "status", "--identity", "desk.nufleet")


def test_all_identities_and_the_router_can_be_renewed(here: Path) -> None:
    succeeded("fleet", "init", "lab.toml")
    for name in ("desk", "anna"):
        succeeded("fleet", "enroll", name, "--days", "1")
    before = {path: path.read_bytes() for path in here.rglob("*") if path.is_file()}
    said = succeeded("fleet", "renew", "--days", "30")
    assert "desk.nufleet" in said
    assert "anna.nufleet" in said
    assert "restart the router" in succeeded("fleet", "renew", "--router")
    changed = {p.name for p, was in before.items() if p.read_bytes() != was}
    assert changed == {"desk.nufleet", "anna.nufleet", "issued.json", "router.pem"}
    inventory = here / "lab.toml"
    inventory.write_text(inventory.read_text().replace("[orchestrators.desk]\n", ""))
    said = succeeded("fleet", "renew")
    assert "desk is no longer in the inventory and is not renewed" in said
    assert "wrote anna.nufleet" in said


def test_the_authority_is_replaced_without_a_day_on_which_nobody_connects(here: Path) -> None:
    succeeded("fleet", "init", "lab.toml")
    for name in ("desk", "laptop"):
        succeeded("fleet", "enroll", name)
    said = succeeded("fleet", "renew", "--replace-authority")
    assert "a new authority signs from now on" in said
    succeeded("fleet", "renew", "desk")
    with open_configured_router(CONFIGURATION, allow_open=False):
        for name in ("desk", "laptop"):
            status = succeeded("fleet", "status", "--identity", f"{name}.nufleet")
            assert "fleet lab" in status
    succeeded("fleet", "renew", "--out", "later")
    shutil.copy("later/desk.nufleet", "desk.nufleet")
    assert "is trusted no longer" in succeeded("fleet", "renew", "--replace-authority")
    with open_configured_router(CONFIGURATION, allow_open=False):
        assert "fleet lab" in succeeded("fleet", "status", "--identity", "desk.nufleet")
        late = why_refused(read_identity(Path("laptop.nufleet")))
        assert late is not None
        assert "its authority was replaced" in late


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("router", "--listen", "tcp/0.0.0.0:7447"), "tcp/0.0.0.0:7447 is open"),
        (("fleet", "up", "paper_linear", "--listen", "tcp/0.0.0.0:7447"), "is open"),
        (("fleet", "status", "--connect", "tcp/192.168.1.10:7447"), "is open"),
        (("agent", "lab.toml", "--connect", "tcp/192.168.1.10:7447"), "is open"),
        (("fleet", "status", "--identity", "none.nufleet"), "cannot be read"),
        (("agent", "lab.toml", "--identity", "none.nufleet"), "cannot be read"),
        (("fleet", "who"), "which authority? there is none here"),
        (("fleet", "request", "Desk"), "'Desk' is not a name"),
        (("fleet", "init", "none.toml"), "cannot be read"),
    ],
)
def test_what_is_wrong_is_said_before_anything_begins(
    arguments: tuple[str, ...], words: str, here: Path
) -> None:
    done = nufleet(*arguments)
    assert isinstance(done.exception, NufleetError)
    assert words in str(done.exception)
    assert done.exception.exit_code == 2


def test_no_key_is_printed_or_named_by_a_message(here: Path) -> None:
    said = succeeded("fleet", "init", "lab.toml") + succeeded("fleet", "enroll", "desk")
    said += succeeded("fleet", "revoke", "desk")
    with open_configured_router(CONFIGURATION, allow_open=False):
        said += str(nufleet("fleet", "status", "--identity", "desk.nufleet").exception)
    assert "is not in the list of the router" in said
    secrets = [
        line
        for path in here.rglob("*.key")
        for line in path.read_text().splitlines()
        if not line.startswith("-----")
    ]
    assert len(secrets) == 3
    assert not any(secret in said for secret in secrets)
    assert not any(
        secret in path.read_text()
        for path in here.rglob("*")
        if path.is_file() and path.suffix != ".key"
        for secret in secrets
    )
    assert not any(secret in value for value in os.environ.values() for secret in secrets)
