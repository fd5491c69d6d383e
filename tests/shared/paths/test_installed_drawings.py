"""A drawing is found by its path, or by the name that a distribution registers it under."""

from __future__ import annotations

from pathlib import Path

import pytest

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.installed import ENTRY_POINT_GROUP, find_drawing


@pytest.fixture
def distribution(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Install a distribution with one drawing, `spiral`; return the drawing's path."""
    metadata = tmp_path / "more_drawings-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: more-drawings\nVersion: 1.0\n")
    (metadata / "entry_points.txt").write_text(
        f"[{ENTRY_POINT_GROUP}]\nspiral = drawings_of_a_stranger:SPIRAL\n"
    )
    drawing = tmp_path / "spiral.csv"
    drawing.write_text("x_m,y_m\n0,0\n1,0\n")
    (tmp_path / "drawings_of_a_stranger.py").write_text(
        f"from pathlib import Path\nSPIRAL = Path({str(drawing)!r})\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    return drawing


def test_a_drawing_is_found_by_its_path(tmp_path: Path) -> None:
    drawing = tmp_path / "mine.svg"
    drawing.touch()
    assert find_drawing(str(drawing)) == drawing


def test_another_distribution_can_add_a_drawing_by_name(distribution: Path) -> None:
    assert find_drawing("spiral") == distribution


def test_an_unknown_drawing_is_named_with_those_there_are(distribution: Path) -> None:
    with pytest.raises(InvalidInputError, match=r"spral: no such drawing; .*spiral"):
        find_drawing("spral")
