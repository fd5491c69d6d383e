"""The types of options that click does not have."""

from __future__ import annotations

import math
from pathlib import Path

import click

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


def fleet_file(path_or_name: str) -> Path:
    """Return the path of a fleet file, given by its path or by the name of an installed one."""
    from nufleet.shared.robots.fleet_file import find_fleet_file

    return find_fleet_file(path_or_name)


class Endpoint(click.types.StringParamType):
    """A Zenoh endpoint; commas separate several in an environment variable.

    Click would split them at spaces, which the path of a Unix socket may contain.
    """

    envvar_list_splitter = ","
