"""Each robot of an agent reaches its fleet as its own identity says, or all at one endpoint."""

from __future__ import annotations

from pathlib import Path

import pytest

from nufleet.robot_agent.network.addresses import agent_addresses
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.fleet_file import FleetFile
from nufleet.shared.wire.identity import Identity, identity_text

PEM = "-----BEGIN CERTIFICATE-----\nMA==\n-----END CERTIFICATE-----\n"


@pytest.fixture(autouse=True)
def _no_identity_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))


@pytest.fixture
def fleet() -> FleetFile:
    robots = {name: {"driver": "double_integrator"} for name in ("a", "b", "c")}
    return FleetFile.model_validate({"schema": 1, "name": "lab", "robots": robots})


def identity(folder: Path, robot: str, fleet: str = "lab") -> Path:
    path = folder / f"{robot}.nufleet"
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(identity_text(Identity(path, fleet, robot, "robot", "tls/base:7447", PEM, PEM)))
    path.with_suffix(".key").touch(mode=0o600)
    return path


def addresses(fleet: FleetFile, *robots: str, given: tuple[Path, ...] = ()) -> dict[str, str]:
    return agent_addresses(fleet, robots, None, given, allow_open=False)


def test_without_an_identity_all_robots_are_served_on_this_machine(fleet: FleetFile) -> None:
    assert addresses(fleet) == dict.fromkeys("abc", "tcp/127.0.0.1:7447")
    assert addresses(fleet, "b") == {"b": "tcp/127.0.0.1:7447"}


def test_with_identities_their_robots_are_served(fleet: FleetFile, tmp_path: Path) -> None:
    a, b = identity(tmp_path, "a"), identity(tmp_path, "b")
    assert addresses(fleet, given=(a, b)) == {"a": f"identity/{a}", "b": f"identity/{b}"}
    assert addresses(fleet, "b", given=(a, b)) == {"b": f"identity/{b}"}


def test_the_identity_in_the_users_folder_is_taken(fleet: FleetFile, tmp_path: Path) -> None:
    a = identity(tmp_path / "config" / "nufleet", "a")
    assert addresses(fleet) == {"a": f"identity/{a}"}


def test_an_agent_takes_the_identities_of_its_robots_among_those_of_the_user(
    fleet: FleetFile, tmp_path: Path
) -> None:
    folder = tmp_path / "config" / "nufleet"
    a, c = identity(folder, "a"), identity(folder, "c")
    for name, other, role in (("desk", "lab", "orchestrator"), ("b", "other", "robot")):
        path = identity(folder, name, other)
        path.write_text(path.read_text().replace('"robot"', f'"{role}"'))
    assert addresses(fleet) == {"a": f"identity/{a}", "c": f"identity/{c}"}
    assert addresses(fleet, "c") == {"c": f"identity/{c}"}
    with pytest.raises(InvalidInputError, match="b has no identity here: there is one for a, c"):
        addresses(fleet, "b")


def test_an_agent_that_has_no_identity_of_a_robot_says_which_it_found(
    fleet: FleetFile, tmp_path: Path
) -> None:
    path = identity(tmp_path / "config" / "nufleet", "desk")
    path.write_text(path.read_text().replace('"robot"', '"orchestrator"'))
    with pytest.raises(InvalidInputError, match="is the identity of desk, which is no robot"):
        addresses(fleet)


@pytest.mark.parametrize(
    ("robot", "of_fleet", "asked", "words"),
    [
        ("a", "other", (), "belongs to fleet other, not to lab"),
        ("desk", "lab", (), "is the identity of desk, which is no robot of the fleet file"),
        ("a", "lab", ("b",), "b has no identity here: there is one for a"),
    ],
)
def test_an_identity_that_does_not_fit_is_refused(
    robot: str,
    of_fleet: str,
    asked: tuple[str, ...],
    words: str,
    fleet: FleetFile,
    tmp_path: Path,
) -> None:
    path = identity(tmp_path, robot, of_fleet)
    with pytest.raises(InvalidInputError, match=words):
        addresses(fleet, *asked, given=(path,))


def test_an_open_router_has_to_be_accepted(fleet: FleetFile) -> None:
    with pytest.raises(InvalidInputError, match="is open"):
        agent_addresses(fleet, (), "tcp/192.168.1.10:7447", (), allow_open=False)
