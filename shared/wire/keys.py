"""The Zenoh keys of one fleet; nothing else in the project spells a key."""

from __future__ import annotations

from dataclasses import dataclass

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.text import is_identifier, is_name

EVERY_FLEETS_ROBOTS_ALIVE = "nufleet/*/robot/*/alive"
"""Key expression that matches the liveliness tokens of all robots of all fleets at a router."""

READS = ("describe", "result", "experience", "prior", "forecast")
"""Ends of the keys on which a robot answers anyone who may watch the fleet."""

STOP, RELEASE = "stop", "release"

COMMANDS = (
    *("goal", "cancel", "acknowledge"),
    *("experience/install", "prior/install", "prior/remove"),
)
"""Ends of the keys on which orchestrators command a robot, below `by/{principal}/`; stops and
releases are given in the same way."""

DEFAULT_PRINCIPAL = "orchestrator"
"""Principal of a sender without an identity, in a fleet that is open."""

ADMITTED = "@/*/router"
"""Key expression of what a router says about itself; it answers each principal in its list."""


def principal_of(sender: str) -> str:
    """Return the principal that an orchestrator's id names: the part before its first dot."""
    return sender.partition(".")[0]


def every_fleets_stop(principal: str) -> str:
    """Return the key on which a principal's put stops every robot of every fleet at a router."""
    return f"nufleet/*/by/{checked_name(principal, 'principal')}/{STOP}"


def attributed(leaf: str) -> tuple[str | None, str]:
    """Split the end of a robot's key into the principal that it names and the rest.

    Args:
        leaf: Part of the key below the robot's name, for example `by/desk/goal`.

    Returns:
        The principal, or None if the key names none, and the end of the key, for example `goal`.
    """
    by, _, rest = leaf.partition("/")
    principal, _, below = rest.partition("/")
    named = by == "by" and below and is_name(principal)
    return (principal, below) if named else (None, leaf)


def checked_name(value: str, what: str) -> str:
    """Return the name of a robot or fleet if it can be part of a key.

    Args:
        value: Name to check.
        what: Kind of thing it names, for the error message: `robot` or `fleet`.

    Raises:
        InvalidInputError: the name contains a character that is not allowed, or is too long.
    """
    if is_name(value):
        return value
    raise InvalidInputError(
        f"{what} {value!r} is not a name: expected lower-case letters, digits, - and _, "
        "starting with a letter or digit, at most 63 characters"
    )


def checked_identifier(value: str, what: str) -> str:
    """Return the id of a goal, boot or orchestrator if it can be part of a key.

    Args:
        value: Id to check.
        what: Kind of thing it identifies, for the error message, such as `orchestrator`.

    Raises:
        InvalidInputError: the id contains a character that is not allowed, or is too long.
    """
    if is_identifier(value):
        return value
    raise InvalidInputError(
        f"{what} {value!r} is not an identifier: expected lower-case letters, digits, dots, "
        "- and _, starting with a letter or digit, at most 200 characters"
    )


def robot_in_every_fleet(robot: str, leaf: str) -> str:
    """Return the key expression that matches one key of every robot of this name in any fleet.

    Args:
        robot: Name of the robot.
        leaf: End of the key, below the robot's name, for example `stop`.

    Raises:
        InvalidInputError: `robot` is not a name.
    """
    return f"nufleet/*/robot/{checked_name(robot, 'robot')}/{leaf}"


def fleet_of(key: str) -> str | None:
    """Return the name of the fleet that a key from the network belongs to; None if invalid."""
    root, _, below = key.partition("/")
    fleet = below.split("/", 1)[0]
    return fleet if root == "nufleet" and is_name(fleet) else None


@dataclass(frozen=True)
class FleetKeys:
    """The keys under `nufleet/{fleet}/`; raises InvalidInputError unless `fleet` is a name."""

    fleet: str
    """Name of the fleet."""

    def __post_init__(self) -> None:
        checked_name(self.fleet, "fleet")

    @property
    def root(self) -> str:
        """The prefix of all keys of this fleet, without a slash at the end."""
        return f"nufleet/{self.fleet}"

    def robot(self, robot: str, leaf: str) -> str:
        """Return one key of one robot.

        Args:
            robot: Name of the robot.
            leaf: End of the key, for example `state`, `goal` or `telemetry/motion`.

        Raises:
            InvalidInputError: `robot` is not a name.
        """
        return f"{self.root}/robot/{checked_name(robot, 'robot')}/{leaf}"

    def command(self, robot: str, principal: str, leaf: str) -> str:
        """Return the key on which a principal commands a robot.

        A router with access control lets each principal write below its own name only, which proves
        the sender to the robot.

        Args:
            robot: Name of the robot.
            principal: Name of the sender in the fleet's inventory.
            leaf: End of the key, one of `COMMANDS`, `STOP` or `RELEASE`.

        Raises:
            InvalidInputError: `robot` or `principal` is not a name.
        """
        return self.robot(robot, f"by/{checked_name(principal, 'principal')}/{leaf}")

    def request(self, robot: str, principal: str, leaf: str) -> str:
        """Return the key of any request: see `command`; reads name no principal."""
        return self.robot(robot, leaf) if leaf in READS else self.command(robot, principal, leaf)

    def every_robot(self, leaf: str) -> str:
        """Return the key expression that matches the key with this `leaf` of all robots."""
        return f"{self.root}/robot/*/{leaf}"

    @property
    def states(self) -> str:
        """Key on which an open fleet's robots that share a session publish their states together.

        The router of a closed fleet lets nothing through here, since one message would speak for
        several principals.
        """
        return f"{self.root}/states"

    def robot_of(self, key: str) -> str | None:
        """Return the name of the robot that a key from the network belongs to; None if invalid."""
        robot = self._below(key, "robot")
        return robot if is_name(robot) else None

    def orchestrator_alive(self, orchestrator_id: str) -> str:
        """Return the key of one orchestrator's liveliness token.

        Raises:
            InvalidInputError: `orchestrator_id` is not an identifier.
        """
        checked = checked_identifier(orchestrator_id, "orchestrator")
        return f"{self.root}/orchestrator/{checked}/alive"

    @property
    def every_orchestrator_alive(self) -> str:
        """Key expression that matches the liveliness tokens of all orchestrators."""
        return f"{self.root}/orchestrator/*/alive"

    def orchestrator_of(self, key: str) -> str | None:
        """Return the id of the orchestrator that a key from the network names; None if invalid."""
        orchestrator = self._below(key, "orchestrator")
        return orchestrator if is_identifier(orchestrator) else None

    @property
    def connected(self) -> str:
        """Key on which the router of a closed fleet tells orchestrators who is connected."""
        return f"{self.root}/connected"

    def stop(self, principal: str) -> str:
        """Return the key on which a principal's put stops every robot of the fleet."""
        return f"{self.root}/by/{checked_name(principal, 'principal')}/{STOP}"

    @property
    def every_stop(self) -> tuple[str, ...]:
        """Key expressions that a robot hears for stops of the whole fleet.

        The second names no principal; only a router without access control lets it through.
        """
        return f"{self.root}/by/*/{STOP}", f"{self.root}/{STOP}"

    def principal_of_stop(self, key: str) -> str | None:
        """Return the principal that the key of a stop names; None if it names none."""
        below = key.removeprefix(f"{self.root}/")
        if below.startswith("robot/"):
            below = below.removeprefix("robot/").partition("/")[2]
        return attributed(below)[0]

    def _below(self, key: str, kind: str) -> str:
        prefix = f"{self.root}/{kind}/"
        return key.removeprefix(prefix).split("/", 1)[0] if key.startswith(prefix) else ""
