"""One colour for each robot, the same in every view, told apart by the colour-blind too."""

from __future__ import annotations

from collections.abc import Iterable

from nufleet.orchestrator.flight_labels import BASELINE, NO_PRIOR

Colour = tuple[int, int, int]

TARGET: Colour = (255, 255, 255)
"""No source is white."""

REFERENCE: Colour = (130, 136, 148)

WANTED: Colour = (214, 218, 226)
"""A path that is to be flown: a thin line over all that flew along it."""

QUIET: Colour = (92, 98, 112)
"""Robots that have no colour of their own, being far down the ranking."""

GRID: Colour = (44, 48, 56)
TEXT: Colour = (168, 174, 186)
GROUND: Colour = (16, 18, 22)
"""Behind the drawn views, whatever the viewer's theme."""

ALARM: Colour = (235, 90, 90)
"""Marks what the guard did."""

_NO_SOURCE: dict[str, Colour] = {BASELINE: TARGET, NO_PRIOR: (176, 166, 200)}
"""The target by itself: with its own controller alone, and learning without a prior."""

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


def subdued(colour: Colour, share: float) -> Colour:
    """Return a share of a colour over the ground: lines in 2D views cannot be translucent."""
    red, green, blue = (
        round(share * c + (1 - share) * g) for c, g in zip(colour, GROUND, strict=True)
    )
    return red, green, blue


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
            self.give(source)
        return self._colours != before

    def give(self, source: str) -> Colour:
        """Return the colour of a source, which gets its own if it has none."""
        if source not in self._colours:
            index = sum(colour != TARGET for colour in self._colours.values())
            self._colours[source] = _tint(_BASE[index % len(_BASE)], index // len(_BASE))
        return self._colours[source]

    def of_prior(self, prior: str) -> Colour:
        """The colour of flights, by who gave the prior."""
        return _NO_SOURCE.get(prior) or self.give(prior)

    def of(self, robot: str) -> Colour:
        """The robot's colour; quiet while it has none of its own."""
        return self._colours.get(robot, QUIET)


def _tint(colour: Colour, step: int) -> Colour:
    """Lighter versions for those who come when all colours are given; dark ones would not show."""
    share = 1 - 0.55**step
    red, green, blue = (round(c + (255 - c) * share) for c in colour)
    return red, green, blue
