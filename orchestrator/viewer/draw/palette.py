"""The colours of the robots: the same in every view, and distinct for colour-blind readers too."""

from __future__ import annotations

from collections.abc import Iterable

from nufleet.orchestrator.flights.colours import (
    WITHOUT_SOURCE,
    Shade,
    blended,
    colour_at,
    free_place,
)
from nufleet.orchestrator.flights.labels import guarded_name

Colour = Shade

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


UNGUARDED = 0.6
"""Brightness of flights without the guard."""


def subdued(colour: Colour, share: float) -> Colour:
    """Return a colour blended with the background, as if it had `share` of its opacity.

    Lines in 2D views cannot be translucent.
    """
    return blended(GROUND, colour, share)


class Palette:
    """Assigns colours to robots; each keeps the colour that it got first."""

    def __init__(self) -> None:
        self._target = ""
        self._places: dict[str, int] = {}

    def assign(self, target: str, sources: Iterable[str]) -> None:
        """Assign colours to the target and to sources."""
        self._target = target
        for source in sorted(sources):
            self.give(source)

    def give(self, source: str) -> Colour:
        """Return the colour of a source, assigning one if it has none."""
        if source not in self._places:
            self._places[source] = free_place(source, self._places.values())
        return self.of(source)

    def of_prior(self, prior: str) -> Colour:
        """Return the colour of flights, given by the source of their prior, BASELINE, NO_PRIOR
            or OWN.

        A source without a colour is assigned one. A flight without the guard is paler.
        """
        known = WITHOUT_SOURCE.get(prior)
        if known is not None:
            return known.on_dark
        source = guarded_name(prior)
        return self.give(source) if source == prior else subdued(self.give(source), UNGUARDED)

    def of(self, robot: str) -> Colour:
        """Return the colour of a robot; `QUIET` while it has none of its own."""
        if robot == self._target:
            return TARGET
        place = self._places.get(robot)
        return QUIET if place is None else colour_at(place).on_dark
