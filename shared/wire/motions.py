"""The motions that a robot can be asked for, their plans, and the extra measurements of flights."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan
from nufleet.shared.strict import Digest, Name, NonNegative, Positive, Reason, Strict
from nufleet.shared.wire.codec import Float64Array

Count = Annotated[int, Field(ge=0)]


class StepTest(Strict):
    """Request for small steps on one axis, up and down, as fast as the axis's limits allow."""

    kind: Literal["step-test"] = "step-test"
    """Discriminator among the motions a robot can be asked for."""
    axis: Name
    """Name of the axis to step."""


class RichFlight(Strict):
    """Request for a flight that excites all of a robot's dynamics, under its baseline alone.

    The robot generates random references within its own tracking limits. From the flight it learns
    how its baseline behaves.
    """

    kind: Literal["rich-flight"] = "rich-flight"
    """Discriminator among the motions a robot can be asked for."""
    duration_s: Annotated[float, Field(gt=0, le=3600)]
    """Duration of the references."""
    seed: Count
    """Seed of the random generator that draws the references."""


MIXTURE_MAX = 16
"""Largest number of experiences in a mixture, and of priors that a robot holds."""


class Weighted(Strict):
    """A transferred experience in a mixture."""

    sha256: Digest
    """SHA-256 of the experience, to be checked by the robot."""
    weight: Annotated[float, Field(gt=0, lt=1)]
    """Probability before the flight that it is the right one."""


class AxisPrior(Strict):
    """A transferred experience that is the prior of one axis."""

    axis: Name
    """Name of the axis."""
    sha256: Digest
    """SHA-256 of the experience, to be checked by the robot."""


class Way(Strict):
    """A way of following a path, with or without a learned inverse before the baseline controller.

    The inverse is the paper's inverse dynamics module: a Gaussian process whose prior mean may be
    an experience of another robot, eq. (2).
    """

    inverse: Literal["baseline", "zero-prior", "prior", "mixture", "own"]
    """Module in front of the baseline controller: none; a process that starts without experience; a
    process whose prior mean is one experience that was transferred to the robot; one whose prior
    mean is a mixture of several, weighed in flight; or the robot's model of itself, inverted along
    the whole path."""
    layout: InverseLayout | None = None
    """Inputs and output of a process with a zero prior; None for the other inverses."""
    prior_sha256: Digest | None = None
    """SHA-256 of the transferred experience, to be checked by the robot; None without a prior."""
    prior_by_axis: Annotated[tuple[AxisPrior, ...], Field(max_length=16)] = ()
    """Other experiences that are the prior of single axes; all other axes take the one above. Empty
    for the other inverses."""
    mixture: Annotated[tuple[Weighted, ...], Field(max_length=MIXTURE_MAX)] = ()
    """Transferred experiences of a mixture. What their weights leave to 1 is the weight of no
    experience. Empty for the other inverses."""
    guarded: bool = True
    """True if the flight falls back to the baseline once it does worse than the baseline would."""
    learn: bool = True
    """False if the prior is used as it is, without learning online."""
    remember: bool = True
    """False if the flight adds nothing to the robot's model of itself: the next one then begins
    with the same knowledge, so that the two can be compared."""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        if (self.layout is not None) != (self.inverse == "zero-prior"):
            raise ValueError("a layout belongs to the inverse 'zero-prior', and only to that")
        if (self.prior_sha256 is not None) != (self.inverse == "prior"):
            raise ValueError("prior_sha256 belongs to the inverse 'prior', and only to that")
        if self.prior_by_axis and self.inverse != "prior":
            raise ValueError(
                "priors of single axes belong to the inverse 'prior', and only to that"
            )
        if len({one.axis for one in self.prior_by_axis}) < len(self.prior_by_axis):
            raise ValueError("an axis has two priors")
        if bool(self.mixture) != (self.inverse == "mixture"):
            raise ValueError("experiences with weights belong to the inverse 'mixture', and only")
        if len({each.sha256 for each in self.mixture}) < len(self.mixture):
            raise ValueError("an experience is in the mixture twice")
        if sum(each.weight for each in self.mixture) >= 1:
            raise ValueError("the weights of a mixture leave nothing to flying without experience")
        return self

    @property
    def asked(self) -> tuple[str, ...]:
        """SHA-256 of every transferred experience that it needs, the leading one first."""
        first = () if self.prior_sha256 is None else (self.prior_sha256,)
        mixed = (each.sha256 for each in self.mixture)
        return tuple(dict.fromkeys((*first, *(one.sha256 for one in self.prior_by_axis), *mixed)))

    def along(self, desired: FloatArray) -> Tracking:
        """Return the request to follow a path in this way, shape (samples, axes)."""
        fields = {name: getattr(self, name) for name in Way.model_fields}
        return Tracking(desired=desired, **fields)


class Tracking(Way):
    """Request to follow a path in some way."""

    kind: Literal["tracking"] = "tracking"
    """Discriminator among the motions a robot can be asked for."""
    desired: Float64Array
    """Path to follow, shape (samples, axes), one row per sample of the robot, in the axes' unit."""

    @model_validator(mode="after")
    def _columns(self) -> Self:
        if self.desired.ndim != 2:
            raise ValueError(f"desired must be of shape (samples, axes), got {self.desired.shape}")
        return self


Flight = StepTest | RichFlight | Tracking
Motion = Annotated[Excitation | Flight, Field(discriminator="kind")]


class FlightPlan(Strict):
    """Plan of an accepted flight."""

    kind: Literal["flight"] = "flight"
    """Discriminator among the plans of motions."""
    sample_time_s: Positive
    """Time between samples."""
    samples: Annotated[int, Field(ge=1)]
    """Number of samples that the flight will record."""
    duration_s: Positive
    """Duration on the robot's clock, including parts that are not recorded: flying to the start and
    settling."""


MotionPlan = Annotated[ExcitationPlan | FlightPlan, Field(discriminator="kind")]


class RichFlightDetails(Strict):
    """Measurements of a rich flight in addition to reference and output."""

    kind: Literal["rich-flight"] = "rich-flight"
    """Discriminator among the details of flights."""
    state_names: tuple[Name, ...]
    """Names of the states, the output first."""
    states: Float64Array
    """States, shape (samples, axes, states), measured before the reference of each sample acted."""


class PredictedError(Strict):
    """The root mean square error that a robot expects of a flight from its model of itself.

    It contains the measurement noise, like the error that is measured.
    """

    rms: NonNegative
    """Median, in the unit of the axes."""
    low: NonNegative
    """Value that the error is above with a probability of 95 %."""
    high: NonNegative
    """Value that the error is below with a probability of 95 %."""


class TakenBack(Strict):
    """Event: the guard withdrew the prior during a flight."""

    sample: Count
    """Sample at which it was withdrawn."""
    reason: Reason
    """Why it was withdrawn."""
    given_to: Literal["baseline", "own"] = "baseline"
    """What flew on: the baseline alone, or the robot's model of itself."""


class TrackingDetails(Strict):
    """Measurements of a flight along a path, in addition to reference and output.

    The arrays on γ, the output of the inverse, are zero if the baseline flew alone.
    """

    kind: Literal["tracking"] = "tracking"
    """Discriminator among the details of flights."""
    desired: Float64Array
    """Desired path, shape (samples, axes), in the axes' unit."""
    prior: Float64Array
    """γ from the prior, shape (samples, axes), in unit/s."""
    mean: Float64Array
    """Posterior mean of γ less the prior, shape (samples, axes), in unit/s."""
    variance: Float64Array
    """Posterior variance of γ, shape (samples, axes), in (unit/s)²."""
    share: Float64Array
    """Fraction of the correction that acted, shape (samples,)."""
    limited: Float64Array
    """1 where the correction was limited by its bounds, else 0, shape (samples,)."""
    step_time_s: Float64Array
    """Computing time for choosing each reference, shape (samples,)."""
    dropped_pairs: Count
    """Number of training pairs dropped because they were not finite."""
    taken_back: TakenBack | None
    """Withdrawal of the prior by the guard; None if there was none."""
    predicted: PredictedError | None = None
    """Error that the robot expected; None for a robot that knows nothing of itself, and for an
    inverse that learns in flight or is fed with the state unless a forecast was asked for."""
    way: Reason | None = None
    """How the robot flew with its model of itself, and why; None for the other inverses."""
    findings: tuple[Reason, ...] = ()
    """What the flight showed of the robot's model of itself: that the robot has changed, say."""
    experts: tuple[Name, ...] = ()
    """Sources of the experiences in a mixture; empty without one."""
    weights: Float64Array | None = None
    """Weight of each of them and, last, of no experience, shape (samples, experts + 1); None
    without a mixture."""

    @model_validator(mode="after")
    def _weights_agree(self) -> TrackingDetails:
        check_weights(self.experts, self.weights, len(self.desired))
        return self


def check_weights(experts: tuple[str, ...], weights: FloatArray | None, samples: int) -> None:
    """Raise ValueError unless there is a weight per sample for every expert and for none.

    Args:
        experts: Names of the experts of a mixture; empty without one.
        weights: Their weights and that of none, shape (samples, experts + 1); None without a
            mixture.
        samples: Number of samples of the flight.
    """
    shape = None if weights is None else weights.shape
    if shape != ((samples, len(experts) + 1) if experts else None):
        raise ValueError(
            f"weights of shape {shape} for {samples} samples of {len(experts)} experts"
        )


FlightDetails = Annotated[RichFlightDetails | TrackingDetails, Field(discriminator="kind")]
