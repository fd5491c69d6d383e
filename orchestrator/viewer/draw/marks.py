"""The lines, points and texts that the drawings share. Imports Rerun."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr

from nufleet.orchestrator.viewer.draw.palette import Colour
from nufleet.shared.arrays import FloatArray

_BLOCKS = (
    (0x20, 0x7E),
    (0xA0, 0x148),
    (0x14A, 0x17F),
    (0x391, 0x3A1),
    (0x3A3, 0x3C9),
    (0x400, 0x45F),
)
"""Latin, Greek and Cyrillic letters, as code points."""

_SYMBOLS = "‘’“”–—…•−±×→←≤≥∞√№€"


def drawable(text: str) -> str:
    """Replace what the viewer's font may lack: the headless viewer dies of a missing glyph."""
    return "".join(c if c in "\n" or _has_glyph(c) else "?" for c in text)


def _has_glyph(character: str) -> bool:
    point = ord(character)
    return character in _SYMBOLS or any(low <= point <= high for low, high in _BLOCKS)


def screen_points(*sizes: float) -> FloatArray:
    """Return radii that stay the same on the screen, however near one looks; shape (n,)."""
    return np.asarray(rr.Radius.ui_points(np.array(sizes)), dtype=np.float64)


def labels_2d(
    places: Sequence[Sequence[float]] | FloatArray, texts: list[str], colours: list[Colour]
) -> rr.Points2D:
    """Return texts at places, shape (n, 2), each in its colour or all in one."""
    return rr.Points2D(
        np.asarray(places, dtype=np.float64),
        labels=[drawable(text) for text in texts],
        colors=colours,
        radii=[0.0],
        show_labels=True,
    )


def labels_3d(
    places: Sequence[Sequence[float]] | FloatArray, texts: list[str], colours: list[Colour]
) -> rr.Points3D:
    """Return texts at places, shape (n, 3), each in its colour or all in one."""
    return rr.Points3D(
        np.asarray(places, dtype=np.float64),
        labels=[drawable(text) for text in texts],
        colors=colours,
        radii=[0.0],
        show_labels=True,
    )


def lines_2d(
    strips: Sequence[Sequence[Sequence[float] | FloatArray] | FloatArray],
    colours: list[Colour],
    width: float,
) -> rr.LineStrips2D:
    """Return polylines of (x, y) in their colours or all in one, `width` points wide each side."""
    return rr.LineStrips2D(
        [np.asarray(strip, dtype=np.float64) for strip in strips],
        colors=colours,
        radii=screen_points(width),
    )


def lines_3d(
    strips: Sequence[Sequence[Sequence[float] | FloatArray] | FloatArray],
    colours: list[Colour],
    *widths: float,
) -> rr.LineStrips3D:
    """Return polylines of (x, y, z), in their colours and widths or all in one."""
    return rr.LineStrips3D(
        [np.asarray(strip, dtype=np.float64) for strip in strips],
        colors=colours,
        radii=screen_points(*widths),
    )
