"""`nufleet gap` as its user sees it: one document or a table, and clear refusals."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from nufleet.orchestrator.cli.gap import gap
from nufleet.shared.errors import NufleetError

LAG = {"num": [50], "den": [1, 50]}
TWO_LAGS = {"num": [400], "den": [1, 58, 400]}
INTEGRATOR = {"num": [1], "den": [1, 0]}
GAIN = {"num": [1], "den": [1]}
MEASURED = {"omega_rad_s": [1.0, 2.0, 4.0], "real": [1.0, 0.8, 0.5], "imag": [-0.1, -0.2, -0.4]}


def run(tmp_path: Path, *documents: dict[str, Any], options: tuple[str, ...] = ()) -> Result:
    paths = []
    for index, document in enumerate(documents):
        paths.append(tmp_path / f"model{index}.json")
        paths[-1].write_text(json.dumps(document))
    return CliRunner().invoke(gap, [*map(str, paths), *options])


def document_of(result: Result) -> dict[str, Any]:
    assert result.exit_code == 0, result.exception
    document = json.loads(result.stdout)
    assert isinstance(document, dict)
    return document


def test_the_document_says_how_far_where_and_why(tmp_path: Path) -> None:
    document = document_of(run(tmp_path, LAG, TWO_LAGS, options=("--json",)))
    assert document["schema"] == 1
    assert document["nu_gap"] == pytest.approx(0.6147, abs=5e-5)
    assert document["chordal_peak"] == document["nu_gap"]
    assert document["omega_peak_rad_s"] == pytest.approx(28.18, abs=0.01)
    assert document["winding_condition"]["holds"] is True
    assert document["winding_condition"]["winding_number"] == 0
    assert document["chordal_max_in_band"] is None
    assert document["controller"] is None
    assert "margin above 0.6148" in document["guarantee"]


def test_a_failed_winding_condition_is_told_with_its_terms(tmp_path: Path) -> None:
    document = document_of(
        run(
            tmp_path,
            {"num": [1], "den": [1, 10]},
            {"num": [1], "den": [1, -10]},
            options=("--json",),
        )
    )
    assert document["nu_gap"] == 1.0
    assert document["chordal_peak"] == pytest.approx(0.2 / 1.01)
    assert document["winding_condition"]["holds"] is False
    assert document["winding_condition"]["poles_unstable"] == [0, 1]


def test_a_peak_at_infinity_is_null(tmp_path: Path) -> None:
    lead = {"num": [1, 1], "den": [1, 1]}
    document = document_of(run(tmp_path, {"num": [1], "den": [1, 1]}, lead, options=("--json",)))
    assert document["omega_peak_rad_s"] is None


def test_a_band_adds_the_largest_distance_in_it(tmp_path: Path) -> None:
    options = ("--json", "--band", "1", "10")
    document = document_of(run(tmp_path, LAG, TWO_LAGS, options=options))
    assert document["chordal_max_in_band"] == pytest.approx(0.4662, abs=5e-5)
    assert document["chordal_max_in_band"] < document["nu_gap"]
    assert document["band"]["omega_max_rad_s"] == pytest.approx(10.0)
    assert document["band"]["band_rad_s"] == [1.0, 10.0]


def test_a_controller_gets_its_margins_and_the_promise(tmp_path: Path) -> None:
    (tmp_path / "controller.json").write_text(json.dumps(GAIN))
    options = ("--json", "--controller", str(tmp_path / "controller.json"))
    document = document_of(
        run(tmp_path, INTEGRATOR, {"num": [1.2], "den": [1, 0]}, options=options)
    )
    controller = document["controller"]
    assert controller["margin_first"] == pytest.approx(0.5**0.5)
    assert controller["guaranteed"] is True
    assert controller["margin_second"] >= controller["margin_second_at_least"] > 0.6


def test_measured_responses_have_a_band_limited_distance_and_no_gap(tmp_path: Path) -> None:
    document = document_of(run(tmp_path, LAG, MEASURED, options=("--json", "--band", "0.5", "3")))
    assert document["nu_gap"] is None
    assert document["winding_condition"] is None
    assert document["band"]["band_rad_s"] == [1.0, 3.0]
    assert document["band"]["band_asked_rad_s"] == [0.5, 3.0]
    assert 0 < document["chordal_max_in_band"] < 1


def test_people_get_a_table_on_stdout_and_nothing_else(tmp_path: Path) -> None:
    (tmp_path / "controller.json").write_text(json.dumps(GAIN))
    options = ("--band", "1", "10", "--controller", str(tmp_path / "controller.json"))
    result = run(tmp_path, LAG, TWO_LAGS, options=options)
    assert result.exit_code == 0
    assert result.stderr == ""
    for text in (
        "ν-gap",
        "0.614737",
        "28.181 rad/s",
        "0.466203",
        "0.707107",
        "0.656695",
        "0.123033",
    ):
        assert text in result.stdout


def test_the_table_says_that_a_measurement_gives_no_gap(tmp_path: Path) -> None:
    result = run(tmp_path, LAG, MEASURED, options=("--band", "0.5", "3"))
    assert "unknown" in result.stdout
    assert "not the whole band" in result.stdout
    assert "lower bound" in result.stdout


@pytest.mark.parametrize(
    ("documents", "options", "message"),
    [
        ((LAG, {"num": [1], "den": [1, 0.5], "dt": 0.1}), (), "differ in sample time"),
        ((LAG, {"num": [[[1], [1]]], "den": [[[1], [1]]]}), (), "1 × 1 and 1 × 2"),
        ((LAG, {"num": [1, -1], "den": [1, 0, -1]}), (), "second model has a hidden unstable mode"),
        ((LAG, LAG), ("--band", "3", "1"), "a band needs"),
        ((LAG, LAG), ("--band", "1", "inf"), "a band needs"),
        ((LAG, MEASURED), ("--band", "5", "6"), "do not overlap"),
        ((LAG, MEASURED), ("--controller", "c.json"), "a measured response has no ν-gap"),
        ((LAG, LAG), ("--controller", "missing.json"), "No such file"),
    ],
)
def test_what_cannot_be_compared_is_refused_as_wrong_usage(
    tmp_path: Path, documents: tuple[dict[str, Any], ...], options: tuple[str, ...], message: str
) -> None:
    result = run(tmp_path, *documents, options=options)
    assert isinstance(result.exception, NufleetError)
    assert result.exception.exit_code == 2
    assert message in str(result.exception)
    assert result.stdout == ""


def test_a_measured_controller_is_refused(tmp_path: Path) -> None:
    (tmp_path / "c.json").write_text(json.dumps(MEASURED))
    result = run(tmp_path, LAG, LAG, options=("--controller", str(tmp_path / "c.json")))
    assert "a controller must be a model" in str(result.exception)


def test_a_missing_argument_is_wrong_usage(tmp_path: Path) -> None:
    assert run(tmp_path, LAG).exit_code == 2


def test_help_needs_nothing_but_click() -> None:
    code = (
        "import sys; import nufleet.orchestrator.cli.gap;"
        "assert not {'numpy', 'scipy', 'rich', 'pydantic'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)
