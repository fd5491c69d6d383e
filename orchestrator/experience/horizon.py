"""The horizon of an inverse model, chosen by flying candidates on the robot that will own it."""

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
"""Horizons to try in s, from the delay of a fast robot to the rise time of a slow one."""

FAILURES_MAX = 2
"""Give up on shorter horizons after this many consecutive failures below one that worked.
Longer ones may fail too: a fast robot extrapolates poorly far ahead."""

_CLOSE = 1.05  # errors within this ratio of each other count as equal
_FAR = 2.0  # an error of more than this many times the best counts as a failure
_GAIN_ERROR = 1.25  # a horizon must also work with an inverse whose gain is this much too large

Fly = Callable[[Experience], float]
"""Flies a path with an experience as the prior and returns the RMS error in the unit of the
robot's axes; infinite when the flight failed or the guard withdrew the prior."""


@dataclass(frozen=True)
class Trial:
    """The tracking error of one candidate horizon on the robot that the experience is for."""

    horizon_samples: int
    """Length of the horizon, in samples of the robot."""
    rms_error: float
    """RMS error in the unit of the robot's axes; infinite when the candidate failed or was not
    tried."""


@dataclass(frozen=True)
class HorizonChoice:
    """The chosen layout, and the trials that led to it."""

    layout: InverseLayout
    """Layout of the inverse model with the chosen horizon."""
    trials: tuple[Trial, ...]
    """Errors of all candidates, shortest horizon first."""


def candidate_layouts(
    architecture: Architecture,
    state_names: tuple[str, ...],
    sample_time_s: float,
    relative_degree: int,
    candidates_s: tuple[float, ...] = CANDIDATES_S,
) -> tuple[InverseLayout, ...]:
    """Return the layouts to try, shortest horizon first; none is shorter than the robot's delay.

    Args:
        architecture: Architecture of the inverse model.
        state_names: Names of the states that the robot measures; a preview uses only the first.
        sample_time_s: Sample time of the robot.
        relative_degree: Delay of the robot in samples, a lower limit of the horizon.
        candidates_s: Horizons to try, in s.
    """
    # A horizon below the delay would ask for an output that the reference cannot influence yet, and
    # a preview needs at least four samples to place its inputs.
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
    a quarter too large, because a target never equals its source. A horizon on the verge of
    instability therefore does not win. Among horizons that track equally well the longest is the
    gentlest and is chosen. A preview cannot become unstable; there the shortest is chosen, because
    its training pairs are available soonest in flight.

    Args:
        layouts: Candidates, shortest horizon first.
        record: Flight that the linear inverses are fitted to.
        columns: Columns of the record's axes whose training pairs are pooled.
        origin: Robot and axes that the experience comes from.
        fly: Function that flies a candidate under guard and returns its RMS error.

    Returns:
        The layout with the chosen horizon, and the errors of all candidates.

    Raises:
        StudyError: No candidate could be flown.
    """
    errors = {layout.horizon_samples: math.inf for layout in layouts}
    failures = 0
    # From the longest down: the shorter the horizon, the harder the inverse drives the robot, so
    # the candidates most likely to fail come last and may be left out.
    for layout in reversed(layouts):
        if failures == FAILURES_MAX:
            break
        best = min(errors.values())  # infinite until a horizon has worked
        data = TrainingData(*pooled_pairs(layout, record, columns))
        worst = fly(linear_experience(data, layout, origin))
        # The second flight is only needed when the first leaves the horizon in the running.
        if layout.architecture == "state" and worst <= _CLOSE * best and math.isfinite(worst):
            worst = max(worst, fly(linear_experience(data, layout, origin, gain=_GAIN_ERROR)))
        errors[layout.horizon_samples] = worst
        # Before any horizon has worked, a failure says nothing about the shorter ones.
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
            f"baseline; use the other architecture (--architecture {other}), or a longer flight "
            "(--duration)"
        )
    # Trials are in ascending order of the horizon: the last is the longest, the first the shortest.
    alike = [i for i, trial in enumerate(trials) if trial.rms_error <= _CLOSE * best]
    return HorizonChoice(layouts[alike[-1 if layouts[0].architecture == "state" else 0]], trials)
