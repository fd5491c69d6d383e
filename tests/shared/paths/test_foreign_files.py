"""Tables and SVGs of other programs become points, or are refused with the line and the reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.files import read_drawing, write_drawing
from nufleet.shared.paths.foreign_files import import_drawing
from nufleet.shared.paths.trajectories import POINTS_MAX


def written(folder: Path, text: str, name: str = "a.csv") -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


@pytest.mark.parametrize(
    "text",
    [
        "x_m,y_m\n0,1\n2,3\n",
        "0,1\n2,3\n",
        "0;1\n2;3\n",
        "0\t1\n2\t3",
        "# by hand\n 0 1 \n\n  2   3\n",
        "X, Y\n0, 1\n2, 3\n",
        '"x","y"\n0,1\n2,3\n',
        "t,x,y,pressure\n9,0,1,9\n9,2,3,9\n",
        "y x\n1 0\n3 2\n",
        "0,1,\n2,3,\n",
        "\ufeff0,1\r\n2,3\r\n",
        "across,up\n0,1\n2,3\n",
        "Zeit;x;y;;\n9;0;1;;\n9;2;3;;\n",
        "time [s],x [m],y [m],z [m]\n0,0,1,5\n1,2,3,5\n",
        "x [mm];y [mm]\n0;1000\n2000;3000\n",
        "x/cm\ty/cm\n0\t100\n2e2\t300\n",
        "x in mm;y in mm\n0;1000\n2000;3000\n",
        "sep=;\r\nx;y\r\n0,0;1,0\r\n2,0;3,0\r\n",
        "sep=,\n0,1\n2,3\n",
    ],
)
def test_tables_are_understood_however_they_are_written(tmp_path: Path, text: str) -> None:
    np.testing.assert_array_equal(import_drawing(written(tmp_path, text)).points, [[0, 1], [2, 3]])


@pytest.mark.parametrize(
    ("heading", "ignored"),
    [("x,y", ()), ("t [s],x,Y,Druck", ("t [s]", "Druck")), ('"z","x",,"y"', ("z",))],
)
def test_headings_of_other_columns_are_told(
    tmp_path: Path, heading: str, ignored: tuple[str, ...]
) -> None:
    numbers = "\n".join(",".join(str(k * row) for k in range(4)) for row in (1, 2))
    numbers = numbers if ignored else "0,1\n2,3"
    assert import_drawing(written(tmp_path, f"{heading}\n{numbers}")).ignored == ignored


@pytest.mark.parametrize(
    "text",
    [
        "x;y\n1,5;-2,5\n1,6;3e-1\n",
        "x;y\r\n1,5;-2,5\r\n1,6;,3\r\n",
        "1,5\t-2,5\n1,6\t0,3\n",
        "1,5 -2,5\n1,6  0,3\n",
        "x y\n1,5 -2,5\n1,6 0,3\n",
        "x;y\n1.5;-2.5\n1.6;.3\n",
        '"x";"y"\n"1,5";"-2,5"\n"1,6";"0,3"\n',
        "x_m, y_m\n1.5, -2.5\n1.6, 0.3\n",
    ],
)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16"])
def test_a_comma_is_a_decimal_comma_where_it_separates_nothing(
    tmp_path: Path, text: str, encoding: str
) -> None:
    path = tmp_path / "a.csv"
    path.write_bytes(text.encode(encoding))
    np.testing.assert_array_equal(import_drawing(path).points, [[1.5, -2.5], [1.6, 0.3]])


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("x,y\n1,5,2,5\n1,6,2,6\n", "line 2: 4 cells in a table of 2 columns; are these decimal"),
        ("1;2\n1;2;3\n", "line 2: 3 cells in a table of 2 columns, got"),
        ("x;y\n1,5;2.5\n", "line 2: some numbers have a decimal comma and others a decimal point"),
        ("x;y\n1.234,5;2\n", "line 2: expected numbers for x and y"),
        ("x;y\n0,1\n", "line 2: expected numbers for x and y"),
        ("0,1\n2,x\n", "line 2: expected numbers for x and y, got '2,x'"),
        ("0,1\n2\n", "line 2: expected numbers"),
        ("1,2,3\n4,5,6\n", "line 1: 3 columns; add a first line that names two of them x and y"),
        ("1\n2\n", "line 1: one column, where x and y are expected, got '1'"),
        ("0,1\nnan,3\n", "point 2 contains a number that is not finite"),
        ("x,y\n0,1\n", "two different points"),
        ("x [in];y [in]\n0;1\n2;3\n", "line 1: the unit 'in' is not one of m, cm, mm"),
        ("", "two different points"),
        ("\n".join("1,2" for _ in range(POINTS_MAX + 1)), "more than 100000 points"),
    ],
)
def test_what_is_no_drawing_is_refused_with_the_line(tmp_path: Path, text: str, words: str) -> None:
    with pytest.raises(InvalidInputError, match=words):
        import_drawing(written(tmp_path, text))


def test_an_svg_is_read_as_ever(tmp_path: Path) -> None:
    path = written(tmp_path, '<svg><path d="M0 0 L10 0 L10 5"/></svg>', "a.svg")
    np.testing.assert_array_equal(import_drawing(path).points, read_drawing(path))


def test_a_file_that_cannot_be_read_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="cannot be read"):
        import_drawing(tmp_path / "missing.csv")
    (tmp_path / "a.png").write_bytes(b"\x89PNG\xff\xfe")
    with pytest.raises(InvalidInputError, match="expected a table of x and y, or an SVG"):
        import_drawing(tmp_path / "a.png")


def test_what_is_written_is_read_back_to_a_tenth_of_a_millimetre(tmp_path: Path) -> None:
    points = np.random.default_rng(0).uniform(-2, 2, (300, 2))
    write_drawing(tmp_path / "a.csv", points)
    back = read_drawing(tmp_path / "a.csv")
    np.testing.assert_allclose(back, points, atol=0.5001e-4)
    write_drawing(tmp_path / "b.csv", back)
    assert (tmp_path / "a.csv").read_bytes() == (tmp_path / "b.csv").read_bytes()


def test_what_could_not_be_read_back_is_not_written(tmp_path: Path) -> None:
    points = np.array([[0.0, 0.0], [1.0, 1.0]])
    with pytest.raises(InvalidInputError, match=r"stored as a \.csv"):
        write_drawing(tmp_path / "a.svg", points)
    with pytest.raises(InvalidInputError, match="two different points"):
        write_drawing(tmp_path / "a.csv", 1e-6 * points)
    with pytest.raises(InvalidInputError, match="not finite"):
        write_drawing(tmp_path / "a.csv", points * np.nan)
    with pytest.raises(InvalidInputError, match="cannot be written"):
        write_drawing(tmp_path / "nowhere" / "a.csv", points)
    assert list(tmp_path.iterdir()) == []
