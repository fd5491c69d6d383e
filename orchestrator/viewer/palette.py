"""One colour for each robot, the same in every view, told apart by the colour-blind too."""

from __future__ import annotations

Colour = tuple[int, int, int]

TARGET: Colour = (255, 255, 255)
"""No source is white."""

REFERENCE: Colour = (130, 136, 148)
QUIET: Colour = (92, 98, 112)
"""For what is there but not the point: sources far down the ranking, grids."""

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
    """Gives robots their colours in the order in which they are first seen."""

    def __init__(self) -> None:
        self._index: dict[str, int] = {}
        self._target: str | None = None

    def name_target(self, robot: str) -> bool:
        """Say which robot is the target; whether that is news."""
        news = self._target != robot
        self._target = robot
        return news

    def of(self, robot: str) -> Colour:
        """The robot's colour."""
        if robot == self._target:
            return TARGET
        index = self._index.setdefault(robot, len(self._index))
        return _shade(_BASE[index % len(_BASE)], index // len(_BASE))


def _shade(colour: Colour, step: int) -> Colour:
    """Lighter and darker versions for fleets of more robots than the palette has colours."""
    if step == 0:
        return colour
    towards, share = ((255, 0)[step % 2 == 0], min(0.25 * ((step + 1) // 2 + 1), 0.7))
    red, green, blue = (round(c + (towards - c) * share) for c in colour)
    return red, green, blue
