"""Responses of runs as files: read back to the same numbers, from folders and repositories."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from archived_studies import archive, begin, measure
from run_records import NOON, a_record, a_test

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.recipe import make_study
from nufleet.orchestrator.conduct.replay import round_of
from nufleet.orchestrator.gap.measured_response import MeasuredResponse, combined
from nufleet.orchestrator.gap.model_files import ModelFileError, read_model
from nufleet.orchestrator.gap.report import gap_report
from nufleet.orchestrator.history.export import export_responses, run_responses
from nufleet.orchestrator.repository.repository import Repository
from nufleet.orchestrator.runs.folder import RunFolder
from nufleet.orchestrator.runs.response_record import ResponseRecord
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

__all__ = ["archive"]


def never_opened() -> Repository:
    raise AssertionError("the folder has all of it")


def measured_of(robot: str) -> list[FrequencyResponse]:
    """Two tests of a robot at different frequencies, and a third at the second frequency."""
    first = a_test(robot).response
    second = replace(first, omega_rad_s=2 * first.omega_rad_s, z=0.5 * first.z)
    return [first, second, replace(second, z=0.6 * first.z)]


@pytest.mark.parametrize("suffix", ["json", "csv"])
def test_what_is_exported_reads_back_as_the_tests_found_it(tmp_path: Path, suffix: str) -> None:
    responses = {robot: measured_of(robot) for robot in ("target", "source-1")}
    with RunFolder(tmp_path, "lab", now=NOON) as folder:
        kept = {r: tuple(map(ResponseRecord.of, tests)) for r, tests in responses.items()}
        folder.write_record(a_record(folder.path).model_copy(update={"responses": kept}))
    found = run_responses(folder.path, never_opened)
    written = export_responses(found, tmp_path / "out", suffix)
    assert set(written) == set(responses)
    for robot, path in written.items():
        model = read_model(path)
        expected = combined(responses[robot])
        assert isinstance(model, MeasuredResponse)
        assert model.omega_rad_s.tolist() == expected.omega_rad_s.tolist()
        assert model.z.tobytes() == expected.z.tobytes()
        # Equally good measurements of one frequency are averaged.
        np.testing.assert_allclose(model.z[1], 1.1 * model.z[0] / 2)
    report = gap_report(written["target"], written["source-1"], None, None)
    assert report.chordal_max_in_band == 0.0


def test_each_axis_of_a_ranking_of_several_has_a_file_of_its_own(tmp_path: Path) -> None:
    along_x, along_y, _ = measured_of("target")
    along = {"x": [along_x, along_y], "y": [along_y, replace(along_x, z=2 * along_x.z)]}
    tests = [replace(test, axis=axis) for axis, own in along.items() for test in own]
    records = [ResponseRecord.of(test).response() for test in tests]
    written = export_responses({"target": records}, tmp_path, "json")
    assert {name: path.name for name, path in written.items()} == {
        "target-x": "target-x.json",
        "target-y": "target-y.json",
    }
    model = read_model(written["target-y"])
    assert isinstance(model, MeasuredResponse)
    assert model.z.tobytes() == combined(along["y"]).z.tobytes()


def test_an_interrupted_run_is_exported_from_the_repository(
    archive: Archive, tmp_path: Path
) -> None:
    study = begin(archive, "adaptive")
    question = make_study(study, archive.repository.studies).ask()
    assert question is not None
    measured = {
        test.robot: measure(archive, test)
        for test in round_of(study.study_id, question).tests
        if test.robot != "far"
    }
    folder = tmp_path / "RUN-ADAPTIVE"
    folder.mkdir()

    @contextmanager
    def opened() -> Iterator[Repository]:
        yield archive.repository

    found = run_responses(folder, opened)
    assert set(found) == {"target", "near"}
    for robot, (response,) in found.items():
        assert response.z.tobytes() == measured[robot].z.tobytes()
    written = export_responses(found, folder / "responses", "csv")
    assert {path.name for path in written.values()} == {"target.csv", "near.csv"}
    with pytest.raises(InvalidInputError, match="holds no responses"):
        run_responses(tmp_path / "another", opened)


def test_a_robot_that_was_tested_at_one_frequency_is_no_response_over_a_band(
    tmp_path: Path,
) -> None:
    with pytest.raises(ModelFileError, match=r"alone\.json.*at least 2"):
        export_responses({"alone": [a_test("alone").response]}, tmp_path, "json")


def test_a_folder_that_cannot_be_made_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InvalidInputError, match="file"):
        export_responses({"a": measured_of("a")}, tmp_path / "file", "json")
