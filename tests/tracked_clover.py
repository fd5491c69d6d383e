"""`nufleet track` of a small clover by the target of a lab."""

from __future__ import annotations

from pathlib import Path

from fleet_lab import Lab
from rich.console import Console

from nufleet.orchestrator.evaluation.flight_documents import TrackResult
from nufleet.orchestrator.jobs.track import InverseChoice, TrackCommand, track


def tracked(lab: Lab, runs_root: Path, inverse: InverseChoice = "auto") -> TrackResult:
    """Fly the clover with an inverse, guarded and learning; return what the command leaves."""
    command = TrackCommand(
        connect=lab.endpoint,
        fleet_name=None,
        target="target",
        drawings=("clover",),
        speed=0.4,
        scale=0.5,
        inverse=inverse,
        horizon_s=0.4,
        learn=True,
        guarded=True,
        rich_flight_s=None,
        live=False,
        runs_root=runs_root,
        repository=None,
        as_json=False,
    )
    return track(command, Console(quiet=True))
