"""What a command opens: step by step, and closed in reverse order wherever it ends."""

from __future__ import annotations

import io
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from polling import PATIENCE_S
from puppet_robot import PuppetRobot
from rich.console import Console

from nufleet.orchestrator.conduct.leases import HeldLeases
from nufleet.orchestrator.fleet import connection
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.reach import FleetChoice
from nufleet.orchestrator.jobs.commands import StoredCommand
from nufleet.orchestrator.jobs.opening import Opening
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.repository.errors import LeaseHeldError
from nufleet.orchestrator.repository.repository import Repository
from nufleet.orchestrator.runs.folder import CONFIGURATION, RECORDING, RunFolder
from nufleet.orchestrator.viewer.writer import RerunWriter
from nufleet.robot_agent.agent import Agent
from nufleet.shared.errors import InvalidInputError, NoRouterError
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.session import Session
from nufleet.shared.wire.transport import open_client, open_router

ENDS = {
    "recording": (RerunWriter, "close"),
    "leases": (HeldLeases, "give_back"),
    "folder": (RunFolder, "close"),
    "connection": (Session, "close"),
    "repository": (Repository, "close"),
}
"""By what is open, the method that closes it; in the order in which they are closed."""


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[FleetChoice]:
    """A running fleet of one robot."""
    endpoint = f"unixsock-stream/{tmp_path}/r.sock"
    with (
        open_router([endpoint]),
        open_client(endpoint, timeout_s=PATIENCE_S) as session,
        Agent(session, FleetKeys("lab"), "a", PuppetRobot(), realtime=None),
    ):
        yield FleetChoice.running(endpoint, "lab")


@pytest.fixture
def closed(fleet: FleetChoice, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What has been closed so far, once `fleet` is up."""
    found: list[str] = []

    def noted(name: str, close: Callable[..., object]) -> Callable[..., object]:
        def noting(*arguments: object, **options: object) -> object:
            found.append(name)
            return close(*arguments, **options)

        return noting

    for name, (kind, method) in ENDS.items():
        monkeypatch.setattr(kind, method, noted(name, getattr(kind, method)))
    return found


def opening(tmp_path: Path, console: Console | None = None) -> Opening:
    return Opening(StoredCommand(runs_root=tmp_path / "runs"), console or Console(quiet=True))


def steps(run: Opening, choice: FleetChoice) -> dict[str, Callable[[], object]]:
    """Return the steps inside the context in their order, by what each of them opens."""
    return {
        "connection": lambda: run.reach(choice, ("a",), wait_s=PATIENCE_S),
        "folder": lambda: run.keep("test"),
        "leases": lambda: run.take(run.connection.fleet.describe_all(("a",)), None),
        "recording": lambda: run.record(live=False),
    }


@pytest.mark.parametrize("last", ["connection", "folder", "leases", "recording"])
def test_what_was_opened_is_closed_in_reverse_order_when_a_command_fails(
    fleet: FleetChoice, closed: list[str], tmp_path: Path, last: str
) -> None:
    opened = ["repository"]

    def fail_after_last() -> None:
        with opening(tmp_path) as run:
            for name, step in steps(run, fleet).items():
                step()
                opened.append(name)
                if name == last:
                    raise InvalidInputError("the command cannot go on")

    with pytest.raises(InvalidInputError):
        fail_after_last()
    assert closed == opened[::-1]
    assert not list((tmp_path / "runs").glob("*/")), "a run that did not begin leaves no folder"


def test_a_live_view_of_a_run_that_draws_nothing_is_refused(tmp_path: Path) -> None:
    with opening(tmp_path) as run, pytest.raises(InvalidInputError, match="omit --no-recording"):
        run.record(live=True, draws=False)


def test_a_command_that_ends_well_says_where_its_recording_is_and_leaves_its_robots_free(
    fleet: FleetChoice, closed: list[str], tmp_path: Path
) -> None:
    said = io.StringIO()
    with opening(tmp_path, Console(file=said, soft_wrap=True)) as run:
        for step in steps(run, fleet).values():
            step()
        run.configure({"kind": "track", "repository": "postgresql://me:secret@h/d"})
        assert [*run.repository.leases.held("lab")] == ["a"]
    assert closed == [*ENDS]
    assert (run.folder.path / RECORDING).is_file()
    assert f" view {run.folder.path}" in said.getvalue()
    kept = (run.folder.path / CONFIGURATION).read_text(encoding="utf-8")
    assert '"fleet": "lab"' in kept
    assert "secret" not in kept
    with Storage(tmp_path / "runs").open() as repository:
        assert not repository.leases.held("lab")


def test_a_run_that_fails_keeps_its_folder_once_it_is_configured_and_praises_no_recording(
    fleet: FleetChoice, tmp_path: Path
) -> None:
    said = io.StringIO()
    run = opening(tmp_path, Console(file=said, soft_wrap=True))

    def fail_when_configured() -> None:
        with run:
            for step in steps(run, fleet).values():
                step()
            run.configure({"kind": "track"})
            run.say_how_to_resume()
            raise InvalidInputError("the command cannot go on")

    with pytest.raises(InvalidInputError):
        fail_when_configured()
    assert (run.folder.path / CONFIGURATION).is_file()
    assert f"runs resume {run.folder.path.name}" in said.getvalue()
    assert " view " not in said.getvalue()


def test_a_fleet_that_cannot_be_reached_leaves_nothing_open(
    closed: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "CONNECT_TIMEOUT_S", 0.2)
    nowhere = FleetChoice.running(f"unixsock-stream/{tmp_path}/nobody.sock", "lab")
    with pytest.raises(NoRouterError), opening(tmp_path) as run:
        run.reach(nowhere)
    assert closed == ["repository"]


def test_the_folder_of_a_run_whose_owner_is_alive_is_left_as_it_is(
    fleet: FleetChoice, tmp_path: Path
) -> None:
    with opening(tmp_path) as owner, ExitStack() as stack:
        for step in steps(owner, fleet).values():
            step()
        owner.configure({"kind": "track"})
        path = owner.folder.path
        before = {file.name for file in path.iterdir()}
        heir = stack.enter_context(opening(tmp_path))
        heir.reach(fleet, ("a",), wait_s=PATIENCE_S)
        with pytest.raises(LeaseHeldError):
            heir.go_on(path, heir.connection.fleet.describe_all(("a",)), None)
        assert {file.name for file in path.iterdir()} == before >= {CONFIGURATION, RECORDING}
    with opening(tmp_path) as heir:
        heir.reach(fleet, ("a",), wait_s=PATIENCE_S)
        assert heir.go_on(path, heir.connection.fleet.describe_all(("a",)), None).path == path
        assert heir.archive.leases.epochs == {"a": 2}


def test_robots_are_leased_by_the_descriptions_that_a_command_has_and_not_described_again(
    fleet: FleetChoice, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with opening(tmp_path) as run:
        run.reach(fleet, ("a",), wait_s=PATIENCE_S)
        descriptions = run.connection.fleet.describe_all(("a",))
        monkeypatch.delattr(Fleet, "describe")
        run.take(descriptions, None)
        assert run.connection.fleet.epoch("a") == 1
