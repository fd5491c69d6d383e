"""A whole evaluation over the network: every way, more own flying, the document and the records."""

from __future__ import annotations

import io
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from command_processes import PATIENCE_S
from fleet_lab import Lab
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
from nufleet.orchestrator.history.catalogue import read_run
from nufleet.orchestrator.jobs.evaluate import EvaluateCommand, evaluate
from nufleet.orchestrator.jobs.resume import ResumeCommand, resume
from nufleet.shared.errors import InvalidInputError
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings

ALPHA = {"target": 0.85, "source": 0.97}
KILLED = """
import os, signal, sys
from nufleet.orchestrator.evaluation.kept_records import KeptRecords
from nufleet.shared.command_line import main

flown = KeptRecords.flown

def killed(kept, record):
    flown(kept, record)
    if kept.done == 3:
        os.kill(os.getpid(), signal.SIGKILL)

KeptRecords.flown = killed
main()
"""


def options(lab: Lab, runs_root: Path) -> tuple[str, ...]:
    return (
        *("evaluate", "--connect", lab.endpoint, "--target", "target", "--runs", str(runs_root)),
        *("--architecture", "preview", "--drawings", "clover", "--speeds", "0.4"),
        *("--scale", "0.08", "--own-flight", "5", "--studies", "1", "--iterations", "2", "--quick"),
    )


def command(lab: Lab, runs_root: Path) -> EvaluateCommand:
    return EvaluateCommand(
        fleet_file=None,
        connect=lab.endpoint,
        fleet_name=None,
        target="target",
        sources=None,
        architecture="preview",
        drawings=("clover",),
        speeds=(0.4,),
        scale=0.08,
        own_flight_s=(5.0,),
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
    for name, alpha in ALPHA.items():
        settings = DoubleIntegratorSettings(alpha=alpha, beta=0.003)
        lab.agent(name, DoubleIntegrator(settings, np.random.default_rng(0)))
    # This orchestrator owns nothing, so that the evaluation may.
    fleet = lab.orchestrator("giver", *ALPHA).fleet
    given = experience("source", layout=layout(horizon_samples=20))
    install(fleet, "source", "experience", given)
    return lab


def flights_in(run: Path) -> tuple[FlightRecord, ...]:
    lines = (run / RECORDS).read_text().splitlines()
    return tuple(map(FlightRecord.model_validate_json, lines))


def table(record: EvaluationRecord) -> dict[str, float | None]:
    """All results of a record, with ratios to the baseline's error times that error, in m."""
    (baseline_m,) = [way.rms_m for way in record.result.ways if way.way == "baseline"]
    assert baseline_m is not None
    times_m = {"worst_ratio": baseline_m, "reduction_percent": baseline_m / 100}
    return {
        f"{way.way} after {way.own_flight_s:.0f} s: {field}": (
            None if value is None else times_m.get(field, 1.0) * value
        )
        for way in record.result.ways
        for field, value in way.model_dump(exclude={"way", "own_flight_s"}).items()
    }


def test_an_evaluation_compares_all_ways_and_goes_on_where_it_was_killed(
    fleet_with_experiences: Lab, tmp_path: Path
) -> None:
    lab = fleet_with_experiences
    console = Console(record=True, width=200, file=io.StringIO())
    result = evaluate(command(lab, tmp_path / "undisturbed"), console)
    assert isinstance(result, EvaluationResult)
    ways = [(way.way, round(way.own_flight_s)) for way in result.ways]
    first = ("own", "baseline", "none", "source", "mixture")
    assert ways == [*((way, 0) for way in first), ("own", 5)]
    assert all(way.predicted_rms_m is not None for way in result.ways)
    assert result.chosen_way in first
    assert [round(point.own_flight_s) for point in result.points] == [0, 5]
    run = Path(result.run)
    undisturbed = EvaluationRecord.model_validate_json((run / EVALUATION).read_text())
    assert flights_in(run) == undisturbed.flights
    assert (run / "plots" / "curve.png").exists()
    said = console.export_text()
    assert "clover · 0.4 m/s: flights 1 to 5 of 6" in said
    assert "clover · 0.4 m/s after 5 s of its own flying: flight 6 of 6, about" in said
    assert "which way to fly" in said

    # The robots are as they were before.
    lab.orchestrator("forgetter", *ALPHA).fleet.forget_own_model("target")
    runs_root = tmp_path / "killed"
    done = subprocess.run(
        [sys.executable, "-c", KILLED, *options(lab, runs_root)],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )
    assert done.returncode == -signal.SIGKILL, done.stderr
    (run,) = [path for path in runs_root.iterdir() if path.is_dir()]
    before = flights_in(run)
    assert len(before) == 3
    assert read_run(run).result is None
    resume(ResumeCommand(runs_root=runs_root), console)
    record = EvaluationRecord.model_validate_json((run / EVALUATION).read_text())
    assert record.complete
    assert record.flights[:3] == before
    assert flights_in(run) == record.flights
    # What a robot knows of itself was added up in another order, which moves its flights, and what
    # is foretold of them, by a few tenths of a nanometre.
    assert table(record) == pytest.approx(table(undisturbed), rel=1e-6, abs=1e-9)
    with pytest.raises(InvalidInputError, match="is complete"):
        resume(ResumeCommand(runs_root=runs_root, run=run.name), console)
