"""Fleet files: TOML files that list robots, each with its driver and the driver's settings."""

from __future__ import annotations

import json
from collections import Counter
from ipaddress import ip_address
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, Field, model_validator

from nufleet.shared.errors import FleetFileError
from nufleet.shared.robots.installed import find_file, installed
from nufleet.shared.strict import Name, Positive, Strict, validation_errors_as
from nufleet.shared.text import read_toml

ENTRY_POINT_GROUP = "nufleet.fleets"


class RobotPolicy(Strict):
    """What a robot lets others have it do; stated on its own machine, never by a sender."""

    allow_unguarded: bool = False
    """True if the robot accepts requests to fly with a learned inverse and without the guard."""
    priors_from: tuple[Name, ...] | None = None
    """Robots whose experiences it flies with, among them itself if it is to learn; None for all."""
    prior_output_max: Positive | None = None
    """Largest |γ| in unit/s that a prior may output on the paths that the robot may fly; None for
    ten times what a correction within its bounds needs."""


class RobotEntry(RobotPolicy):
    """One robot of a fleet file."""

    driver: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,62}$")]
    """Name of its driver in the entry-point group `nufleet.robots`."""
    settings: Annotated[dict[str, Any], Field(default_factory=dict)]
    """Settings of its driver, validated by `RobotDriver.settings`."""


def _checked_host(text: str) -> str:
    if ":" in text or not text.strip("0123456789."):
        try:
            ip_address(text)
        except ValueError:
            raise ValueError(
                f"{text} is neither an IP address nor a host name; `port` holds the port"
            ) from None
    elif "" in text.split("."):
        raise ValueError(f"{text} is no host name: there is nothing between two of its dots")
    return text


Host = Annotated[str, Field(pattern=r"^[0-9A-Za-z.:-]{1,253}$"), AfterValidator(_checked_host)]
"""IP address or host name, without a port."""


class RouterEntry(Strict):
    """The router of a closed fleet."""

    addresses: Annotated[tuple[Host, ...], Field(min_length=1, max_length=64)]
    """IP addresses and host names at which the router is reached; identities name the first."""
    port: Annotated[int, Field(ge=1, le=65535)] = 7447
    """Port on which it listens."""
    listen: Host = "0.0.0.0"  # noqa: S104
    """Address on which it listens; every interface unless given."""


class OrchestratorEntry(Strict):
    """A principal that may watch, command, stop and release robots."""

    description: str = ""
    """Description, for people."""


class OperatorEntry(Strict):
    """A principal that may watch and stop robots."""

    description: str = ""
    """Description, for people."""
    may_release: bool = False
    """Whether it may also release robots that were stopped."""


class WatcherEntry(Strict):
    """A principal that may only watch."""

    description: str = ""
    """Description, for people."""


PRINCIPAL_MAX_CHARACTERS = 50
"""Longest name of a fleet or principal in a closed fleet: certificates have room for 64 characters
including a number."""


class StudyDefaults(Strict):
    """Defaults for a ranking of this fleet, used where the command line gives no value."""

    target: Name
    """Name of the target robot."""
    band_rad_s: tuple[float, float]
    """Lowest and highest frequency of the band W."""


class FleetFile(Strict):
    """Contents of a fleet file."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    """Version of this schema."""
    name: Name
    """Name of the fleet, part of every key on the network."""
    description: str = ""
    """Description of the fleet, for people."""
    seed: Annotated[int, Field(ge=0)] = 0
    """Seed of the random generators of all simulated noise."""
    study: StudyDefaults | None = None
    """Defaults for a ranking of this fleet."""
    robots: Annotated[dict[Name, RobotEntry], Field(min_length=1, max_length=100_000)]
    """The robots, by name."""
    router: RouterEntry | None = None
    """Router of a closed fleet; None for a fleet without certificates."""
    orchestrators: Annotated[dict[Name, OrchestratorEntry], Field(default_factory=dict)]
    """Principals that may command robots, by name."""
    operators: Annotated[dict[Name, OperatorEntry], Field(default_factory=dict)]
    """Principals that may stop robots, by name."""
    watchers: Annotated[dict[Name, WatcherEntry], Field(default_factory=dict)]
    """Principals that may only watch, by name."""

    @property
    def principals(self) -> dict[str, str]:
        """Role of each principal, by name."""
        return {
            name: role
            for role, entries in (
                ("robot", self.robots),
                ("orchestrator", self.orchestrators),
                ("operator", self.operators),
                ("watcher", self.watchers),
            )
            for name in entries
        }

    @model_validator(mode="after")
    def _principals_are_distinct(self) -> FleetFile:
        names = [*self.robots, *self.orchestrators, *self.operators, *self.watchers]
        for name, times in Counter(names).items():
            if times > 1:
                raise ValueError(f"{name} is listed in two roles; a principal has one")
        too_long = [n for n in (self.name, *names) if len(n) > PRINCIPAL_MAX_CHARACTERS]
        if self.router is not None and too_long:
            raise ValueError(
                f"{too_long[0]} is too long for a certificate: at most {PRINCIPAL_MAX_CHARACTERS} "
                "characters in a closed fleet"
            )
        return self

    @model_validator(mode="after")
    def _target_exists(self) -> FleetFile:
        if self.study is not None and self.study.target not in self.robots:
            raise ValueError(
                f"study.target: no robot {self.study.target!r}; there are {', '.join(self.robots)}"
            )
        return self


S = TypeVar("S", bound=BaseModel)


def find_fleet_file(path_or_name: str) -> Path:
    """Return the path of a fleet file that is given by its path or by the name of an installed one.

    Args:
        path_or_name: Path of a file, or name in the entry-point group `nufleet.fleets`.

    Raises:
        FleetFileError: there is neither such a file nor such a name.

    Examples:
        >>> find_fleet_file("paper_linear").name
        'paper_linear.toml'
    """
    return find_file(path_or_name, ENTRY_POINT_GROUP, "fleet file", FleetFileError)


def installed_fleets() -> tuple[str, ...]:
    """Return the names of the fleet files that are installed."""
    return tuple(sorted(installed(ENTRY_POINT_GROUP)))


def read_fleet_file(path: Path) -> FleetFile:
    """Read and check a fleet file.

    Args:
        path: Path of the file.

    Raises:
        FleetFileError: the file cannot be read or is wrong; the message names the file, the field
            and the expected value.

    Examples:
        >>> fleet = read_fleet_file(find_fleet_file("paper_linear"))
        >>> list(fleet.robots)
        ['target', 'source-1', 'source-2', 'source-3']
        >>> fleet.study.target, fleet.study.band_rad_s
        ('target', (0.05, 10.0))
    """
    return _validated(FleetFile, read_toml(path, FleetFileError), str(path))


def validated_settings(model: type[S], path: Path, robot: str, settings: dict[str, Any]) -> S:
    """Return a robot's settings, checked against the model of its driver.

    Args:
        model: Model of the settings.
        path: Path of the fleet file, for error messages.
        robot: Name of the robot.
        settings: Settings as they are in the file.

    Raises:
        FleetFileError: a setting is wrong; the message names the file, the field and the expected
            value.
    """
    return _validated(model, settings, f"{path}: robots.{robot}.settings")


def _validated(model: type[S], document: dict[str, Any], where: str) -> S:
    # Validated as JSON, because only there do strict models accept a list for a tuple.
    with validation_errors_as(FleetFileError, where):
        return model.model_validate_json(json.dumps(document, default=str))
