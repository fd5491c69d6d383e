"""Reading of drawn paths from SVG files, as drawing programs such as Inkscape write them."""

from __future__ import annotations

import io
import re
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.trajectories import check_path

if TYPE_CHECKING:
    from svgelements import PathSegment

SVG_CHARACTERS_MAX = 2 * 2**20
"""Longest accepted SVG, which takes some seconds to read."""

SVG_EXTENT_M = 2.4
"""Length given to the longer side of a drawing, since a page has no size in flight; the drawing is
centred on the origin."""

SVG_NUMBER_MAX = 1e9
"""Largest accepted extent; no drawing needs a larger one, and its square would overflow."""

_CURVE_POINTS = 24
"""Number of chords that replace a Bézier curve, or a quarter of an ellipse."""

_INVALID = (
    ArithmeticError,
    AttributeError,
    LookupError,
    ElementTree.ParseError,
    RecursionError,
    TypeError,
    ValueError,
)
_PATH_DATA = re.compile(r"\s*(?:[Mm][MmZzLlHhVvCcSsQqTtAaEe0-9,.+\s-]*)?")


def svg_points(text: str, name: str) -> FloatArray:
    """Return the points of an SVG's shapes, scaled to `SVG_EXTENT_M`, shape (n, 2), in m.

    Shapes and subpaths follow one another in the order of the file, joined by straight lines, since
    a robot draws them in one flight. Transformations and units are applied, and curves are replaced
    by chords. What is not displayed is left out.

    Args:
        text: Content of the file.
        name: Name of the file, for error messages.

    Raises:
        InvalidInputError: the text is not a valid SVG, contains clones or no shape, or its shapes
            are not a path.
    """
    from svgelements import SVG, Shape

    if len(text) > SVG_CHARACTERS_MAX:
        raise InvalidInputError(f"{name}: an SVG of more than {SVG_CHARACTERS_MAX} characters")
    if "<!ENTITY" in text:
        raise InvalidInputError(f"{name}: defines entities; save it as a plain SVG")
    try:
        document = SVG.parse(io.StringIO(_harmless(text, name)), on_error="raise")
        shapes = [element for element in document.elements() if isinstance(element, Shape)]
        with np.errstate(all="ignore"):  # numbers that are not finite are refused below
            parts = [_points(segment) for shape in shapes for segment in shape.segments()]
    except _INVALID as error:
        raise InvalidInputError(f"{name}: not a valid SVG: {error}") from error
    if not parts:
        raise InvalidInputError(f"{name}: it shows no path and no other shape")
    points = np.concatenate(parts)
    check_path(points, name)
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float((high - low).max())
    if not 1 / SVG_NUMBER_MAX < extent < SVG_NUMBER_MAX:
        raise InvalidInputError(f"{name}: the drawing is {extent:g} units long")
    scale = SVG_EXTENT_M / extent
    return np.asarray((points - (low + high) / 2) * scale * np.array([1.0, -1.0]))


def _harmless(text: str, name: str) -> str:
    """Return an SVG without what could occupy its reader for hours, or be misread.

    Raises:
        InvalidInputError: it contains clones, which could make a small file expand to billions of
            elements, or invalid path data, which svgelements would read up to the fault.
    """
    root = ElementTree.fromstring(text)  # noqa: S314 - entities, the known attack, were refused
    for element in root.iter():
        tag = element.tag.rpartition("}")[2]
        if tag == "use":
            raise InvalidInputError(f"{name}: contains clones (<use>); unlink them first")
        if tag == "style":
            element.clear()  # only colours, and slow for some regular expressions
        if not _PATH_DATA.fullmatch(element.get("d", "")):
            raise InvalidInputError(f"{name}: invalid path data {element.get('d')!r:.60}")
    return ElementTree.tostring(root, encoding="unicode")


def _points(segment: PathSegment) -> FloatArray:
    """Return the points of a segment after its start, shape (n, 2); of a line only its end."""
    from svgelements import Arc, CubicBezier, QuadraticBezier

    if not isinstance(segment, Arc | CubicBezier | QuadraticBezier):
        return np.array([segment.end], dtype=np.float64)
    quarters = abs(segment.sweep) / (np.pi / 2) if isinstance(segment, Arc) else 1.0
    chords = int(np.ceil(_CURVE_POINTS * quarters))
    return np.asarray(segment.npoint(np.arange(1, chords + 1) / chords), dtype=np.float64)
