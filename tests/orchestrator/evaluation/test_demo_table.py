"""What the demo's table and its last sentence say, and that its document holds those of others."""

from __future__ import annotations

import io
import json
from typing import Any

from rich.console import Console

from nufleet.orchestrator.evaluation.demo_table import demo_parts, takeaway
from nufleet.orchestrator.evaluation.flight_documents import DemoResult
from nufleet.orchestrator.evaluation.results import (
    BaselineResult,
    EvaluationResult,
    FlightRecord,
    InverseResult,
    SourceResult,
)
from nufleet.orchestrator.runs.rank_result import RankResult
from nufleet.orchestrator.study.interface import SourceEstimate

REASON = "after 0.90 s its error until then was 1.54 times the error of the baseline"

RANKING = RankResult(
    target="target",
    band_rad_s=(0.05, 10.0),
    selected="near",
    ranking=(
        SourceEstimate(
            robot="near", psi=0.02, psi_low=0.018, psi_high=0.022, omega_rad_s=4.0, tests=7
        ),
        SourceEstimate(
            robot="far", psi=0.39, psi_low=0.388, psi_high=0.392, omega_rad_s=2.5, tests=7
        ),
    ),
    iterations=7,
    robot_time_s=100.0,
    run="runs/1",
)


def source(robot: str, psi: float, rms_m: float | None, predicted_rms_m: float) -> SourceResult:
    return SourceResult(
        robot=robot,
        psi=psi,
        psi_std=0.001,
        rms_m=rms_m,
        reduction_percent=None,
        predicted_rms_m=predicted_rms_m,
    )


def flight(inverse: str, rms_m: float | None, **changes: Any) -> FlightRecord:
    return FlightRecord(
        target="target",
        inverse=inverse,
        drawing="clover",
        speed_m_s=0.6,
        rms_m=rms_m,
        failure=None,
        deadline_misses=0,
        **{"taken_back": None} | changes,
    )


def demo(
    *,
    near: float | None = 0.007,
    far: float = 0.037,
    none: float = 0.08,
    own: float | None = 0.001,
    harm: float | None = 0.154,
) -> DemoResult:
    """A demonstration whose guard took `far` back, if there is a flight without the guard."""
    flights = EvaluationResult(
        target="target",
        architecture="preview",
        unit="m",
        guarded=True,
        baseline=BaselineResult(rms_m=0.1, predicted_rms_m=0.11),
        no_prior=InverseResult(rms_m=none, reduction_percent=None),
        own=InverseResult(rms_m=own, reduction_percent=None),
        sources=(source("near", 0.02, near, 0.008), source("far", 0.39, far, 0.185)),
        selected="near",
        kendall_tau=1.0,
        run="runs/1",
    )
    predicted = {"predicted_rms_m": 0.002, "predicted_low_m": 0.001, "predicted_high_m": 0.003}
    return DemoResult(
        ranking=RANKING,
        flights=flights,
        flown=(
            flight("own", own, own_flight_s=20.0, **predicted),
            flight("baseline", 0.1),
            flight("none", none),
            flight("near", near),
            flight("far", far, taken_back=None if harm is None else REASON),
        ),
        unguarded=None if harm is None else flight("far-unguarded", harm),
        run="runs/1",
    )


def printed(result: DemoResult) -> str:
    said = io.StringIO()
    console = Console(file=said, width=120)
    for part in demo_parts(result):
        console.print(part)
    return said.getvalue()


def rows(result: DemoResult) -> dict[str, list[str]]:
    """The cells of every row, by the row's name."""
    lines = (line.strip("│").split("│") for line in printed(result).splitlines() if "│" in line)
    return {cells[0].strip(): [cell.strip() for cell in cells[1:]] for cells in lines}


def test_its_document_holds_those_of_rank_and_evaluate_and_every_flight() -> None:
    result = demo()
    document = json.loads(result.document())
    assert list(document) == ["schema", "ranking", "flights", "flown", "unguarded", "run"]
    assert document["ranking"] == json.loads(RANKING.document())
    assert document["flights"] == json.loads(result.flights.document())
    assert document["flown"][4]["taken_back"] == REASON
    assert document["unguarded"]["rms_m"] == 0.154


def test_each_row_says_what_was_predicted_what_was_flown_and_what_the_guard_did() -> None:
    table = rows(demo())
    assert list(table) == [
        *("near (closest)", "far (furthest)", "far, unguarded"),
        *("none, but learning", "model of itself", "baseline alone"),
    ]
    assert table["near (closest)"] == ["0.0200", "8.0", "7.0", "93.0 %", ""]
    assert table["far (furthest)"] == ["0.3900", "185.0", "37.0", "63.0 %", "withdrew"]
    assert table["far, unguarded"] == ["0.3900", "185.0", "154.0", "-54.0 %", "off"]
    assert f"the guard took far back: {REASON}" in printed(demo())


def test_what_the_target_itself_expected_of_a_flight_comes_before_what_the_tests_predict() -> None:
    assert rows(demo())["model of itself"][1] == "2.0 (1.0–3.0)"
    assert rows(demo())["baseline alone"][1] == "110.0"


def test_a_flight_that_was_not_finished_is_shown_and_not_compared() -> None:
    result = demo(near=None)
    assert rows(result)["near (closest)"][2:4] == ["not finished", ""]
    assert takeaway(result) == ("Not every flight was finished, so the ways cannot be compared.")


def test_a_flight_that_the_target_refused_was_not_flown() -> None:
    refused = flight("own", None, flown=False)
    result = demo(own=None)
    result = result.model_copy(update={"flown": (refused, *result.flown[1:])})
    assert rows(result)["model of itself"][2:4] == ["not flown", ""]


def test_a_source_that_would_have_harmed_is_the_lesson() -> None:
    assert takeaway(demo()) == (
        "Choose before you transfer: near, which the tests chose, left 7 % of the baseline's "
        "error; far would have left 154 %, had the guard not intervened. Learning in flight "
        "without experience left 80 %. The least, 1.0 mm, was left by target's model of itself, "
        "which took 20 s of target's own motion in these tests."
    )


def test_where_no_source_harms_the_lesson_is_another_one() -> None:
    apart = takeaway(demo(harm=None))
    assert apart.startswith("near, which the tests chose, left 7 % of the baseline's error; far")
    alike = takeaway(demo(harm=None, far=0.0075, own=0.0068, none=0.005))
    assert alike.startswith("Here the choice matters little: near")
    assert "No experience at all left less, 5 %." in alike
    assert "The least, 5.0 mm, was left by no experience." in alike


def test_where_the_chosen_source_does_best_no_other_way_is_praised() -> None:
    assert "The least" not in takeaway(demo(own=0.0069))


def test_a_result_of_an_earlier_version_is_still_shown() -> None:
    document = json.loads(demo().model_dump_json(by_alias=True))
    del document["flown"], document["unguarded"]
    table = rows(DemoResult.model_validate_json(json.dumps(document)))
    assert table["far (furthest)"] == ["0.3900", "185.0", "37.0", "63.0 %", ""]
