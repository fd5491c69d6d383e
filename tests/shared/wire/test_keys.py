"""Keys: names and ids become part of one, and nothing else can."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.wire.keys import (
    COMMANDS,
    EVERY_FLEETS_ROBOTS_ALIVE,
    READS,
    RELEASE,
    STOP,
    FleetKeys,
    attributed,
    checked_identifier,
    checked_name,
    every_fleets_stop,
    fleet_of,
    robot_in_every_fleet,
)

names = st.from_regex(r"[a-z0-9][a-z0-9_-]{0,62}", fullmatch=True)
identifiers = st.from_regex(r"[0-9a-z][0-9a-z._-]{0,199}", fullmatch=True)
LEAVES = ("alive", "state", "goal", "telemetry/motion")

NOT_NAMES = [
    "",
    "Drone",
    "-drone",
    "_drone",
    "a b",
    "a/b",
    "a.b",
    "*",
    "**",
    "$*",
    "@adv",
    "a?b",
    "a#b",
    "drone\n",
    "dröne",
    "x" * 64,
]


@given(fleet=names, robot=names, leaf=st.sampled_from(LEAVES))
def test_a_key_says_which_robot_it_belongs_to(fleet: str, robot: str, leaf: str) -> None:
    keys = FleetKeys(fleet)
    assert keys.robot(robot, leaf) == f"nufleet/{fleet}/robot/{robot}/{leaf}"
    assert keys.robot_of(keys.robot(robot, leaf)) == robot
    assert fleet_of(keys.robot(robot, leaf)) == fleet
    # With `*` for the fleet, the same keys.
    assert robot_in_every_fleet(robot, leaf).replace("*", fleet) == keys.robot(robot, leaf)
    assert EVERY_FLEETS_ROBOTS_ALIVE.replace("*", fleet, 1) == keys.every_robot("alive")
    assert every_fleets_stop("desk").replace("*", fleet) == keys.stop("desk")


@given(fleet=names, orchestrator=identifiers)
def test_a_token_says_which_orchestrator_it_belongs_to(fleet: str, orchestrator: str) -> None:
    keys = FleetKeys(fleet)
    assert keys.orchestrator_of(keys.orchestrator_alive(orchestrator)) == orchestrator


@given(fleet=names, other=names, robot=names)
def test_fleets_keep_apart(fleet: str, other: str, robot: str) -> None:
    mine, theirs = FleetKeys(fleet), FleetKeys(other)
    assert (mine.robot(robot, "goal") == theirs.robot(robot, "goal")) == (fleet == other)
    assert (mine.stop("desk") == theirs.stop("desk")) == (fleet == other)


@given(robot=names, principal=names, leaf=st.sampled_from((*COMMANDS, STOP, RELEASE)))
def test_the_key_of_a_command_names_its_principal(robot: str, principal: str, leaf: str) -> None:
    keys = FleetKeys("lab")
    below = keys.command(robot, principal, leaf).removeprefix(keys.robot(robot, ""))
    assert attributed(below) == (principal, leaf)
    assert keys.request(robot, principal, leaf) == keys.command(robot, principal, leaf)


@pytest.mark.parametrize("leaf", READS)
def test_a_read_names_no_principal(leaf: str) -> None:
    assert FleetKeys("lab").request("a", "desk", leaf) == FleetKeys("lab").robot("a", leaf)
    assert attributed(leaf) == (None, leaf)


@pytest.mark.parametrize(
    "leaf", ["goal", "by/goal", "by//goal", "by/A/goal", "by/*/goal", "bye/a/b"]
)
def test_a_key_without_a_valid_principal_names_none(leaf: str) -> None:
    assert attributed(leaf) == (None, leaf)


@given(fleet=names, robot=names, principal=names)
def test_the_key_of_a_stop_names_the_principal_that_gave_it(
    fleet: str, robot: str, principal: str
) -> None:
    keys = FleetKeys(fleet)
    assert keys.principal_of_stop(keys.command(robot, principal, STOP)) == principal
    assert keys.principal_of_stop(keys.stop(principal)) == principal
    assert keys.principal_of_stop(keys.robot(robot, STOP)) is None
    assert keys.principal_of_stop(f"{keys.root}/stop") is None


@pytest.mark.parametrize("name", NOT_NAMES)
def test_what_is_not_a_name_is_in_no_key(name: str) -> None:
    with pytest.raises(InvalidInputError, match="lower-case letters"):
        FleetKeys(name)
    with pytest.raises(InvalidInputError, match="lower-case letters"):
        FleetKeys("lab").robot(name, "goal")
    with pytest.raises(InvalidInputError, match="target"):
        checked_name(name, "target")


@pytest.mark.parametrize("name", [n for n in NOT_NAMES if n not in ("a.b", "x" * 64)] + ["x" * 201])
def test_what_is_not_an_identifier_is_in_no_key(name: str) -> None:
    with pytest.raises(InvalidInputError, match="is not an identifier"):
        FleetKeys("lab").orchestrator_alive(name)
    with pytest.raises(InvalidInputError, match="goal"):
        checked_identifier(name, "goal")


@pytest.mark.parametrize("name", [n for n in NOT_NAMES if "/" not in n])
def test_a_key_from_the_network_with_what_is_not_a_name_belongs_to_nobody(name: str) -> None:
    keys = FleetKeys("lab")
    assert keys.robot_of(f"nufleet/lab/robot/{name}/alive") is None
    assert fleet_of(f"nufleet/{name}/robot/a/alive") is None
    if name not in ("a.b", "x" * 64):
        assert keys.orchestrator_of(f"nufleet/lab/orchestrator/{name}/alive") is None


@pytest.mark.parametrize("key", ["", "nufleet", "nufleet/lab", "else/lab/robot/a/alive", "lab"])
def test_a_key_of_something_else_belongs_to_nobody(key: str) -> None:
    assert FleetKeys("lab").robot_of(key) is None
    assert FleetKeys("lab").orchestrator_of(key) is None
    assert (fleet_of(key) is None) == (key != "nufleet/lab")


@given(
    run=identifiers.filter(lambda run: len(run) <= 100), iteration=st.integers(0, 99), robot=names
)
def test_a_goal_id_made_of_names_is_an_identifier(run: str, iteration: int, robot: str) -> None:
    goal_id = f"{run}.{iteration}.{robot}.3"
    assert checked_identifier(goal_id, "goal") == goal_id
