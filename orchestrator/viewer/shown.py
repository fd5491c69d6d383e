"""The kinds of content that a growing recording holds, which determine its layout."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

Kind = Literal["ranking", "tracking"]

COMPARED_S = 180.0
"""Span of time in s whose flights are shown side by side in the view of errors."""


@dataclass
class Shown:
    """A record of the present content, which grows as events arrive.

    It equals an earlier copy of itself for as long as the layout need not change.
    """

    kinds: list[Kind] = field(default_factory=list)
    """Kinds of content, in the order in which they began."""
    axes: list[str] = field(default_factory=list)
    """Names of the axes of all robots that track."""
    unit: str = ""
    """Unit of these axes."""
    in_plane: bool = False
    """Whether a robot with two or more axes tracks."""
    on_line: bool = False
    """Whether a robot with one axis tracks."""
    mixed: bool = False
    """Whether a robot tracks with a mixture of experiences."""
    since_s: float = 0.0
    """Beginning of the first flight on the viewer's clock."""
    long: bool = False
    """Whether the flights span more time than is shown at once, `COMPARED_S`."""

    def ranking(self) -> None:
        """Note that the recording holds tests or rounds of a study."""
        self._add("ranking")

    def tracking(
        self, axes: tuple[str, ...], unit: str, begin_s: float, *, mixed: bool = False
    ) -> None:
        """Note the beginning of a flight along a path.

        Args:
            axes: Names of the robot's axes.
            unit: Unit of these axes.
            begin_s: Beginning of the flight on the viewer's clock.
            mixed: Whether its prior is a mixture.
        """
        if "tracking" not in self.kinds:
            self.since_s = begin_s
        self._add("tracking")
        self.long |= begin_s > self.since_s + COMPARED_S
        self.axes += [axis for axis in axes if axis not in self.axes]
        self.unit = unit
        self.in_plane |= len(axes) > 1
        self.on_line |= len(axes) == 1
        self.mixed |= mixed

    def _add(self, kind: Kind) -> None:
        if kind not in self.kinds:
            self.kinds.append(kind)
