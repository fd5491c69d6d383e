"""Fleet files: which robots there are, each with its driver and the driver's settings, in TOML."""

from __future__ import annotations

import json
import tomllib
from importlib.metadata import entry_points
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, Field, ValidationError, model_validator

from nufleet.shared.errors import FleetFileError
from nufleet.shared.strict import Name, Strict, describe_validation

ENTRY_POINT_GROUP = "nufleet.fleets"


class RobotEntry(Strict):
    """One robot: the name of its driver (entry-point group `nufleet.robots`) and its settings.

    `allow_unguarded` lets it fly with a learned inverse and no guard where somebody asks for that.
    """

    driver: Annotated[str, Field(pattern=r"^[a-z][a-z0-9_]{0,62}$")]
    settings: Annotated[dict[str, Any], Field(default_factory=dict)]
    allow_unguarded: bool = False


class StudyDefaults(Strict):
    """What a ranking of this fleet is about when the command line does not say."""

    target: Name
    band_rad_s: tuple[float, float]


class FleetFile(Strict):
    """A fleet: `seed` starts the generators of every simulated noise."""

    schema_version: Annotated[Literal[1], Field(alias="schema")]
    name: Name
    description: str = ""
    seed: Annotated[int, Field(ge=0)] = 0
    study: StudyDefaults | None = None
    robots: Annotated[dict[Name, RobotEntry], Field(min_length=1, max_length=4096)]

    @model_validator(mode="after")
    def _target_exists(self) -> FleetFile:
        if self.study is not None and self.study.target not in self.robots:
            raise ValueError(
                f"study.target: no robot {self.study.target!r}; there are {', '.join(self.robots)}"
            )
        return self


S = TypeVar("S", bound=BaseModel)


def find_fleet_file(path_or_name: str) -> Path:
    """Return the path of a fleet file given as a path, or by the name of one that is installed.

    Raises:
        FleetFileError: it is neither.
    """
    path = Path(path_or_name)
    if path.exists():
        return path
    installed = {entry.name: entry for entry in entry_points(group=ENTRY_POINT_GROUP)}
    if path_or_name not in installed:
        names = ", ".join(sorted(installed))
        raise FleetFileError(f"{path}: there is no such fleet file; known by name: {names}")
    found: Path = installed[path_or_name].load()
    return found


def read_fleet_file(path: Path) -> FleetFile:
    """Read and check a fleet file.

    Raises:
        FleetFileError: naming the file, the field and what was expected.
    """
    try:
        document = tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise FleetFileError(f"{path}: cannot be read: {error.strerror}") from error
    except (ValueError, RecursionError) as error:
        # Wrong TOML or UTF-8, numbers too long for Python, tables nested beyond its stack.
        raise FleetFileError(f"{path}: not valid TOML: {error}") from error
    return _validated(FleetFile, document, str(path))


def validated_settings(model: type[S], path: Path, robot: str, settings: dict[str, Any]) -> S:
    """Check a robot's settings against its driver's model; raises FleetFileError."""
    return _validated(model, settings, f"{path}: robots.{robot}.settings")


def _validated(model: type[S], document: dict[str, Any], where: str) -> S:
    try:
        # Through JSON, since strict models take a list for a tuple from there only.
        return model.model_validate_json(json.dumps(document, default=str))
    except ValidationError as error:
        raise FleetFileError(f"{where}: {describe_validation(error)}") from error
