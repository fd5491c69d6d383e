"""The horizon of an inverse model, chosen by flying candidates on the robot they are for."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from nufleet.orchestrator.experience.lesson_record import LearningRecord, pooled_pairs
from nufleet.orchestrator.experience.linear_inverse import linear_experience
from nufleet.orchestrator.experience.training import Origin, TrainingData
from nufleet.shared.errors import StudyError
from nufleet.shared.experience.file import Experience
from nufleet.shared.experience.layout import HORIZON_SAMPLES_MAX, Architecture, InverseLayout

CANDIDATES_S = (0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
"""From the delay of a fast robot to the rise time of a slow one."""

FAILURES_MAX = 2
"""After so many horizons in a row that failed, below one that did not, shorter ones are not tried.
Those above it may fail too: a fast robot aims badly when it looks far ahead."""

_CLOSE = 1.05  # errors that differ by less are alike
_FAR = 2.0  # an error this many times the best is a failure too
_GAIN_ERROR = 1.25  # a horizon has to survive an inverse this much too eager

Fly = Callable[[Experience], float]
"""Flies a path with an experience as prior and returns the RMS error; infinite when the flight
failed or was taken back."""


@dataclass(frozen=True)
class Trial:
    """How a candidate tracked its own robot; infinite where it could not, or was not tried."""

    horizon_samples: int
    rms_error: float


@dataclass(frozen=True)
class HorizonChoice:
    """The layout that was chosen, and what every candidate did, shortest horizon first."""

    layout: InverseLayout
    trials: tuple[Trial, ...]


def candidate_layouts(
    architecture: Architecture,
    state_names: tuple[str, ...],
    sample_time_s: float,
    relative_degree: int,
    candidates_s: tuple[float, ...] = CANDIDATES_S,
) -> tuple[InverseLayout, ...]:
    """Return the layouts to try, shortest horizon first; none is shorter than the robot's delay."""
    least = max(relative_degree, 4 if architecture == "preview" else 1)
    horizons = sorted(
        {min(max(least, round(s / sample_time_s)), HORIZON_SAMPLES_MAX) for s in candidates_s}
    )
    names = state_names if architecture == "state" else state_names[:1]
    return tuple(
        InverseLayout(
            architecture=architecture,
            states=names,
            sample_time_s=sample_time_s,
            horizon_samples=horizon,
        )
        for horizon in horizons
    )


def choose_horizon(
    layouts: tuple[InverseLayout, ...],
    record: LearningRecord,
    columns: tuple[int, ...],
    origin: Origin,
    fly: Fly,
) -> HorizonChoice:
    """Fly a linear inverse with every horizon, longest first, and keep the one that tracks best.

    A feedback (`state`) is judged by the worse of two flights, one with γ as learned and one with γ
    a quarter too large (a target is never quite the source), so that a horizon on the verge of
    instability does not win; of horizons that track alike the longest is the gentlest. A preview
    cannot become unstable; of those the shortest is taken, whose training pairs are the freshest in
    flight.

    Args:
        layouts: the candidates, shortest horizon first.
        record: what the linear inverses are fitted to.
        columns: the axes whose pairs are pooled.
        origin: of the experience.
        fly: flies a candidate, guarded.

    Raises:
        StudyError: no candidate could be flown.
    """
    errors = {layout.horizon_samples: math.inf for layout in layouts}
    failures = 0
    for layout in reversed(layouts):
        if failures == FAILURES_MAX:
            break
        best = min(errors.values())
        data = TrainingData(*pooled_pairs(layout, record, columns))
        worst = fly(linear_experience(data, layout, origin))
        # Where the first flight rules a horizon out, the robot need not fly the second.
        if layout.architecture == "state" and worst <= _CLOSE * best and math.isfinite(worst):
            worst = max(worst, fly(linear_experience(data, layout, origin, gain=_GAIN_ERROR)))
        errors[layout.horizon_samples] = worst
        failed = not math.isfinite(worst) or worst > _FAR * best
        failures = failures + 1 if failed and math.isfinite(best) else 0
    trials = tuple(
        Trial(layout.horizon_samples, errors[layout.horizon_samples]) for layout in layouts
    )
    best = min(trial.rms_error for trial in trials)
    if not math.isfinite(best):
        shortest, longest = layouts[0].horizon_s, layouts[-1].horizon_s
        other = "preview" if layouts[0].architecture == "state" else "state"
        raise StudyError(
            f"robot {origin.robot} could not be flown with a {layouts[0].architecture} inverse of "
            f"any horizon from {shortest:.2f} to {longest:.2f} s: none did better than its "
            f"baseline; let it learn the other kind (--architecture {other}), or from a longer "
            "flight (--duration)"
        )
    alike = [i for i, trial in enumerate(trials) if trial.rms_error <= _CLOSE * best]
    return HorizonChoice(layouts[alike[-1 if layouts[0].architecture == "state" else 0]], trials)
