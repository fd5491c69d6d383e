"""The types of options that click does not have."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable
from pathlib import Path

import click
from click.shell_completion import CompletionItem

from nufleet.orchestrator.jobs.environment import RUNS_VARIABLE
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.text import split_names


class Number(click.ParamType[float]):
    """A number in a unit, within optional bounds."""

    name = "number"

    def __init__(
        self, low: float | None = None, high: float | None = None, *, unit: str = ""
    ) -> None:
        self._low, self._high, self._unit = low, high, unit

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number; an invalid one raises click's usage error."""
        try:
            number = float(str(value))
        except ValueError:
            in_unit = f"; give it in {self._unit}, without the unit" if self._unit else ""
            self.fail(f"{value!r} is not a number{in_unit}", param, ctx)
        if self._low is not None and not self._low <= number < math.inf:
            self.fail(f"{value} must be a finite number of at least {self._low:g}", param, ctx)
        return number


class PositiveNumber(Number):
    """A finite number above zero, within optional bounds."""

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number; an invalid one raises click's usage error."""
        number = Number(unit=self._unit).convert(value, param, ctx)
        if not 0 < number < math.inf:
            self.fail(f"{value} must be a number above 0, and finite", param, ctx)
        low, high = self._low or 0.0, self._high or math.inf
        if not low <= number <= high:
            self.fail(f"{value} must be between {low:g} and {high:g}", param, ctx)
        return number


class Names(click.ParamType[tuple[str, ...]]):
    """Names of robots or drawings, separated by commas."""

    name = "names"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[str, ...]:
        """Return the names in their order; an empty or repeated one raises click's usage error."""
        try:
            return split_names(str(value))
        except InvalidInputError as error:
            self.fail(str(error), param, ctx)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the robots of the fleet file as a continuation of the names typed already."""
        typed, comma, begun = incomplete.rpartition(",")
        left = [name for name in _robots_of(ctx) if name not in typed.split(",")]
        return [CompletionItem(typed + comma + item.value) for item in _beginning(begun, left)]


class PositiveNumbers(click.ParamType[tuple[float, ...]]):
    """Finite numbers above zero, separated by commas."""

    name = "numbers"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Return the numbers in their order; an invalid one raises click's usage error."""
        number = PositiveNumber()
        return tuple(number.convert(part, param, ctx) for part in str(value).split(","))


class Durations(click.ParamType[tuple[float, ...]]):
    """Durations in seconds from zero to an hour, separated by commas."""

    name = "durations"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> tuple[float, ...]:
        """Return the durations in their order; an invalid one raises click's usage error."""
        some = PositiveNumber(high=3600)
        parts = str(value).split(",")
        return tuple(0.0 if p.strip() == "0" else some.convert(p, param, ctx) for p in parts)


class FleetPath(click.ParamType[Path]):
    """A fleet file, given by its path or by the name of an installed one."""

    name = "fleet"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> Path:
        """Return the path of the file; raises FleetFileError when there is none."""
        from nufleet.shared.robots.fleet_file import find_fleet_file

        return value if isinstance(value, Path) else find_fleet_file(str(value))

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the installed fleets and, for the shell to complete, files."""
        from nufleet.orchestrator.jobs.known_names import installed_fleets

        return [*_beginning(incomplete, installed_fleets()), CompletionItem(incomplete, "file")]


class DrawingName(click.ParamType[str]):
    """A drawing, given by its file or by the name of an installed one."""

    name = "drawing"

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the installed drawings and, for the shell to complete, files."""
        from nufleet.orchestrator.jobs.known_names import drawing_names

        return [*_beginning(incomplete, drawing_names()), CompletionItem(incomplete, "file")]


class NewPicture(click.ParamType[Path]):
    """A file for a picture, which does not exist yet."""

    name = "picture"
    SUFFIXES = (".png", ".svg", ".pdf")

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> Path:
        """Return the path; one that is taken, or is no picture's, raises click's usage error."""
        path = Path(str(value))
        if path.suffix.lower() not in self.SUFFIXES:
            self.fail(f"{path} must end in {', '.join(self.SUFFIXES)}", param, ctx)
        if path.exists():
            self.fail(f"{path} already exists: choose another file", param, ctx)
        return path


class AlgorithmName(click.ParamType[str]):
    """An algorithm that selects tests: one of our own, or one that a package installs."""

    name = "algorithm"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> str:
        """Return the name; an unknown one raises click's usage error."""
        from nufleet.orchestrator.study.algorithms import algorithm_names

        if value not in algorithm_names():
            self.fail(f"{value} is none of {', '.join(algorithm_names())}", param, ctx)
        return str(value)

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the algorithms."""
        from nufleet.orchestrator.study.algorithms import algorithm_names

        return _beginning(incomplete, algorithm_names())


class RunName(click.ParamType[str]):
    """A run, given by its folder, by its name in the folder of all runs, or as `latest`."""

    name = "run"

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the runs in the folder of all runs, the newest first."""
        from nufleet.orchestrator.jobs.known_names import run_names

        root = ctx.params.get("runs_root") or Path(os.environ.get(RUNS_VARIABLE, "runs"))
        return _beginning(incomplete, run_names(root))


class RobotName(click.ParamType[str]):
    """A robot; completed from the fleet file that was typed, since that needs no network."""

    name = "robot"

    def shell_complete(
        self, ctx: click.Context, param: click.Parameter, incomplete: str
    ) -> list[CompletionItem]:
        """Return the robots of the fleet file."""
        return _beginning(incomplete, _robots_of(ctx))


def _robots_of(ctx: click.Context) -> list[str]:
    from nufleet.orchestrator.jobs.known_names import robot_names

    typed = ctx.params.get("fleet_file")
    return [] if typed is None else robot_names(str(typed))


def _beginning(incomplete: str, names: Iterable[str]) -> list[CompletionItem]:
    return [CompletionItem(name) for name in names if name.startswith(incomplete)]


class Endpoint(click.types.StringParamType):
    """A Zenoh endpoint; commas separate several in an environment variable.

    Click would split them at spaces, which the path of a Unix socket may contain.
    """

    envvar_list_splitter = ","
