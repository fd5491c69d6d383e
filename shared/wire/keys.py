"""The Zenoh keys of one fleet; nothing else in the project spells a key."""

from __future__ import annotations

from dataclasses import dataclass

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.text import is_identifier, is_name

EVERY_FLEETS_ROBOTS_ALIVE = "nufleet/*/robot/*/alive"
"""The key expression that matches the tokens of all robots of all fleets at a router."""

EVERY_FLEETS_STOP = "nufleet/*/stop"
"""A put here stops every robot of every fleet at a router."""


def checked_name(value: str, what: str) -> str:
    """Return a robot's or fleet's name if it can be part of a key; raise InvalidInputError."""
    if is_name(value):
        return value
    raise InvalidInputError(
        f"{what} {value!r} is not a name: expected lower-case letters, digits, - and _, "
        "starting with a letter or digit, at most 63 characters"
    )


def checked_identifier(value: str, what: str) -> str:
    """Return a goal's, boot's or orchestrator's id if it can be one; raise InvalidInputError."""
    if is_identifier(value):
        return value
    raise InvalidInputError(
        f"{what} {value!r} is not an identifier: expected lower-case letters, digits, dots, "
        "- and _, starting with a letter or digit, at most 200 characters"
    )


def robot_in_every_fleet(robot: str, leaf: str) -> str:
    """Return the key expression that matches one key of the robots of one name in all fleets."""
    return f"nufleet/*/robot/{checked_name(robot, 'robot')}/{leaf}"


def fleet_of(key: str) -> str | None:
    """Return the fleet that a key from the network belongs to; None when that is no name."""
    root, _, below = key.partition("/")
    fleet = below.split("/", 1)[0]
    return fleet if root == "nufleet" and is_name(fleet) else None


@dataclass(frozen=True)
class FleetKeys:
    """The keys under `nufleet/{fleet}/`."""

    fleet: str

    def __post_init__(self) -> None:
        checked_name(self.fleet, "fleet")

    @property
    def root(self) -> str:
        """The prefix of all keys."""
        return f"nufleet/{self.fleet}"

    def robot(self, robot: str, leaf: str) -> str:
        """One key of one robot, for example `state`, `goal` or `telemetry/motion`."""
        return f"{self.root}/robot/{checked_name(robot, 'robot')}/{leaf}"

    def every_robot(self, leaf: str) -> str:
        """The key expression that matches one key of all robots."""
        return f"{self.root}/robot/*/{leaf}"

    def robot_of(self, key: str) -> str | None:
        """The robot that a key from the network belongs to; None when that is no name."""
        robot = self._below(key, "robot")
        return robot if is_name(robot) else None

    def orchestrator_alive(self, orchestrator_id: str) -> str:
        """The liveliness token of one orchestrator."""
        checked = checked_identifier(orchestrator_id, "orchestrator")
        return f"{self.root}/orchestrator/{checked}/alive"

    @property
    def every_orchestrator_alive(self) -> str:
        """The key expression that matches the tokens of all orchestrators."""
        return f"{self.root}/orchestrator/*/alive"

    def orchestrator_of(self, key: str) -> str | None:
        """The orchestrator that a key from the network belongs to; None when that is no id."""
        orchestrator = self._below(key, "orchestrator")
        return orchestrator if is_identifier(orchestrator) else None

    @property
    def stop(self) -> str:
        """A put here stops every robot of the fleet."""
        return f"{self.root}/stop"

    def _below(self, key: str, kind: str) -> str:
        prefix = f"{self.root}/{kind}/"
        return key.removeprefix(prefix).split("/", 1)[0] if key.startswith(prefix) else ""
