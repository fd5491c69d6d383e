"""Flights along paths, as pilots return them."""

from __future__ import annotations

import numpy as np

from nufleet.orchestrator.flights.pilot import PathFlight
from nufleet.shared.arrays import FloatArray
from nufleet.shared.wire.motions import TakenBack, TrackingDetails

STEP_S = 0.02


def flight(
    desired: FloatArray,
    actual: FloatArray,
    *,
    robot: str = "target",
    label: str = "source-1 · clover · 0.6 m/s",
    failure: str | None = None,
    taken_back: TakenBack | None = None,
) -> PathFlight:
    """A flight of shape (samples, axes) whose signals can be told apart."""
    samples = len(desired)
    return PathFlight(
        robot=robot,
        label=label,
        sample_time_s=STEP_S,
        reference=desired + 0.01,
        actual=actual,
        details=TrackingDetails(
            desired=desired,
            prior=desired + 1.0,
            mean=desired + 2.0,
            variance=np.abs(desired) + 3.0,
            share=np.linspace(1.0, 0.0, samples),
            limited=np.zeros(samples),
            step_time_s=np.full(samples, 1e-3),
            dropped_pairs=0,
            taken_back=taken_back,
        ),
        failure=failure,
    )


def line(samples: int, axes: int) -> FloatArray:
    """A path whose every number differs."""
    return np.arange(samples * axes, dtype=np.float64).reshape(samples, axes) / 100
