"""The tables of several evaluations, as they are written into the documents."""

from __future__ import annotations

import pytest
from evaluated_flights import FIRST, LATER, summed

from benchmarks.evaluation_curves import document, summary, with_part
from nufleet.orchestrator.evaluation.report import ways_table
from nufleet.orchestrator.evaluation.results import EvaluationRecord

RECORD = EvaluationRecord(
    result=summed([*FIRST, *LATER]), studies=(), flights=(*FIRST, *LATER), wall_time_s=1.0
)


def test_a_fleet_has_one_row_with_what_every_way_left() -> None:
    header, _, row = summary([("lab", RECORD)])
    cells = dict(zip(header.split(" | "), row.split(" | "), strict=True))
    assert cells["baseline"] == "300"
    assert (cells["best source"], cells["worst source"]) == ("60", "200")
    assert (cells["own after its tests"], cells["own after 15 s"]) == ("40", "20")
    assert cells["chosen at first |"] == "near |"


def test_every_way_has_a_row_with_its_error_and_what_was_expected() -> None:
    tables = document([("lab", RECORD)])
    assert "### lab, 2 paths" in tables
    assert "| near | 0 | 60 | 80.0 % | 60 (40 to 80) | 0 |" in tables
    assert "- after its tests the predictions choose near; regret 20 mm" in tables


def test_a_way_that_the_target_refused_was_not_flown() -> None:
    refused = [f.model_copy(update={"rms_m": None, "flown": False}) for f in LATER]
    result = summed([*FIRST, *refused])
    record = RECORD.model_copy(update={"result": result})
    assert "| own | 15 | 2 not flown |" in document([("lab", record)])
    assert "| 40 | 2 not flown | near |" in summary([("lab", record)])[-1]
    assert list(ways_table(result).columns[3].cells)[-1] == "2 not flown"


def test_a_part_of_a_document_is_replaced_between_its_marks() -> None:
    text = "before\n<!-- summary -->\nold\n<!-- end of summary -->\nafter\n"
    replaced = with_part(text, "summary", "new")
    assert replaced == "before\n<!-- summary -->\n\nnew\n\n<!-- end of summary -->\nafter\n"
    assert with_part(replaced, "summary", "new") == replaced
    with pytest.raises(ValueError, match="end of tables"):
        with_part(text, "tables", "new")
