"""The colours of robots: each the same in the viewer, in plots and in reports.

A robot's colour depends on its name, so that it is kept from run to run, whichever robots take
part. A colour has two shades, one that is read well on light ground and one on dark.
"""

from __future__ import annotations

import re
import zlib
from collections.abc import Collection, Iterable
from typing import NamedTuple

from nufleet.orchestrator.flights.labels import BASELINE, BY_AXIS, MIXTURE, NO_PRIOR, OWN

Shade = tuple[int, int, int]
"""Red, green and blue, from 0 to 255."""


class Colour(NamedTuple):
    """A colour in its two shades."""

    on_light: Shade
    """Shade for figures on white."""
    on_dark: Shade
    """Shade for the viewer."""


# The palette of Okabe and Ito (2008), distinct for colour-blind readers, without black and with a
# yellow that is darkened on white and a blue that is lightened on black.
_HUES = (
    Colour((0, 114, 178), (64, 122, 214)),
    Colour((213, 94, 0), (213, 94, 0)),
    Colour((0, 158, 115), (0, 158, 115)),
    Colour((204, 121, 167), (204, 121, 167)),
    Colour((230, 159, 0), (230, 159, 0)),
    Colour((86, 180, 233), (86, 180, 233)),
    Colour((158, 142, 0), (240, 228, 66)),
)

WITHOUT_SOURCE = {
    BASELINE: Colour((60, 60, 60), (255, 255, 255)),
    NO_PRIOR: Colour((156, 143, 191), (176, 166, 200)),
    OWN: Colour((138, 109, 59), (196, 164, 98)),
    MIXTURE: Colour((47, 143, 111), (150, 220, 200)),
    BY_AXIS: Colour((20, 110, 140), (130, 205, 230)),
}
"""Colours of the target's flights without a source of their own: with its own controller alone,
with online learning from a zero prior, with its model of itself, and with a mixture."""


def robot_colours(robots: Iterable[str]) -> dict[str, Colour]:
    """Return a colour for each robot; no two have the same.

    >>> robot_colours(["drone-2"])["drone-2"] == robot_colours(["drone-1", "drone-2"])["drone-2"]
    True
    """
    places: dict[str, int] = {}
    for robot in sorted(set(robots)):
        places[robot] = free_place(robot, places.values())
    return {robot: colour_at(place) for robot, place in places.items()}


def free_place(robot: str, taken: Collection[int]) -> int:
    """Return the place in the palette that a robot takes when some places are taken.

    The number at the end of its name chooses the hue, or the name itself when it ends otherwise.
    When that hue is taken, the next free one follows; when all are, a paler or darker shade.
    """
    number = re.search(r"\d+$", robot)
    first = int(number[0]) - 1 if number else zlib.crc32(robot.encode())
    used, round_ = set(taken), 0
    while True:
        for step in range(len(_HUES)):
            place = round_ * len(_HUES) + (first + step) % len(_HUES)
            if place not in used:
                return place
        round_ += 1


def colour_at(place: int) -> Colour:
    """Return the colour at a place of the palette."""
    hue, share = _HUES[place % len(_HUES)], 0.55 ** (place // len(_HUES))
    return Colour(
        blended((0, 0, 0), hue.on_light, share), blended((255, 255, 255), hue.on_dark, share)
    )


def blended(ground: Shade, shade: Shade, share: float) -> Shade:
    """Return a shade as if it were painted on another with an opacity of `share`."""
    red, green, blue = (round(g + (s - g) * share) for g, s in zip(ground, shade, strict=True))
    return red, green, blue
