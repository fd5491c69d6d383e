"""SVGs of drawing programs become paths, or are refused with the reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.paths.svg import SVG_CHARACTERS_MAX, SVG_EXTENT_M, svg_points

INKSCAPE = """<?xml version="1.0" encoding="UTF-8" standalone="no"?>
<!-- Created with Inkscape (http://www.inkscape.org/) -->
<svg width="210mm" height="297mm" viewBox="0 0 210 297" version="1.1" id="svg5"
   inkscape:version="1.2.2" sodipodi:docname="drawing.svg"
   xmlns:inkscape="http://www.inkscape.org/namespaces/inkscape"
   xmlns:sodipodi="http://sodipodi.sourceforge.net/DTD/sodipodi-0.dtd"
   xmlns="http://www.w3.org/2000/svg" xmlns:svg="http://www.w3.org/2000/svg">
  <sodipodi:namedview id="namedview7" pagecolor="#ffffff" inkscape:document-units="mm"/>
  <defs id="defs2"><path d="M 0,0 L 900,900" id="marker"/></defs>
  <g inkscape:label="Layer 1" inkscape:groupmode="layer" id="layer1" transform="translate(5,-7)">
    <path style="fill:none;stroke:#000000;stroke-width:0.264583px" id="path111"
       transform="matrix(0,1,-1,0,30,40)" sodipodi:nodetypes="cc"
       d="m 10,10 h 20 a 5,5 0 0 1 0,10 z"/>
  </g>
  <g inkscape:label="Hidden" inkscape:groupmode="layer" style="display:none">
    <path d="M 0,0 L 900,900"/>
  </g>
</svg>
"""


def drawn(body: str) -> FloatArray:
    return svg_points(f'<svg xmlns="http://www.w3.org/2000/svg">{body}</svg>', "a.svg")


def path(data: str) -> FloatArray:
    return drawn(f'<path id="p" style="a" d="{data}"/>')


def test_lines_are_scaled_centred_and_turned_upright() -> None:
    half, quarter = SVG_EXTENT_M / 2, SVG_EXTENT_M / 4
    expected = [[-half, quarter], [half, quarter], [half, -quarter], [-half, -quarter]]
    points = path("M 10,20 L 20,20 20,25 h -10 v -5")
    np.testing.assert_allclose(points, [*expected, [-half, quarter]], atol=1e-12)


def test_relative_and_absolute_commands_draw_the_same() -> None:
    absolute = path("M1 1 L3 2 C4 3 5 3 6 1 Q7 0 8 1 S 9 9 9 1 T 10 2 A1 2 0 0 1 11 2 Z")
    relative = path("m1,1l2,1c1,1,2,1,3-1q1-1 2 0s1 8 1 0t1 1a1,2 0 011,0z")
    np.testing.assert_allclose(absolute, relative, atol=1e-12)


def test_a_quadratic_curve_is_a_parabola() -> None:
    x, y = path("M0 0 Q1 2 2 0").T / (SVG_EXTENT_M / 2)
    np.testing.assert_allclose(y, 0.5 - (1 - x**2), atol=1e-12)


@pytest.mark.parametrize(
    "body",
    [
        '<path d="M 2 0 A 2 2 0 1 0 -2 0 A 2 2 0 1 0 2 0"/>',
        '<circle cx="7" cy="1" r="3"/>',
        '<ellipse rx="3" ry="6" transform="rotate(30) scale(2 1)"/>',
    ],
)
def test_an_arc_is_part_of_a_circle(body: str) -> None:
    points = drawn(body)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), SVG_EXTENT_M / 2, rtol=1e-2)
    assert np.abs(np.diff(points, axis=0)).max() < 0.1 * SVG_EXTENT_M


def test_a_file_of_inkscape_is_drawn_as_it_is_shown(tmp_path: Path) -> None:
    file = tmp_path / "drawing.svg"
    file.write_text(INKSCAPE)
    found = read_drawing(file)
    # Turned by a quarter: from (10, 10) rightwards becomes downwards.
    np.testing.assert_allclose(found, path("M 20 10 v 20 a 5 5 0 0 1 -10 0 z"), atol=1e-5)


@pytest.mark.parametrize(
    "body",
    [
        '<path d="M0 0 L4 0 M4 2 L0 2 L0 0"/>',
        '<path d="M0 0 L4 0"/><g><path d="M4 2 L0 2"/></g><path d="M0 2 L0 0"/>',
        '<polyline points="0,0 4,0 4,2"/><line x1="4" y1="2" x2="0" y2="2"/><path d="M0 2V0"/>',
        '<rect width="4" height="2"/>',
        '<polygon points="0,0 4,0 4,2 0,2"/>',
    ],
)
def test_several_parts_are_joined_by_lines_in_their_order(body: str) -> None:
    points = drawn(body)
    corners = points[np.append(True, np.any(np.diff(points, axis=0), axis=1))]
    np.testing.assert_allclose(corners, path("M0 0 H4 V2 H0 Z"), atol=1e-12)


@pytest.mark.parametrize(
    "data",
    ["M0 0 L1", "M0 0 L1 L2 2", "1 2 L3 3", "L3 3", "M0 0 L1 1 Z 5", "M0 0 L# 1", "M0 0 L1 1 X 2"],
)
def test_invalid_path_data_are_refused(data: str) -> None:
    with pytest.raises(InvalidInputError, match=r"^a\.svg: (not a valid SVG|invalid path data)"):
        path(data)


@pytest.mark.parametrize(
    ("body", "message"),
    [
        ("", "no path and no other shape"),
        ("<text>heart</text>", "no path and no other shape"),
        ('<path d=""/>', "no path and no other shape"),
        ('<path d="M0 0"/>', "two different points"),
        ('<path d="M0 0 L1e999 1"/>', "not finite"),
        ('<path d="M0 0 L1e12 1"/>', "1e\\+12 units long"),
        ('<path d="M0 0 L1 1"', "not a valid SVG"),
        ('<path id="p" d="M0 0L1 1"/><use href="#p"/>', "unlink them"),
        ("<style>a{b:c" + "[" * 10_000 + '}</style><path d="M0 0"/>', "two different points"),
        (f'<path d="M0 0{"h1" * 100_001}"/>', "at most 100000 points"),
        ("<g>" * 20_000 + '<path d="M0 0H1"/>' + "</g>" * 20_000, "not a valid SVG"),
        (" " * SVG_CHARACTERS_MAX, "an SVG of more than 2097152 characters"),
    ],
)
def test_what_is_no_drawing_is_refused(body: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=f"^a.svg: .*{message}"):
        drawn(body)


def test_entities_which_may_expand_to_billions_of_elements_are_refused() -> None:
    text = '<!DOCTYPE svg [<!ENTITY a "<path/>">]><svg>&a;</svg>'
    with pytest.raises(InvalidInputError, match="entities"):
        svg_points(text, "a.svg")
