"""What there is to be shown so far, which decides on the layout."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Kind = Literal["ranking", "tracking"]

COMPARED_S = 180.0
"""Flights of so long a time are shown beside one another."""


@dataclass
class Shown:
    """Grows as events come; equal to an earlier copy while the layout may stay as it is."""

    kinds: list[Kind] = field(default_factory=list)
    """In the order in which they began."""
    axes: list[str] = field(default_factory=list)
    """Of the robots that track, by name."""
    unit: str = ""
    """Of these axes."""
    in_plane: bool = False
    """Whether a robot with two axes or more tracks."""
    on_line: bool = False
    """Whether a robot with one axis tracks."""
    since_s: float = 0.0
    """When the first flight began."""
    long: bool = False
    """Whether the flights take longer than what is shown of them at once."""

    def ranking(self) -> None:
        """There are tests or rounds of a study."""
        self._add("ranking")

    def tracking(self, axes: tuple[str, ...], unit: str, begin_s: float) -> None:
        """A flight along a path begins."""
        if "tracking" not in self.kinds:
            self.since_s = begin_s
        self._add("tracking")
        self.long |= begin_s > self.since_s + COMPARED_S
        self.axes += [axis for axis in axes if axis not in self.axes]
        self.unit = unit
        self.in_plane |= len(axes) > 1
        self.on_line |= len(axes) == 1

    def _add(self, kind: Kind) -> None:
        if kind not in self.kinds:
            self.kinds.append(kind)
