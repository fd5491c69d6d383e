"""A ranking over two axes: robots play them together, and what they say is stored and replayed."""

from __future__ import annotations

from pathlib import Path

import pyarrow.parquet as pq
import pytest
from page_story import Story

from nufleet.orchestrator.conduct.recipe import make_study
from nufleet.orchestrator.conduct.replay import resume
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.runs.rank_result import RunRecord

ON_A_PAGE = "nufleet rank --fleet off_centre"


def test_two_axes_are_ranked_by_the_worse_one_and_the_stored_tests_say_the_same_again(
    tmp_path: Path,
) -> None:
    options = ("--sources", "source-1,source-2", "--no-recording", "--no-rehearsal")
    with Story(tmp_path) as story:
        story.nufleet(*ON_A_PAGE.split()[1:], *options)
    (results,) = tmp_path.glob("runs/*/results.json")
    record = RunRecord.model_validate_json(results.read_text())
    assert record.result.selected == "source-2"
    assert record.axis == "x y"
    assert record.result.confidence is not None
    assert record.result.confidence >= 0.95
    worst = {estimate.robot: estimate.axis for estimate in record.result.ranking}
    assert worst["source-1"] == "y"
    assert any(
        finding.startswith("target: y answers to x with") for finding in record.result.findings
    )
    samples = pq.read_table(results.with_name("telemetry.parquet"))
    assert set(samples["axis"].to_pylist()) == {"x", "y"}
    with Storage(tmp_path / "runs").open() as repository:
        (stored,) = repository.studies.studies()
        study = make_study(stored, repository.studies)
        again = resume(stored.study_id, study, repository.studies.trials(stored.study_id))
    assert again.open is None
    assert again.told[-1].report.ranking == record.result.ranking
    assert again.robot_time_s == pytest.approx(record.result.robot_time_s)
