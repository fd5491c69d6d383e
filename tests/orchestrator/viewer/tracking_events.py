"""Invented flights along a circle: with any prior, the robot is a little late."""

from __future__ import annotations

import numpy as np

from nufleet.orchestrator.viewer.events import TrackingSamplesEvent
from nufleet.shared.arrays import FloatArray

SAMPLE_TIME_S = 0.02
SAMPLES = 500


def flight(
    prior: str = "s1",
    *,
    path: str = "circle · 0.6 m/s",
    t_s: float = 0.0,
    late_s: float = 0.1,
    axes: tuple[str, ...] = ("x", "y"),
    unit: str = "m",
    robot: str = "target",
    samples: int = SAMPLES,
    share: FloatArray | None = None,
) -> TrackingSamplesEvent:
    time_s = np.arange(samples) * SAMPLE_TIME_S
    phases = 2 * np.pi * (np.arange(len(axes)) / 4 + time_s[:, np.newaxis] / 10)
    desired = np.cos(phases)
    learns = prior != "baseline"
    return TrackingSamplesEvent(
        t_s=t_s,
        robot=robot,
        flight=f"{prior} · {path}",
        axes=axes,
        unit=unit,
        sample_time_s=SAMPLE_TIME_S,
        desired=desired,
        actual=np.cos(phases - 2 * np.pi * late_s / 10),
        prior=0.3 * np.sin(phases) * learns,
        mean=0.1 * np.sin(2 * phases) * learns,
        variance=0.0025 * np.ones_like(desired) * learns,
        share=np.ones(samples) if share is None else share,
    )


def parts(event: TrackingSamplesEvent, samples: int) -> list[TrackingSamplesEvent]:
    """Cut a flight as telemetry does."""
    rows = ("desired", "actual", "prior", "mean", "variance", "share")
    return [
        TrackingSamplesEvent(
            **{
                **vars(event),
                "t_s": event.t_s + first * event.sample_time_s,
                **{row: getattr(event, row)[first : first + samples] for row in rows},
            }
        )
        for first in range(0, len(event.actual), samples)
    ]
