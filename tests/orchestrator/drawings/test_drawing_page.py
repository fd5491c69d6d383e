"""The page to draw on: it saves one drawing, to this machine alone, and ends."""

from __future__ import annotations

import json
import threading
import urllib.error
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from polling import PATIENCE_S

from nufleet.orchestrator.drawings.page import SPACING_M, DrawingPage
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import EndpointInUseError, InvalidInputError
from nufleet.shared.paths.files import read_drawing, write_drawing

TURN = np.linspace(0.0, 2 * np.pi, 300)
CIRCLE = np.stack([np.cos(TURN), np.sin(TURN)], axis=1)


@contextmanager
def page(folder: Path, **settings: Any) -> Iterator[DrawingPage]:
    threads = set(threading.enumerate())
    port = settings.pop("port", 0)
    with DrawingPage(
        port, 1.3, lambda points: write_drawing(folder / "a.csv", points), **settings
    ) as served:
        yield served
    left = {t for t in threading.enumerate() if t.name == "drawing-page"}
    assert left <= threads


def asked(url: str, body: bytes | None = None) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(url, body, timeout=PATIENCE_S) as answer:  # noqa: S310 - our own page
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        return error.code, error.read().decode()


def posted(served: DrawingPage, points: FloatArray) -> tuple[int, str]:
    return asked(served.url, json.dumps({"points": points.tolist()}).encode())


def test_the_page_has_a_paper_as_large_as_was_asked_for(tmp_path: Path) -> None:
    with page(tmp_path) as served:
        status, html = asked(served.url)
    assert status == 200
    assert "<canvas" in html
    assert "const extent = 1.3;" in html
    assert "const workspace = null;" in html
    assert html.index("Save</button>") < html.index("<canvas"), "in sight on a low screen"


def test_the_page_shows_the_workspace_of_the_robots_and_how_long_they_take(tmp_path: Path) -> None:
    with page(tmp_path, workspace_m=0.9, speed_m_s=0.4) as served:
        _, html = asked(served.url)
    assert "const workspace = 0.9;" in html
    assert "const speed = 0.4;" in html


def test_a_drawing_is_saved_evenly_spaced_and_ends_the_wait(tmp_path: Path) -> None:
    with page(tmp_path) as served:
        status, said = posted(served, CIRCLE)
        points = served.wait(timeout_s=PATIENCE_S)
    assert status == 200
    assert float(said.removeprefix("saved: ").removesuffix(" m long")) == pytest.approx(
        6.28, abs=0.05
    )
    saved = read_drawing(tmp_path / "a.csv")
    np.testing.assert_allclose(saved, points, atol=1e-4)
    steps = np.linalg.norm(np.diff(saved, axis=0), axis=1)
    assert steps.max() <= SPACING_M + 2e-4
    # Smoothing takes tremor, not the figure.
    assert np.abs(np.linalg.norm(saved, axis=1) - 1.0).max() < 0.02


@pytest.mark.parametrize(
    ("body", "words"),
    [
        (b"{}", "points"),
        (b"not json", "JSON"),
        (b'{"points": [[0, 0]]}', "2 items"),
        (b'{"points": [[0, 0], [0, 0]]}', "two different points"),
        (b'{"points": [[0, 0], [1, NaN]]}', "points"),
        (b'{"points": [[0, 0], [1, 1, 1]]}', "points"),
        (b'{"points": [[0, 0], [1, "1"]]}', "points"),
    ],
)
def test_what_is_no_drawing_is_refused_on_the_page_which_goes_on(
    tmp_path: Path, body: bytes, words: str
) -> None:
    with page(tmp_path) as served:
        status, said = asked(served.url, body)
        assert status == 400
        assert words in said
        assert not (tmp_path / "a.csv").exists()
        assert posted(served, CIRCLE)[0] == 200


def test_only_who_knows_the_address_may_save(tmp_path: Path) -> None:
    with page(tmp_path) as served:
        body = json.dumps({"points": CIRCLE.tolist()}).encode()
        root = served.url.rsplit("/", 1)[0]
        assert asked(f"{root}/", body)[0] == 404
        assert asked(f"{root}/")[0] == 404
        with pytest.raises(TimeoutError):
            served.wait(timeout_s=0.01)
    assert not (tmp_path / "a.csv").exists()


def test_a_second_drawing_does_not_replace_the_first(tmp_path: Path) -> None:
    with page(tmp_path) as served:
        assert posted(served, CIRCLE)[0] == 200
        assert posted(served, 0.5 * CIRCLE)[0] == 409
    assert np.abs(read_drawing(tmp_path / "a.csv")).max() > 0.9


def test_a_file_that_cannot_be_written_is_said_on_the_page(tmp_path: Path) -> None:
    def refuse(points: FloatArray) -> None:
        raise InvalidInputError("a.csv: cannot be written: disk full")

    with DrawingPage(0, 1.3, refuse) as served:
        assert posted(served, CIRCLE) == (400, "a.csv: cannot be written: disk full")


def test_a_port_that_is_taken_is_named(tmp_path: Path) -> None:
    with page(tmp_path) as served:
        port = int(served.url.split(":")[2].split("/")[0])
        with pytest.raises(EndpointInUseError, match=f"port {port}"):
            DrawingPage(port, 1.3, lambda points: None)
