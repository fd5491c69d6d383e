"""The Zenoh keys of one fleet; nothing else in the project spells a key."""

from __future__ import annotations

from dataclasses import dataclass

from pydantic import TypeAdapter, ValidationError

from shared.errors import InvalidInputError
from shared.strict import Identifier, Name

_NAME: TypeAdapter[str] = TypeAdapter(Name)
_IDENTIFIER: TypeAdapter[str] = TypeAdapter(Identifier)


def checked_name(value: str, what: str) -> str:
    """Return a robot's or fleet's name if it can be part of a key; raise InvalidInputError."""
    try:
        return _NAME.validate_python(value)
    except ValidationError as error:
        raise InvalidInputError(
            f"{what} {value!r} is not a name: expected lower-case letters, digits, - and _, "
            "starting with a letter or digit, at most 63 characters"
        ) from error


def checked_identifier(value: str, what: str) -> str:
    """Return a goal's, boot's or orchestrator's id if it can be one; raise InvalidInputError."""
    try:
        return _IDENTIFIER.validate_python(value)
    except ValidationError as error:
        raise InvalidInputError(
            f"{what} {value!r} is not an identifier: expected lower-case letters, digits, dots, "
            "- and _, starting with a letter or digit, at most 200 characters"
        ) from error


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

    def robot_of(self, key: str) -> str:
        """The robot that a key belongs to."""
        return key.removeprefix(f"{self.root}/robot/").split("/", 1)[0]

    def orchestrator_alive(self, orchestrator_id: str) -> str:
        """The liveliness token of one orchestrator."""
        checked = checked_identifier(orchestrator_id, "orchestrator")
        return f"{self.root}/orchestrator/{checked}/alive"

    @property
    def every_orchestrator_alive(self) -> str:
        """The key expression that matches the tokens of all orchestrators."""
        return f"{self.root}/orchestrator/*/alive"

    def orchestrator_of(self, key: str) -> str:
        """The orchestrator that a key belongs to."""
        return key.removeprefix(f"{self.root}/orchestrator/").split("/", 1)[0]

    @property
    def stop(self) -> str:
        """A put here stops every robot of the fleet."""
        return f"{self.root}/stop"
