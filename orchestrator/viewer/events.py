"""The events that a running study shows, as plain values that know nothing of a viewer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from nufleet.orchestrator.study.interface import Curve, SourceEstimate
from nufleet.shared.arrays import FloatArray
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.frequency_test.excitation import Tone

RobotStatus = Literal["idle", "running", "resting", "stopped", "fault", "lost"]
MessageLevel = Literal["debug", "info", "warning", "error"]

ToneResponses = Mapping[float, complex]
"""Response z(ω) of one robot, by frequency ω in rad/s."""

LEADERS = 6
"""Number of sources that are drawn in full, so that the rest do not hide them."""

# Times `t_s` are seconds since the study began. Events are compared by identity: they hold arrays.


@dataclass(frozen=True, eq=False)
class RobotStateEvent:
    """The current state of a robot."""

    t_s: float
    """Time of the event."""
    robot: str
    """Name of the robot."""
    is_target: bool
    """Whether it is the target of the study."""
    status: RobotStatus
    """Status of the robot."""
    goal_id: str | None
    """Id of the goal in progress; None when there is none."""
    progress: float
    """Progress of that goal, in [0, 1]."""
    reason: str
    """Sentence that explains the status, or an empty string."""


@dataclass(frozen=True, eq=False)
class TestSamplesEvent:
    """A frequency test, or a part of one."""

    __test__ = False  # pytest: not a test case

    t_s: float
    """Time of the first sample."""
    robot: str
    """Name of the robot."""
    axis: str
    """Name of the axis under test."""
    unit: str
    """Unit of the axis."""
    target: str
    """Name of the study's target."""
    robots: tuple[str, ...]
    """Names of the robots that play in this round."""
    tones: tuple[Tone, ...]
    """Tones that the robot plays in this test."""
    sample_time_s: float
    """Time between two samples."""
    reference: FloatArray
    """Reference in `unit`, shape (n,)."""
    response: FloatArray
    """Measured response in `unit`, shape (n,)."""


@dataclass(frozen=True, eq=False)
class Answers:
    """The responses of robots to tones, as they are drawn together."""

    t_s: float
    """Time at which they were known."""
    omega_rad_s: tuple[float, ...]
    """Frequencies of the latest tones, rising."""
    responses: Mapping[str, ToneResponses]
    """What is known of each robot that responded, by robot."""
    target: str
    """Name of the target."""
    leaders: tuple[str, ...]
    """Names of the sources that are drawn in full, the best ones, best first."""

    def psi(self, source: str) -> dict[float, float]:
        """Return the chordal distances ψ(z_S, z_T) at the tones known of both, by ω, rising."""
        own, others = self.responses.get(self.target, {}), self.responses.get(source, {})
        both = sorted(own.keys() & others.keys())
        z = np.array([[others[omega], own[omega]] for omega in both]).reshape(-1, 2)
        return dict(zip(both, chordal_distance(z[:, 0], z[:, 1]).tolist(), strict=True))


@dataclass(frozen=True, eq=False)
class IterationEvent:
    """The result of one round of tests."""

    t_s: float
    """Time of the event."""
    iteration: int
    """Number of the round, from 1."""
    omega_rad_s: tuple[float, ...]
    """Frequencies that the target was tested at, rising; those of another robot if it rested."""
    responses: Mapping[str, ToneResponses]
    """What is known of the target, the leaders and all robots that responded, by robot."""
    target: str
    """Name of the target."""
    curves: tuple[Curve, ...]
    """Belief about ψ_n(ω) for each source."""
    ranking: tuple[SourceEstimate, ...]
    """Estimates ψ̂*_n of the sources, best first."""
    messages: tuple[str, ...] = ()
    """Sentences for the log."""

    @property
    def leaders(self) -> tuple[str, ...]:
        """Names of the best sources of the ranking, best first."""
        return tuple(row.robot for row in self.ranking[:LEADERS])

    @property
    def answers(self) -> Answers:
        """Responses that the round is compared by."""
        return Answers(self.t_s, self.omega_rad_s, self.responses, self.target, self.leaders)


@dataclass(frozen=True, eq=False)
class TrackingSamplesEvent:
    """A part of a flight along a path."""

    t_s: float
    """Time of the first sample."""
    robot: str
    """Name of the robot."""
    flight: str
    """Name of the flight: the prior and then the path, such as "source-1 · clover · 0.6 m/s"; see
    `flights.labels`. A new flight begins with another name, or after a pause."""
    axes: tuple[str, ...]
    """Names of the robot's axes."""
    unit: str
    """Unit of these axes."""
    sample_time_s: float
    """Time between two samples."""
    desired: FloatArray
    """Desired positions in `unit`, shape (n, axes)."""
    actual: FloatArray
    """Measured positions in `unit`, shape (n, axes)."""
    prior: FloatArray
    """Prior mean of γ in `unit`/s, shape (n, axes)."""
    mean: FloatArray
    """Posterior mean of γ in the online Gaussian process, in `unit`/s, shape (n, axes)."""
    variance: FloatArray
    """Posterior variance of γ in (`unit`/s)², shape (n, axes); 0 everywhere when no inverse was at
    work."""
    share: FloatArray
    """Fraction of the correction that acted, in [0, 1], shape (n,)."""
    experts: tuple[str, ...] = ()
    """Names of the sources in a mixture; empty without one."""
    weights: FloatArray | None = None
    """Weight of each of them and, last, of none, shape (n, experts + 1); None without a mixture."""


@dataclass(frozen=True, eq=False)
class TakenBackEvent:
    """The withdrawal of a flight's prior by the guard."""

    t_s: float
    """Time of the withdrawal."""
    robot: str
    """Name of the robot."""
    flight: str
    """Name of the flight."""
    reason: str
    """Why the guard withdrew the prior."""


@dataclass(frozen=True, eq=False)
class MessageEvent:
    """A sentence for the log."""

    t_s: float
    """Time of the event."""
    level: MessageLevel
    """Severity of the message."""
    text: str
    """The sentence itself."""


ViewerEvent = (
    RobotStateEvent
    | TestSamplesEvent
    | IterationEvent
    | TrackingSamplesEvent
    | TakenBackEvent
    | MessageEvent
)
