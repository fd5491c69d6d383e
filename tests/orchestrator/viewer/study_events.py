"""Events of a small, smooth, made-up study."""

from __future__ import annotations

import numpy as np

from nufleet.orchestrator.study.interface import Curve, SourceEstimate
from nufleet.orchestrator.viewer.events import IterationEvent, RobotStateEvent, TestSamplesEvent
from nufleet.shared.frequency_test.excitation import Tone

SAMPLE_TIME_S = 0.015


def samples_event(robot: str, *, t_s: float = 0.0, samples: int = 400) -> TestSamplesEvent:
    time_s = np.arange(samples) * SAMPLE_TIME_S
    return TestSamplesEvent(
        t_s=t_s,
        robot=robot,
        axis="x",
        unit="m",
        target="target",
        robots=("target", robot),
        tones=(Tone(omega_rad_s=2.0),),
        sample_time_s=SAMPLE_TIME_S,
        reference=np.sin(2.0 * time_s),
        response=0.8 * np.sin(2.0 * time_s - 0.3),
    )


def state_event(robot: str, t_s: float, status: str = "running") -> RobotStateEvent:
    return RobotStateEvent(t_s, robot, False, status, "g1", 0.5, "")  # type: ignore[arg-type]


def iteration_event(
    iteration: int = 1, *, t_s: float = 10.0, sources: tuple[str, ...] = ("s1", "s2", "s3")
) -> IterationEvent:
    grid = np.geomspace(0.1, 10.0, 50)
    peak = {source: 0.02 * (n + 1) for n, source in enumerate(sources)}
    responses = {source: {2.0: complex(0.7 + peak[source], -0.2)} for source in sources}
    return IterationEvent(
        t_s=t_s,
        iteration=iteration,
        omega_rad_s=(2.0,),
        responses={"target": {2.0: 0.7 - 0.2j}, **responses},
        target="target",
        curves=tuple(
            Curve(
                source,
                grid,
                peak[source] * np.exp(-(np.log(grid / 4.0) ** 2)),
                np.zeros_like(grid),
                1.3 * peak[source] * np.ones_like(grid),
                np.array([2.0]),
                np.array([peak[source]]),
            )
            for source in sources
        ),
        ranking=tuple(
            SourceEstimate(
                source, peak[source], 0.8 * peak[source], 1.3 * peak[source], 4.0, iteration
            )
            for source in sources
        ),
        messages=("s4 was dropped",),
    )
