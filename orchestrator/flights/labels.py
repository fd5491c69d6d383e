"""What flights along paths are called: who gave the prior, and then what was flown."""

from __future__ import annotations

BASELINE = "baseline"
"""Instead of a source: the robot's own controller alone."""

NO_PRIOR = "none"
"""Instead of a source: an online process with a zero prior."""

MIXTURE = "mixture"
"""Instead of a source: a mixture of the experiences of several, weighed in flight."""

BY_AXIS = "by-axis"
"""Instead of a source: on each axis the experience of the source that is closest there."""

OWN = "own"
"""Instead of a source: the robot's model of itself, inverted along the whole path."""

_UNGUARDED = "-unguarded"
_SEPARATOR = " · "


def path_label(drawing: str, speed: float, unit: str = "m") -> str:
    """Return what is flown, such as "clover · 0.6 m/s"; flights of the same can be compared."""
    return f"{drawing}{_SEPARATOR}{speed:g} {unit}/s"


def flight_label(prior: str, path: str) -> str:
    """Return a flight's name, such as "source-1 · clover · 0.6 m/s"."""
    return f"{prior}{_SEPARATOR}{path}"


def prior_and_path(flight: str) -> tuple[str, str]:
    """Return who gave the prior, and what was flown."""
    prior, _, path = flight.partition(_SEPARATOR)
    return prior, path


def without_guard(source: str) -> str:
    """Return the name of a source's experience that is flown without the guard."""
    return f"{source}{_UNGUARDED}"


def guarded_name(prior: str) -> str:
    """Return the source of a prior, whether or not it is flown with the guard.

    >>> guarded_name(without_guard("source-1"))
    'source-1'
    """
    return prior.removesuffix(_UNGUARDED)
