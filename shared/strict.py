"""Strict pydantic types for everything that comes from outside, and their errors in one line."""

from __future__ import annotations

from typing import Annotated

from pydantic import (
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    StringConstraints,
    ValidationError,
)

from nufleet.shared.text import IDENTIFIER_PATTERN, NAME_PATTERN, as_reason, printable

_SHOWN_PROBLEMS = 4
_SHOWN_CHARACTERS = 200


class Strict(BaseModel):
    """A value that refuses unknown fields, coercion, NaN and infinity, and cannot be changed."""

    model_config = ConfigDict(
        extra="forbid", strict=True, frozen=True, allow_inf_nan=False, validate_default=True
    )


Name = Annotated[str, StringConstraints(pattern=NAME_PATTERN)]
"""A robot, fleet or axis name: lower-case letters, digits, `-` and `_`; it is part of a key."""

Identifier = Annotated[str, StringConstraints(pattern=IDENTIFIER_PATTERN)]
"""A goal, boot or orchestrator id: made by a program, unique, may be part of a key.

Long enough for names joined by dots, such as `{run}.{iteration}.{robot}.{attempt}`."""


def _reason(said: object) -> object:
    return as_reason(said) if isinstance(said, str) else said


Reason = Annotated[str, BeforeValidator(_reason)]
"""A sentence for people. Any text makes one: no stop may fail because of its words."""

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
    # Among them are names of fields, which are whatever the sender called them.
    shown = printable(text[:_SHOWN_CHARACTERS])
    return shown if len(text) <= _SHOWN_CHARACTERS else f"{shown[:-1]}…"
