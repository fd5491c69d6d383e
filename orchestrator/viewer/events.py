"""What a study shows of itself while it runs: plain values, with no viewer in them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from nufleet.orchestrator.study.interface import Curve, SourceEstimate
from nufleet.shared.arrays import FloatArray

RobotStatus = Literal["idle", "running", "resting", "stopped", "fault", "lost"]
MessageLevel = Literal["debug", "info", "warning", "error"]

# Times `t_s` are seconds since the study began. Events are compared by identity: they hold arrays.


@dataclass(frozen=True, eq=False)
class RobotStateEvent:
    """What a robot is doing now; `progress` of its goal in [0, 1]; `reason` is a sentence or ""."""

    t_s: float
    robot: str
    status: RobotStatus
    goal_id: str | None
    progress: float
    reason: str


@dataclass(frozen=True, eq=False)
class TestSamplesEvent:
    """Reference and response of a frequency test whose first sample is at `t_s`.

    Both have shape (n,), in `unit`, one value every `sample_time_s`.
    """

    __test__ = False  # pytest: not a test case

    t_s: float
    robot: str
    axis: str
    unit: str
    omega_rad_s: tuple[float, ...]
    sample_time_s: float
    reference: FloatArray
    response: FloatArray


@dataclass(frozen=True, eq=False)
class IterationEvent:
    """What one round of tests taught; `ranking` is best first.

    `responses` holds, for each robot that answered, z(ω) at each tone of `omega_rad_s`.
    """

    t_s: float
    iteration: int
    omega_rad_s: tuple[float, ...]
    responses: Mapping[str, tuple[complex, ...]]
    target: str
    curves: tuple[Curve, ...]
    ranking: tuple[SourceEstimate, ...]
    messages: tuple[str, ...] = ()


@dataclass(frozen=True, eq=False)
class TrackingSamplesEvent:
    """A part of a flight along a path; its first sample was taken at `t_s`.

    Arrays have shape (n, axes), one row every `sample_time_s`, in `unit`; `prior` and the online
    process's `mean` and `variance` are of γ, in unit/s. A variance of 0 everywhere says that no
    inverse was at work. `share`, shape (n,), is how much of the correction acted.

    `flight` says who gave the prior, and then the path: "source-1 · clover · 0.6 m/s"; see
    `flight_labels`. A new flight begins with another label, or after a pause.
    """

    t_s: float
    robot: str
    flight: str
    axes: tuple[str, ...]
    unit: str
    sample_time_s: float
    desired: FloatArray
    actual: FloatArray
    prior: FloatArray
    mean: FloatArray
    variance: FloatArray
    share: FloatArray


@dataclass(frozen=True, eq=False)
class TakenBackEvent:
    """The guard took the prior of a flight back, because of `reason`."""

    t_s: float
    robot: str
    flight: str
    reason: str


@dataclass(frozen=True, eq=False)
class MessageEvent:
    """A sentence for the log."""

    t_s: float
    level: MessageLevel
    text: str


ViewerEvent = (
    RobotStateEvent
    | TestSamplesEvent
    | IterationEvent
    | TrackingSamplesEvent
    | TakenBackEvent
    | MessageEvent
)
