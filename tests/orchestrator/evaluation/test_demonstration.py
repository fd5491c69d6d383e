"""The demo's document holds those of a ranking and of an evaluation, as programs know them."""

from __future__ import annotations

import json

from rich.console import Console

from nufleet.orchestrator.evaluation.demonstration import demo_table
from nufleet.orchestrator.evaluation.flight_documents import DemoResult
from nufleet.orchestrator.evaluation.results import (
    BaselineResult,
    EvaluationResult,
    InverseResult,
    SourceResult,
)
from nufleet.orchestrator.runs.rank_result import RankResult
from nufleet.orchestrator.study.interface import SourceEstimate

RANKING = RankResult(
    target="target",
    band_rad_s=(0.05, 10.0),
    selected="near",
    ranking=(
        SourceEstimate(robot="near", psi=0.02, psi_std=0.001, omega_rad_s=4.0, tests=7),
        SourceEstimate(robot="far", psi=0.09, psi_std=0.001, omega_rad_s=4.5, tests=7),
    ),
    iterations=7,
    robot_time_s=100.0,
    run="runs/1",
)
FLIGHTS = EvaluationResult(
    target="target",
    architecture="preview",
    unit="m",
    guarded=True,
    baseline=BaselineResult(rms_m=0.1),
    no_prior=InverseResult(rms_m=0.12, reduction_percent=-20.0, worst_ratio=1.2),
    sources=(
        SourceResult(
            robot="near",
            psi=0.02,
            psi_std=0.001,
            rms_m=0.01,
            reduction_percent=90.0,
            worst_ratio=0.1,
        ),
        SourceResult(robot="far", psi=0.09, psi_std=0.001, rms_m=None, reduction_percent=None),
    ),
    selected="near",
    kendall_tau=1.0,
    run="runs/1",
)
DEMO = DemoResult(ranking=RANKING, flights=FLIGHTS, run="runs/1")


def test_its_parts_are_the_documents_of_rank_and_evaluate() -> None:
    document = json.loads(DEMO.document())
    assert list(document) == ["schema", "ranking", "flights", "run"]
    assert document["ranking"] == json.loads(RANKING.document())
    assert document["flights"] == json.loads(FLIGHTS.document())
    # What was not finished is said, and not left out.
    assert document["flights"]["sources"][1]["rms_m"] is None


def test_the_table_shows_the_flights_in_the_order_that_was_predicted() -> None:
    console = Console(record=True, width=120)
    console.print(demo_table(FLIGHTS))
    lines = console.export_text().splitlines()
    rows = [line for line in lines if "│" in line]
    assert [row.split("│")[1].strip() for row in rows] == [
        *("near (closest)", "far (furthest)", "none: learns in flight"),
        "baseline controller alone",
    ]
    assert "90.0 %" in rows[0]
    assert "not finished" in rows[1]
