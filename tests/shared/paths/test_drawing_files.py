"""Drawings are read from CSV, and refused with the reason where they are not drawings."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.files import read_drawing


def written(folder: Path, name: str, text: str) -> Path:
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


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
