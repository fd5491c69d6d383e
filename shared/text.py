"""Texts: checks of those in keys, conversion for display, and TOML; light enough for a stop."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

from nufleet.shared.errors import InvalidInputError, NufleetError, system_errors_as

NAME_PATTERN = r"^[a-z0-9][a-z0-9_-]{0,62}$"
IDENTIFIER_PATTERN = r"^[0-9a-z][0-9a-z._-]{0,199}$"
REASON_MAX_CHARACTERS = 2000

# With `$` instead of a full match, a newline at the end would be accepted.
_NAME = re.compile(NAME_PATTERN.removesuffix("$"))
_IDENTIFIER = re.compile(IDENTIFIER_PATTERN.removesuffix("$"))

_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""Characters that control a terminal, break or reorder a line, or cannot be encoded as UTF-8."""


def is_name(text: str) -> bool:
    """Return True if a text is a valid name of a fleet, robot or axis."""
    return _NAME.fullmatch(text) is not None


def is_identifier(text: str) -> bool:
    """Return True if a text is a valid id of an orchestrator, goal or boot."""
    return _IDENTIFIER.fullmatch(text) is not None


def printable(text: str) -> str:
    """Return a text on one line that every terminal shows unchanged, character for character.

    Control characters that are white space become spaces; all others become question marks.
    """
    return _CONTROL.sub(lambda found: " " if found[0].isspace() else "?", text)


def as_reason(text: object) -> str:
    """Return any object's text, such as a driver's error, as a reason: printable, cut to length."""
    return printable(str(text))[:REASON_MAX_CHARACTERS]


def readable_unit(size: float, unit: str) -> tuple[float, str]:
    """Return the unit in which an error of this size is read, and how often it is in its own.

    It is a thousandth of the unit, "mm" or "mrad", for all that three digits show below 1.
    """
    return (1000.0, f"m{unit}") if abs(size) < 0.9995 else (1.0, unit)


def in_thousandths(error: float, unit: str) -> str:
    """Return an error with three digits, such as "5.1 mm", and "1.23 m" from 1 m on."""
    factor, shown = readable_unit(error, unit)
    return f"{factor * error:.3g} {shown}"


def read_toml(path: Path, kind: type[NufleetError]) -> dict[str, Any]:
    """Return the contents of a TOML file.

    Args:
        path: Path of the file.
        kind: Type of the error if the file cannot be read or is not valid TOML.
    """
    try:
        with system_errors_as(kind, f"{path}: cannot be read"):
            return tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        # Invalid TOML or UTF-8, numbers too long for Python, or tables nested too deeply for it.
        raise kind(f"{path}: not valid TOML: {error}") from error


def split_names(text: str) -> tuple[str, ...]:
    """Return names that are separated by commas, in their order.

    Raises:
        InvalidInputError: a name is empty, or given twice.
    """
    names = tuple(name.strip() for name in text.split(","))
    if "" in names:
        raise InvalidInputError(f"{text!r} has an empty name: put one comma between two names")
    for name in names:
        if names.count(name) > 1:
            raise InvalidInputError(f"{text!r} names {name} twice: name each once")
    return names
