"""The lines, points and texts that all views are made of. Imports Rerun."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import rerun as rr

from nufleet.orchestrator.viewer.draw.palette import Colour
from nufleet.shared.arrays import FloatArray

Times = Sequence[float] | FloatArray
Columns = Iterable[rr.ComponentColumn]

_BLOCKS = (
    (0x20, 0x7E),
    (0xA0, 0x148),
    (0x14A, 0x17F),
    (0x391, 0x3A1),
    (0x3A3, 0x3C9),
    (0x400, 0x45F),
)
"""Ranges of code points that the viewer's font covers: Latin, Greek and Cyrillic letters."""

_SYMBOLS = "‘’“”–—…•−±×→←≤≥∞√№€"


def drawable(text: str) -> str:
    """Replace characters that the viewer's font may lack by "?".

    The headless viewer crashes on a missing glyph.
    """
    return "".join(c if c in "\n" or _has_glyph(c) else "?" for c in text)


def _has_glyph(character: str) -> bool:
    point = ord(character)
    return character in _SYMBOLS or any(low <= point <= high for low, high in _BLOCKS)


def screen_points(*sizes: float) -> FloatArray:
    """Return radii in points that stay the same on the screen at any magnification, shape (n,)."""
    return np.asarray(rr.Radius.ui_points(np.array(sizes)), dtype=np.float64)


def labels_2d(
    places: Sequence[Sequence[float]] | FloatArray, texts: list[str], colours: list[Colour]
) -> rr.Points2D:
    """Return texts at positions of shape (n, 2), with one colour for each or one for all."""
    return rr.Points2D(np.asarray(places, dtype=np.float64), **_as_labels(texts, colours))


def labels_3d(
    places: Sequence[Sequence[float]] | FloatArray, texts: list[str], colours: list[Colour]
) -> rr.Points3D:
    """Return texts at positions of shape (n, 3), with one colour for each or one for all."""
    return rr.Points3D(np.asarray(places, dtype=np.float64), **_as_labels(texts, colours))


def _as_labels(texts: list[str], colours: list[Colour]) -> dict[str, Any]:
    labels = [drawable(text) for text in texts]
    return {"labels": labels, "colors": colours, "radii": [0.0], "show_labels": True}


Strips = Sequence[Sequence[Sequence[float] | FloatArray] | FloatArray]
"""Polylines, each a sequence of points."""


def lines_2d(strips: Strips, colours: list[Colour], width: float) -> rr.LineStrips2D:
    """Return polylines in a plane.

    Args:
        strips: Points (x, y) of each line, shape (points, 2) each.
        colours: One colour for each line, or one for all.
        width: Half width of the lines in points of the screen.
    """
    return rr.LineStrips2D(
        [np.asarray(strip, dtype=np.float64) for strip in strips],
        colors=colours,
        radii=screen_points(width),
    )


def lines_3d(strips: Strips, colours: list[Colour], *widths: float) -> rr.LineStrips3D:
    """Return polylines in space.

    Args:
        strips: Points (x, y, z) of each line, shape (points, 3) each.
        colours: One colour for each line, or one for all.
        widths: Half width in points of the screen, for each line or once for all.
    """
    return rr.LineStrips3D(
        [np.asarray(strip, dtype=np.float64) for strip in strips],
        colors=colours,
        radii=screen_points(*widths),
    )


@contextmanager
def drawn_at(stream: rr.RecordingStream, t_s: float) -> Iterator[None]:
    """Give everything that is logged inside one time on the viewer's clock."""
    stream.set_time("t", duration=t_s)
    try:
        yield
    finally:
        stream.reset_time()


def send(stream: rr.RecordingStream, path: str, times_s: Times, columns: Columns) -> None:
    """Log a column of values at the times of each, on the viewer's clock, in one message."""
    stream.send_columns(path, [rr.TimeColumn("t", duration=times_s)], columns)
