"""A whole evaluation over the network: every way, more own flying, the document and the records."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from fleet_lab import Lab, double_integrator
from learned_things import experience, layout
from rich.console import Console

from nufleet.orchestrator.evaluation.kept_records import RECORDS
from nufleet.orchestrator.evaluation.results import (
    EVALUATION,
    EvaluationRecord,
    EvaluationResult,
    FlightRecord,
)
from nufleet.orchestrator.experience.prior_custody import install
from nufleet.orchestrator.jobs.evaluate import EvaluateCommand, evaluate

ALPHA = {"target": 0.85, "source": 0.97}


def command(lab: Lab, runs_root: Path, own_flight_s: tuple[float, ...]) -> EvaluateCommand:
    return EvaluateCommand(
        fleet_file=None,
        connect=lab.endpoint,
        fleet_name=None,
        target="target",
        sources=None,
        architecture="preview",
        drawings=("clover",),
        speeds=(0.4,),
        scale=0.15,
        own_flight_s=own_flight_s,
        studies=1,
        iterations=2,
        quick=True,
        all_pairs=False,
        guarded=True,
        seed=0,
        live=False,
        runs_root=runs_root,
        repository=None,
        as_json=False,
    )


@pytest.fixture
def fleet_with_experiences(lab: Lab) -> Lab:
    for seed, (name, alpha) in enumerate(ALPHA.items()):
        lab.agent(name, double_integrator(alpha, seed))
    # This orchestrator owns nothing, so that the evaluation may.
    fleet = lab.orchestrator("giver", *ALPHA).fleet
    given = experience("source", layout=layout(horizon_samples=20))
    install(fleet, "source", "experience", given)
    return lab


def test_an_evaluation_compares_all_ways_and_keeps_every_flight(
    fleet_with_experiences: Lab, tmp_path: Path
) -> None:
    console = Console(record=True, width=200, file=io.StringIO())
    result = evaluate(command(fleet_with_experiences, tmp_path, (5.0,)), console)
    assert isinstance(result, EvaluationResult)
    ways = [(way.way, round(way.own_flight_s)) for way in result.ways]
    first = ("own", "baseline", "none", "source", "mixture")
    assert ways == [*((way, 0) for way in first), ("own", 5)]
    assert all(way.predicted_rms_m is not None for way in result.ways)
    assert result.chosen_way in first
    assert [round(point.own_flight_s) for point in result.points] == [0, 5]
    run = Path(result.run)
    record = EvaluationRecord.model_validate_json((run / EVALUATION).read_text())
    lines = (run / RECORDS).read_text().splitlines()
    assert tuple(map(FlightRecord.model_validate_json, lines)) == record.flights
    assert (run / "plots" / "curve.png").exists()
    said = console.export_text()
    assert "own after 5 s of its own flying: flights 6 to 6 of 6, about" in said
    assert "rehearses clover · 0.4 m/s: 1 of 1" in said
    assert "which way to fly" in said
