"""The ask-and-tell interface of a study: next tests, and what they taught. No network, no clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol, TypeAlias

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Excitation

if TYPE_CHECKING:
    from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

Responses: TypeAlias = "Mapping[str, FrequencyResponse]"
"""Response at the tones of its test, by robot."""


@dataclass(frozen=True)
class DesiredMotion:
    """The spectrum of a trajectory that the target is to fly."""

    name: str
    """Name of the trajectory, for people."""
    omega_rad_s: tuple[float, ...]
    """Frequencies in rad/s, rising."""
    power: tuple[float, ...]
    """Mean square position at each frequency, in m², of all axes; see `spectrum_of`."""
    power_by_axis: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    """The part of each axis of the target along which it moves; empty in older studies, which
    compared a single axis."""


@dataclass(frozen=True)
class StudyPlan:
    """The question of a study: which source's experience is the best for the target.

    The best source is the closest to the target over the band or, where a `motion` is given, the
    one whose inverse model is expected to leave the smallest error on it.
    """

    target: str
    """Name of the robot that is to receive an experience."""
    sources: tuple[str, ...]
    """Names of the candidate robots."""
    band_rad_s: tuple[float, float]
    """Lowest and highest frequency of the band 𝒲, in rad/s."""
    iterations: int
    """Largest number of rounds of tests."""
    axis: str
    """Name of the axis that is tested on every robot; the first of several."""
    motion: DesiredMotion | None = None
    """Trajectory that the target is to fly, if one is known."""
    precision: float | None = None
    """Width of the selected source's 95 % interval of ψ* at which the study may end; None for no
    limit."""
    amplitude: float | None = None
    """Amplitude of the task, in the axis's unit, at which ψ is meant; None for the one that each
    robot chooses."""
    also: tuple[str, ...] = ()
    """Names of further axes that are tested, at the same time where the robots allow that. The best
    source is then the closest on its worst axis."""

    @property
    def axes(self) -> tuple[str, ...]:
        """Names of all axes that are tested."""
        return (self.axis, *self.also)


@dataclass(frozen=True)
class Question:
    """A round of tests, which all robots play at the same time."""

    iteration: int
    """Number of the round, from 1."""
    tests: Mapping[str, Excitation]
    """Excitation that each robot is to play, by robot."""
    purpose: str = ""
    """What the round is for, in words."""
    robot_time_s: float | None = None
    """Time that all robots together move for it, as far as it is known, in s."""

    @property
    def robots(self) -> tuple[str, ...]:
        """Names of the robots under test."""
        return tuple(self.tests)

    @property
    def omega_rad_s(self) -> tuple[float, ...]:
        """All frequencies that any of the robots plays, in rad/s, rising."""
        played = {omega for test in self.tests.values() for omega in test.omega_rad_s}
        return tuple(sorted(played))


@dataclass(frozen=True)
class AxisEstimate:
    """The estimate of a source's worst-case chordal distance to the target on one axis."""

    psi: float
    """Median of the distance, from 0 to 1."""
    psi_low: float
    psi_high: float
    """Bounds of the interval that holds the distance with a probability of 95 %. The upper one is 1
    where tests leave open that it is any larger."""
    omega_rad_s: float
    """Frequency in rad/s at which the median of ψ_n,i(ω) is largest."""


@dataclass(frozen=True)
class SourceEstimate:
    """The estimate of a source's worst-case chordal distance ψ* to the target."""

    robot: str
    """Name of the source."""
    psi: float
    """Median of the distance, from 0 to 1."""
    psi_low: float
    psi_high: float
    """Bounds of the interval that holds the distance with a probability of 95 %. The upper one is 1
    where tests leave open that it is any larger."""
    omega_rad_s: float
    """Frequency in rad/s at which the median of ψ_n(ω) is largest."""
    tests: int
    """Number of tests of the source that the estimate rests on."""
    measured_psi: float | None = None
    """Largest distance at a tone that both robots played; None if they share none."""
    measured_omega_rad_s: float | None = None
    """That tone, in rad/s."""
    axes: dict[str, AxisEstimate] | None = None
    """Estimate on each axis, by axis; None where one axis is tested."""

    @property
    def axis(self) -> str | None:
        """The axis that decides, on which the distance is largest; None where one is tested."""
        if self.axes is None:
            return None
        axes = self.axes
        return max(axes, key=lambda axis: axes[axis].psi)

    @property
    def decided(self) -> str:
        """Which axis decides, and the distance on each, in words; empty where one is tested."""
        if self.axes is None:
            return ""
        each = ", ".join(f"{axis} {one.psi:.4f}" for axis, one in self.axes.items())
        return f"{self.on_axis} ({each})"

    @property
    def on_axis(self) -> str:
        """Which axis decides, in words; empty where one is tested."""
        return "" if self.axis is None else f" on {self.axis}"

    @property
    def stated(self) -> str:
        """Median and interval in words."""
        return f"{self.psi:.4f} ({self.psi_low:.4f} to {self.psi_high:.4f})"

    @property
    def measured(self) -> str:
        """The largest measured distance in words; empty where there is none."""
        if self.measured_psi is None or self.measured_omega_rad_s is None:
            return ""
        return f"{self.measured_psi:.4f} at {self.measured_omega_rad_s:.3g}"


@dataclass(frozen=True)
class Curve:
    """The belief about one source's chordal distance ψ_n(ω) to the target."""

    source: str
    """Name of the source."""
    omega_rad_s: FloatArray
    """Frequencies of the grid in rad/s, shape (grid,)."""
    median: FloatArray
    """Median of ψ_n, shape (grid,)."""
    low: FloatArray
    high: FloatArray
    """Bounds of the interval that holds ψ_n with a probability of 95 %, shape (grid,)."""
    sampled_omega_rad_s: FloatArray
    """Frequencies at which the source was tested, in rad/s, shape (tones,)."""
    sampled_psi: FloatArray
    """Value of ψ_n to mark at each tested frequency, shape (tones,)."""


@dataclass(frozen=True)
class Report:
    """What a study has learned after a round.

    The last four fields are set only by an algorithm that estimates its own confidence.
    """

    iteration: int
    """Number of the round, from 1."""
    omega_rad_s: tuple[float, ...]
    """All frequencies that were played in the round, in rad/s, rising."""
    responses: Responses
    """Responses that were measured in the round, by robot."""
    sampled_psi: Mapping[str, float]
    """Largest chordal distance measured in the round, by source."""
    curves: tuple[Curve, ...]
    """Belief about each remaining source's ψ_n(ω)."""
    ranking: tuple[SourceEstimate, ...]
    """Estimates of the remaining sources, best first."""
    dropped: Mapping[str, str]
    """Reason for each source that the study lost, by source."""
    known: Mapping[str, Sequence[FrequencyResponse]] = field(default_factory=dict)
    """All responses up to now, those from before the study included, by robot, for those who watch
    it; empty where only those of the round are to be seen."""
    confidence: float | None = None
    """Probability that the selected source is the right one."""
    eliminated: Mapping[str, str] = field(default_factory=dict)
    """Reason for each source that can no longer win, by source."""
    findings: tuple[str, ...] = ()
    """Observations that weaken the confidence."""
    stopped_because: str | None = None
    """Reason why the study is complete; None while it is not."""

    @property
    def selected(self) -> str:
        """The source believed closest to the target."""
        return self.ranking[0].robot


class Study(Protocol):
    """A study in progress; every algorithm implements this interface."""

    @property
    def responses(self) -> Mapping[str, Sequence[FrequencyResponse]]:
        """All known responses by robot, from this study and from before it."""

    def ask(self) -> Question | None:
        """Return the next round of tests; None when the study is complete."""

    def tell(self, responses: Responses, failed: Mapping[str, str]) -> Report:
        """Learn from the answers to the last question.

        Args:
            responses: Responses of the robots whose test succeeded, by robot.
            failed: Reasons of the failed tests, by robot.

        Returns:
            The state of the study after these answers.

        Raises:
            StudyError: The study cannot continue, because the target or every source is gone.
        """
