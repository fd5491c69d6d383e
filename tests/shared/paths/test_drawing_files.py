"""Drawings are read from CSV and SVG, and refused with the reason where they are not drawings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.files import SVG_EXTENT_M, read_drawing


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def svg(folder: Path, data: str) -> Path:
    return written(folder, "a.svg", f'<svg xmlns="x"><path id="p" style="a" d="{data}"/></svg>')


def test_a_csv_gives_its_points(tmp_path: Path) -> None:
    path = written(tmp_path, "a.csv", "x_m,y_m\n0.5,-1\n\n1e-1, 0.25\n")
    np.testing.assert_array_equal(read_drawing(path), [[0.5, -1.0], [0.1, 0.25]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0,0\n1,1\n", "first line must be x_m,y_m"),
        ("", "first line must be x_m,y_m"),
        ("x_m,y_m\n1,2\n", "two different points"),
        ("x_m,y_m\n", "two different points"),
        ("x_m,y_m\n0,0\nnan,1\n", "point 2 contains a number that is not finite"),
        ("x_m,y_m\n0,0\n1,2,3\n", "line 3: expected two numbers"),
        ("x_m,y_m\n0,0\none,2\n", "line 3: expected two numbers"),
    ],
)
def test_a_csv_that_is_no_drawing_is_refused(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        read_drawing(written(tmp_path, "a.csv", text))


def test_lines_of_an_svg_are_scaled_centred_and_turned_upright(tmp_path: Path) -> None:
    points = read_drawing(svg(tmp_path, "M 10,20 L 20,20 20,25 h -10 v -5"))
    half, quarter = SVG_EXTENT_M / 2, SVG_EXTENT_M / 4
    expected = [[-half, quarter], [half, quarter], [half, -quarter], [-half, -quarter]]
    np.testing.assert_allclose(points, [*expected, [-half, quarter]], atol=1e-12)


def test_relative_and_absolute_commands_draw_the_same(tmp_path: Path) -> None:
    absolute = read_drawing(svg(tmp_path, "M1 1 L3 2 C4 3 5 3 6 1 Q7 0 8 1 Z"))
    relative = read_drawing(svg(tmp_path, "m1,1l2,1c1,1,2,1,3-1q1-1 2 0z"))
    np.testing.assert_allclose(absolute, relative, atol=1e-12)


def test_a_quadratic_curve_is_a_parabola(tmp_path: Path) -> None:
    x, y = read_drawing(svg(tmp_path, "M0 0 Q1 2 2 0")).T / (SVG_EXTENT_M / 2)
    np.testing.assert_allclose(y, 0.5 - (1 - x**2), atol=1e-12)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ("M0 0 A1 1 0 0 0 2 2", "'A' is not supported"),
        ("M0 0 L1", "wrong count of numbers"),
        ("M0 0 L1 L2 2", "wrong count of numbers"),
        ("M0 0 L1 1 M2 2 L3 3", "pen may not be lifted"),
        ("1 2 L3 3", "without a command"),
        ("M0 0 L1 1 Z 5", "without a command"),
        ("M0 0 L# 1", "not understood"),
        ("M0 0", "two different points"),
        ("M0 0 L1e999 1", "not finite"),
    ],
)
def test_path_data_that_are_no_drawing_are_refused(tmp_path: Path, data: str, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        read_drawing(svg(tmp_path, data))


def test_an_svg_without_one_plain_path_is_refused(tmp_path: Path) -> None:
    for body, message in [
        ("<rect/>", "found 0"),
        ('<path d="M0 0L1 1"/><path d="M0 0L1 1"/>', "found 2"),
        ('<g transform="scale(2)"><path d="M0 0L1 1"/></g>', "transformations"),
    ]:
        with pytest.raises(InvalidInputError, match=message):
            read_drawing(written(tmp_path, "b.svg", f"<svg>{body}</svg>"))


def test_a_file_that_cannot_be_a_drawing_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"\.csv or \.svg"):
        read_drawing(tmp_path / "a.png")
    with pytest.raises(InvalidInputError, match="cannot be read"):
        read_drawing(tmp_path / "missing.csv")
    (tmp_path / "binary.csv").write_bytes(b"\xff\xfe\x00\x80")
    with pytest.raises(InvalidInputError, match="cannot be read"):
        read_drawing(tmp_path / "binary.csv")
    with (tmp_path / "large.csv").open("wb") as file:
        file.truncate(9 * 2**20)
    with pytest.raises(InvalidInputError, match="larger than"):
        read_drawing(tmp_path / "large.csv")
