"""One colour for each robot, the same in every view, told apart by the colour-blind too."""

from __future__ import annotations

from collections.abc import Iterable

Colour = tuple[int, int, int]

TARGET: Colour = (255, 255, 255)
"""No source is white."""

REFERENCE: Colour = (130, 136, 148)

QUIET: Colour = (92, 98, 112)
"""Robots that have no colour of their own, being far down the ranking."""

GRID: Colour = (44, 48, 56)
TEXT: Colour = (168, 174, 186)
GROUND: Colour = (16, 18, 22)
"""Behind the drawn views, whatever the viewer's theme."""

# Okabe and Ito's palette (2008), its blue made lighter and its black left out for a dark ground.
_BASE: tuple[Colour, ...] = (
    (230, 159, 0),
    (86, 180, 233),
    (0, 158, 115),
    (240, 228, 66),
    (213, 94, 0),
    (204, 121, 167),
    (64, 122, 214),
)


class Palette:
    """Gives robots their colours.

    A source gets its own when it first is among the leading ones and keeps it from then on, so
    that a large fleet, too, has its contenders in colours that are easy to tell apart.
    """

    def __init__(self) -> None:
        self._colours: dict[str, Colour] = {}

    def assign(self, target: str, leaders: Iterable[str]) -> bool:
        """Give the target and these sources their colours; whether any was new."""
        before = dict(self._colours)
        self._colours[target] = TARGET
        for source in leaders:
            if source not in self._colours:
                index = sum(colour != TARGET for colour in self._colours.values())
                self._colours[source] = _tint(_BASE[index % len(_BASE)], index // len(_BASE))
        return self._colours != before

    def of(self, robot: str) -> Colour:
        """The robot's colour; quiet while it has none of its own."""
        return self._colours.get(robot, QUIET)


def _tint(colour: Colour, step: int) -> Colour:
    """Lighter versions for those who come when all colours are given; dark ones would not show."""
    share = 1 - 0.55**step
    red, green, blue = (round(c + (255 - c) * share) for c in colour)
    return red, green, blue
