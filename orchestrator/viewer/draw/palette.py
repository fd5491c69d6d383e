"""The colours of the robots: the same in every view, and distinct for colour-blind readers too."""

from __future__ import annotations

from collections.abc import Iterable

from nufleet.orchestrator.flights.labels import BASELINE, MIXTURE, NO_PRIOR, OWN

Colour = tuple[int, int, int]

TARGET: Colour = (255, 255, 255)
"""Colour of the target, white; no source gets it."""

REFERENCE: Colour = (130, 136, 148)
"""Colour of references and of priors."""

WANTED: Colour = (214, 218, 226)
"""Colour of the desired path, a thin line over the flights along it."""

QUIET: Colour = (92, 98, 112)
"""Colour of robots far down the ranking, which have none of their own."""

GRID: Colour = (44, 48, 56)
TEXT: Colour = (168, 174, 186)
GROUND: Colour = (16, 18, 22)
"""Background of the views, independent of the viewer's theme."""

ALARM: Colour = (235, 90, 90)
"""Colour of marks where the guard acted."""

_NO_SOURCE: dict[str, Colour] = {
    BASELINE: TARGET,
    NO_PRIOR: (176, 166, 200),
    OWN: (196, 164, 98),
    MIXTURE: (150, 220, 200),
}
"""Colours of the target's flights without a source of their own: with its own controller alone,
with online learning from a zero prior, with its model of itself, and with a mixture."""

# Palette of Okabe and Ito (2008) for a dark background: lighter blue, and no black.
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
    """Return a colour blended with the background, as if it had `share` of its opacity.

    Lines in 2D views cannot be translucent.
    """
    return _blended(GROUND, colour, share)


class Palette:
    """Assigns colours to robots.

    A source gets a colour when it is among the leading ones for the first time, and keeps it from
    then on. The contenders of a large fleet thus have colours that are easy to tell apart.
    """

    def __init__(self) -> None:
        self._colours: dict[str, Colour] = {}

    def assign(self, target: str, leaders: Iterable[str]) -> None:
        """Assign colours to the target and to the leading sources."""
        self._colours[target] = TARGET
        for source in leaders:
            self.give(source)

    def give(self, source: str) -> Colour:
        """Return the colour of a source, assigning one if it has none."""
        if source not in self._colours:
            index = sum(colour != TARGET for colour in self._colours.values())
            self._colours[source] = _tint(_BASE[index % len(_BASE)], index // len(_BASE))
        return self._colours[source]

    def of_prior(self, prior: str) -> Colour:
        """Return the colour of flights, given by the source of their prior, BASELINE, NO_PRIOR
            or OWN.

        A source without a colour is assigned one.
        """
        return _NO_SOURCE.get(prior) or self.give(prior)

    def of(self, robot: str) -> Colour:
        """Return the colour of a robot; `QUIET` while it has none of its own."""
        return self._colours.get(robot, QUIET)


def _tint(colour: Colour, step: int) -> Colour:
    """Return a lighter version of a colour, for use when all colours of the palette are taken.

    Darker versions would not show on the background.
    """
    return _blended(colour, (255, 255, 255), 1 - 0.55**step)


def _blended(colour: Colour, other: Colour, share: float) -> Colour:
    red, green, blue = (round(c + (o - c) * share) for c, o in zip(colour, other, strict=True))
    return red, green, blue
