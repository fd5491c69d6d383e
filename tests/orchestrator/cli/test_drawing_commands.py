"""`nufleet drawing ...` as its user sees it: checked files, pictures, and who may fly them."""

from __future__ import annotations

import json
import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any

import click
import matplotlib.image
import numpy as np
import pytest
from click.testing import CliRunner, Result
from robots_that_learn import LaggedRobot

from nufleet.orchestrator.cli.drawing import import_drawing, list_drawings, show
from nufleet.orchestrator.drawings.picture import travelled
from nufleet.orchestrator.drawings.report import SPEEDS, refusals, report_of
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.wire.messages import Description

ROOT = Path(__file__).parents[3]
HEART = "M 50 90 C 0 50 10 10 50 30 C 90 10 100 50 50 90 Z"


@pytest.fixture(autouse=True)
def _in_a_folder_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "heart.svg").write_text(f'<svg><path d="{HEART}"/></svg>')
    (tmp_path / "tall.txt").write_text("x;y\n0;0\n1;10\n0;20\n")


def run(command: click.Command, *arguments: str) -> Result:
    return CliRunner().invoke(command, arguments)


def document_of(result: Result) -> dict[str, Any]:
    assert result.exit_code == 0, result.exception
    document = json.loads(result.stdout)
    assert isinstance(document, dict)
    return document


def test_an_svg_becomes_a_centred_csv_of_the_height_asked_for() -> None:
    arguments = ("heart.svg", "--out", "heart.csv", "--height", "2", "--center")
    document = document_of(run(import_drawing, *arguments, "--json"))
    points = read_drawing(Path("heart.csv"))
    assert np.ptp(points, axis=0)[1] == pytest.approx(2.0, abs=0.01)
    np.testing.assert_allclose(points.min(axis=0), -points.max(axis=0), atol=0.01)
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    assert steps.max() <= 0.0202
    assert (document["schema"], document["drawing"], document["file"]) == (1, "heart", "heart.csv")
    assert document["shape"]["height_m"] == pytest.approx(2.0, abs=0.01)
    assert [d["speed"] for d in document["durations"]] == list(SPEEDS)
    durations = [d["duration_s"] for d in document["durations"]]
    assert durations == sorted(durations, reverse=True)


def test_it_says_in_words_what_was_imported_and_how_to_track_it() -> None:
    result = run(import_drawing, "tall.txt", "--height", "1")
    assert result.exit_code == 0
    for words in ("m long", "tightest curve", "0.6 m/s"):
        assert words in result.stdout
    assert result.stderr == "track it with:  nufleet track --target NAME --trajectory tall.csv\n"
    assert np.ptp(read_drawing(Path("tall.csv")), axis=0) == pytest.approx([0.05, 1.0], abs=1e-3)


def test_columns_that_are_not_imported_are_named() -> None:
    Path("logged.csv").write_text("time,x,y,z\n0,0,0,1\n1,1,1,1\n2,2,0,1\n")
    result = run(import_drawing, "logged.csv", "--out", "drawing.csv")
    assert result.exit_code == 0
    assert "not imported: time, z. A drawing is a curve in x and y" in result.stderr


def test_a_file_that_is_there_is_not_replaced_unless_one_says_so() -> None:
    Path("heart.csv").write_text("mine")
    refused = run(import_drawing, "heart.svg")
    assert isinstance(refused.exception, InvalidInputError)
    assert "heart.csv already exists" in str(refused.exception)
    assert Path("heart.csv").read_text() == "mine"
    assert run(import_drawing, "heart.svg", "--force").exit_code == 0
    assert len(read_drawing(Path("heart.csv"))) > 60


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("missing.svg",), "cannot be read"),
        (("heart.svg", "--out", "heart.svg2"), r"stored as a \.csv"),
        (("heart.svg", "--height", "2", "--width", "1"), "a width or a height"),
    ],
)
def test_what_cannot_be_imported_is_refused(arguments: tuple[str, ...], words: str) -> None:
    result = run(import_drawing, *arguments)
    assert isinstance(result.exception, InvalidInputError)
    with pytest.raises(InvalidInputError, match=words):
        raise result.exception
    assert not list(Path().glob("*.csv"))


@pytest.mark.parametrize("option", [("--height", "nan"), ("--spacing", "0"), ("--width", "-1")])
def test_sizes_that_cannot_be_are_refused(option: tuple[str, str]) -> None:
    assert run(import_drawing, "heart.svg", *option).exit_code == 2


def test_installed_drawings_and_those_of_the_folder_are_listed() -> None:
    Path("notes.csv").write_text("who,when\nme,today\n")
    document = document_of(run(list_drawings, "--json"))
    names = [entry["drawing"] for entry in document["drawings"]]
    assert names == ["clover", "pear", "ribbon", "scrawl", "shell", "heart.svg"]
    for entry in document["drawings"]:
        assert entry["shape"]["length_m"] > 1.0
    said = run(list_drawings)
    assert said.stderr == ""
    assert "heart.svg" in said.stdout


def test_a_drawing_is_shown_as_a_picture() -> None:
    document = document_of(run(show, "clover", "--json"))
    assert document["drawing"] == "clover"
    picture = matplotlib.image.imread("clover.png")
    assert min(picture.shape[:2]) > 500
    assert picture[..., :3].std() > 0.01
    assert "already exists" in str(run(show, "clover").exception)
    assert "ends with .png" in str(run(show, "clover", "--png", "clover.jpg").exception)
    nowhere = run(show, "clover", "--png", "missing/clover.png").exception
    assert "missing/clover.png: cannot be written: No such file" in str(nowhere)
    assert run(show, "heart.svg", "--png", "other.png", "--speed", "0.3").exit_code == 0
    assert Path("other.png").stat().st_size > 10_000


def test_a_robot_s_own_limits_decide_what_it_may_fly() -> None:
    spec = LaggedRobot().spec
    robots = [Description(robot="drone-7", boot_id="b", spec=spec)]
    points = read_drawing(ROOT / "sims" / "drawings" / "clover.csv")
    within = report_of("clover", "clover.csv", points, robots, (0.5, 1.5))
    slow, fast = within.durations
    assert slow.duration_s is not None
    assert slow.duration_s > within.shape.length_m / 0.5
    assert (fast.duration_s, refusals(within)) == (None, (fast.reason,))
    assert "robot drone-7" in str(fast.reason)
    beyond = report_of("clover", "clover.csv", 3 * points, robots)
    assert all(d.duration_s is None for d in beyond.durations)
    assert "outside the workspace" in refusals(beyond)[0]


def test_a_robot_with_one_axis_flies_x_alone_for_as_long_as_the_table_says() -> None:
    spec = LaggedRobot().spec
    rail = spec.model_copy(update={"axes": spec.axes[:1]})
    robots = [Description(robot="rail", boot_id="b", spec=rail)]
    points = read_drawing(ROOT / "sims" / "drawings" / "clover.csv")
    report = report_of("clover", "clover.csv", points, robots, (0.5,))
    assert report.remarks == ("only the drawing's x is flown by rail: one axis",)
    words, path, sample_time_s = travelled(points, 0.5, robots)
    assert words == " by rail"
    assert np.ptp(path, axis=0) == pytest.approx([np.ptp(points[:, 0]), 0.0], rel=0.05)
    assert len(path) * sample_time_s == report.durations[0].duration_s


def test_every_drawing_command_is_registered() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    commands = project["entry-points"]["nufleet.commands"]
    registered = {name: value for name, value in commands.items() if name.startswith("drawing.")}
    assert set(registered) == {"drawing.draw", "drawing.import", "drawing.list", "drawing.show"}
    for name, value in registered.items():
        command = EntryPoint(name, value, "nufleet.commands").load()
        assert isinstance(command, click.Command)
        assert CliRunner().invoke(command, ["--help"]).exit_code == 0
