"""A study as ask and tell: which tests next, what has been learned. No network, no clock."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

Responses = Mapping[str, FrequencyResponse]
"""Per robot, the response at the tones of its test."""


@dataclass(frozen=True)
class DesiredMotion:
    """A trajectory that the target is to fly: its name, and its mean square at each frequency."""

    name: str
    omega_rad_s: tuple[float, ...]
    power: tuple[float, ...]


@dataclass(frozen=True)
class StudyPlan:
    """What is to be found out: which source's experience is the best for the target, on one axis.

    That is the one closest to it over the band or, of a `motion`, the one whose inverse is expected
    to leave the smallest error.
    """

    target: str
    sources: tuple[str, ...]
    band_rad_s: tuple[float, float]
    iterations: int
    axis: str
    motion: DesiredMotion | None = None


@dataclass(frozen=True)
class Question:
    """The next round: what each robot plays, all at the same time."""

    iteration: int
    tests: Mapping[str, Excitation]

    @property
    def robots(self) -> tuple[str, ...]:
        """The robots that are tested."""
        return tuple(self.tests)

    @property
    def omega_rad_s(self) -> tuple[float, ...]:
        """Every frequency that any of the robots plays, rising."""
        played = {tone.omega_rad_s for test in self.tests.values() for tone in test.tones}
        return tuple(sorted(played))


@dataclass(frozen=True)
class SourceEstimate:
    """A source's worst-case chordal distance to the target: mean, standard deviation and where."""

    robot: str
    psi: float
    psi_std: float
    omega_rad_s: float
    tests: int


@dataclass(frozen=True)
class Curve:
    """What is believed of one source's ψ_n(ω): posterior mean and standard deviation, and samples.

    `omega_rad_s`, `mean` and `std` have shape (grid,), the samples shape (tests,).
    """

    source: str
    omega_rad_s: FloatArray
    mean: FloatArray
    std: FloatArray
    sampled_omega_rad_s: FloatArray
    sampled_psi: FloatArray


@dataclass(frozen=True)
class Report:
    """What one round taught: the ranking (best first), the curves, and who was dropped and why.

    An algorithm that knows how sure it is says so: `confidence` is the probability that the source
    selected is the right one, `eliminated` names the sources that cannot win any more and why,
    `findings` what weakens the confidence, and `stopped_because` is set once the study is complete.
    """

    iteration: int
    omega_rad_s: tuple[float, ...]
    responses: Responses
    sampled_psi: Mapping[str, float]
    curves: tuple[Curve, ...]
    ranking: tuple[SourceEstimate, ...]
    dropped: Mapping[str, str]
    confidence: float | None = None
    eliminated: Mapping[str, str] = field(default_factory=dict)
    findings: tuple[str, ...] = ()
    stopped_because: str | None = None

    @property
    def selected(self) -> str:
        """The source believed closest to the target."""
        return self.ranking[0].robot


class Study(Protocol):
    """An algorithm in the middle of its work."""

    @property
    def responses(self) -> Mapping[str, Sequence[FrequencyResponse]]:
        """Every response known of each robot, of this study's tests and from before."""

    def ask(self) -> Question | None:
        """Return the next round of tests; None when the study is complete."""

    def tell(self, responses: Responses, failed: Mapping[str, str]) -> Report:
        """Take in the answers to the last question.

        Args:
            responses: of the robots whose test succeeded.
            failed: the reasons of those whose test did not.

        Raises:
            StudyError: the study cannot go on, because the target or every source is gone.
        """
