"""Strict pydantic types for everything that comes from outside, and their errors in one line."""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field, StringConstraints, ValidationError

_SHOWN_PROBLEMS = 4
_SHOWN_CHARACTERS = 200


class Strict(BaseModel):
    """A value that refuses unknown fields, coercion, NaN and infinity, and cannot be changed."""

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False, validate_default=True
    )


Name = Annotated[str, StringConstraints(pattern=r"^[a-z0-9][a-z0-9_-]{0,62}$")]
"""A robot, fleet or axis name: lower-case letters, digits, `-` and `_`; it is part of a key."""

Identifier = Annotated[str, StringConstraints(pattern=r"^[0-9a-z][0-9a-z._-]{0,199}$")]
"""A goal, boot or orchestrator id: made by a program, unique, may be part of a key.

Long enough for names joined by dots, such as `{run}.{iteration}.{robot}.{attempt}`."""

REASON_MAX_CHARACTERS = 2000

Reason = Annotated[str, StringConstraints(max_length=REASON_MAX_CHARACTERS)]
"""A sentence for people."""


def as_reason(text: object) -> str:
    """Return any text, such as a driver's error, as one that is valid as a Reason: cut to length,
    with what cannot be written as UTF-8 replaced.
    """
    return str(text).encode(errors="replace").decode()[:REASON_MAX_CHARACTERS]


Digest = Annotated[str, StringConstraints(pattern=r"^[0-9a-f]{64}$")]
"""A sha256 in hexadecimal."""

Positive = Annotated[float, Field(gt=0)]
NonNegative = Annotated[float, Field(ge=0)]


def describe_validation(error: ValidationError) -> str:
    """Say in one line which fields were wrong and what was expected.

    The line stays short whatever was sent: it goes into refusals and logs.
    """
    found = error.errors(include_url=False, include_context=False, include_input=False)
    problems = [
        f"{_shortened('.'.join(str(part) for part in item['loc']) or 'message')}: "
        f"{_shortened(item['msg'])}"
        for item in found[:_SHOWN_PROBLEMS]
    ]
    more = f" (and {len(found) - len(problems)} more)" if len(found) > len(problems) else ""
    return "; ".join(problems) + more


def _shortened(text: str) -> str:
    return text if len(text) <= _SHOWN_CHARACTERS else f"{text[: _SHOWN_CHARACTERS - 1]}…"
