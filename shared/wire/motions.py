"""What a robot can be asked to do, what it plans then, and what a flight measures besides."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan
from nufleet.shared.strict import Digest, Name, Positive, Reason, Strict
from nufleet.shared.wire.codec import Float64Array

Count = Annotated[int, Field(ge=0)]


class StepTest(Strict):
    """Asks for small steps on one axis, up and down, as quick as the axis's limits allow."""

    kind: Literal["step-test"] = "step-test"
    axis: Name


class RichFlight(Strict):
    """Asks for a flight that shows a robot's whole dynamics, under its baseline alone.

    The robot draws its references from `seed`, under its own tracking limits, and learns from the
    flight what its baseline does.
    """

    kind: Literal["rich-flight"] = "rich-flight"
    duration_s: Annotated[float, Field(gt=0, le=3600)]
    seed: Count


class Tracking(Strict):
    """Asks to follow a path: `desired`, shape (samples, axes), one row per sample of the robot.

    `inverse` says what stands in front of the baseline controller: nothing, an online process that
    begins with nothing (it needs a `layout`), or one whose prior mean is the experience that was
    transferred to the robot, which then must be the one with `prior_sha256`. A `guarded` flight
    falls back to the baseline when it does worse than that would; one that does not `learn` uses
    the prior as it is.
    """

    kind: Literal["tracking"] = "tracking"
    desired: Float64Array
    inverse: Literal["baseline", "zero-prior", "prior"]
    layout: InverseLayout | None = None
    prior_sha256: Digest | None = None
    guarded: bool = True
    learn: bool = True

    @model_validator(mode="after")
    def _complete(self) -> Tracking:
        if self.desired.ndim != 2:
            raise ValueError(f"desired must be of shape (samples, axes), got {self.desired.shape}")
        if (self.layout is not None) != (self.inverse == "zero-prior"):
            raise ValueError("a layout belongs to the inverse 'zero-prior', and only to that")
        if (self.prior_sha256 is not None) != (self.inverse == "prior"):
            raise ValueError("prior_sha256 belongs to the inverse 'prior', and only to that")
        return self


Flight = StepTest | RichFlight | Tracking
Motion = Annotated[Excitation | Flight, Field(discriminator="kind")]


class FlightPlan(Strict):
    """A flight that was accepted: how many samples it will record.

    `duration_s` is on the robot's clock and counts what is flown besides: the way to the start,
    settling.
    """

    kind: Literal["flight"] = "flight"
    sample_time_s: Positive
    samples: Annotated[int, Field(ge=1)]
    duration_s: Positive


MotionPlan = Annotated[ExcitationPlan | FlightPlan, Field(discriminator="kind")]


class RichFlightDetails(Strict):
    """What a rich flight measured besides reference and output.

    `states` has shape (samples, axes, states) and was taken before each reference acted;
    `state_names` names them, the output first.
    """

    kind: Literal["rich-flight"] = "rich-flight"
    state_names: tuple[Name, ...]
    states: Float64Array


class TakenBack(Strict):
    """The guard took the prior back at that sample, and why."""

    sample: Count
    reason: Reason


class TrackingDetails(Strict):
    """What happened along a path, sample by sample.

    `desired`, `prior`, `mean` and `variance` have shape (samples, axes) and are zero for γ where
    the baseline flew alone; `share` (how much of the correction acted), `limited` (1 where it was
    held to its bounds) and `step_time_s` (what choosing the reference took) shape (samples,).
    """

    kind: Literal["tracking"] = "tracking"
    desired: Float64Array
    prior: Float64Array
    mean: Float64Array
    variance: Float64Array
    share: Float64Array
    limited: Float64Array
    step_time_s: Float64Array
    dropped_pairs: Count
    taken_back: TakenBack | None


FlightDetails = Annotated[RichFlightDetails | TrackingDetails, Field(discriminator="kind")]
