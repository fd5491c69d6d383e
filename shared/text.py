"""Which texts may be part of a key, and how any other text is shown: light enough for a stop."""

from __future__ import annotations

import re

NAME_PATTERN = r"^[a-z0-9][a-z0-9_-]{0,62}$"
IDENTIFIER_PATTERN = r"^[0-9a-z][0-9a-z._-]{0,199}$"
REASON_MAX_CHARACTERS = 2000

_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069\ud800-\udfff]")
"""What moves a terminal's cursor, breaks or reorders a line, or cannot be written as UTF-8."""


def is_name(text: str) -> bool:
    """Return whether a text can be the name of a fleet or robot."""
    return _matches(NAME_PATTERN, text)


def is_identifier(text: str) -> bool:
    """Return whether a text can be the id of an orchestrator, goal or boot."""
    return _matches(IDENTIFIER_PATTERN, text)


def printable(text: str) -> str:
    """Return a text on one line that every terminal shows as it is, character for character.

    White space becomes a space; anything else that is not for showing becomes a question mark.
    """
    return _CONTROL.sub(lambda found: " " if found[0].isspace() else "?", text)


def as_reason(text: object) -> str:
    """Return any text, such as a driver's error, as a reason: printable, and cut to length."""
    return printable(str(text))[:REASON_MAX_CHARACTERS]


def _matches(pattern: str, text: str) -> bool:
    # `$` alone would overlook a newline at the end.
    return re.fullmatch(pattern.removesuffix("$"), text) is not None
