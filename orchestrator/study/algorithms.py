"""Algorithms that select tests, by name: our own, and those that packages install."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.installed import installed

ENTRY_POINT_GROUP = "nufleet.studies"
"""Entry-point group of algorithms from other packages; see `nufleet.studies`."""

OWN = ("adaptive", "paper")
"""Our own algorithms for rankings."""


def algorithm_names() -> tuple[str, ...]:
    """Return the names of all algorithms that can rank, our own first."""
    return (*OWN, *sorted(installed(ENTRY_POINT_GROUP).keys() - set(OWN)))


def load_algorithm(name: str) -> Callable[..., Any]:
    """Return an installed algorithm, to be called with plan, specs and generator.

    Raises:
        InvalidInputError: No package installs it, or it cannot be imported.
    """
    found = installed(ENTRY_POINT_GROUP)
    if name not in found:
        raise InvalidInputError(
            f"no algorithm {name!r} is installed; there are {', '.join(algorithm_names())}"
        )
    try:
        algorithm: Callable[..., Any] = found[name].load()
    except (ImportError, AttributeError) as error:
        raise InvalidInputError(f"algorithm {name!r} cannot be loaded: {error}") from error
    return algorithm
