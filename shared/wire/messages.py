"""Every message between an orchestrator and a robot's agent."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated, Literal

from pydantic import Field, model_validator

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.experience.manifest import ExperienceManifest
from nufleet.shared.frequency_test.excitation import ExcitationPlan
from nufleet.shared.frequency_test.timing import Timing
from nufleet.shared.robots.health import Health
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.strict import Digest, Fraction, Identifier, Name, NonNegative, Reason, Strict
from nufleet.shared.wire.codec import Bytes, Float64Array, Message
from nufleet.shared.wire.frame import new_order_id
from nufleet.shared.wire.motions import (
    MIXTURE_MAX,
    FlightDetails,
    Motion,
    MotionPlan,
    PredictedError,
    Way,
    check_weights,
)

Count = Annotated[int, Field(ge=0)]
Epoch = Annotated[int, Field(ge=0, lt=2**63)]
"""Epoch of the lease under which an orchestrator commands a robot; 0 without a lease.

The type is wider than the range that robots obey, so that a robot that receives a larger epoch can
report it.
"""

EPOCH_MAX = 2**53
"""Highest epoch that robots obey. Near the end of the range there would soon be no higher epoch
left, and JSON represents integers exactly only up to here."""

EPOCH_JUMP_MAX = 2**20
"""Largest step from the last epoch to the next that a robot obeys: more leases than are taken in
years of operation."""


class RobotStatus(StrEnum):
    """Activity of a robot."""

    IDLE = "idle"
    RUNNING = "running"
    RESTING = "resting"
    STOPPED = "stopped"
    FAULT = "fault"


class Outcome(StrEnum):
    """The way in which a goal ended."""

    COMPLETED = "completed"
    CANCELLED = "cancelled"
    ABORTED = "aborted"
    FAILED = "failed"
    LOST = "lost"
    """The agent process that played the goal ended before it did."""


class Refusal(Message):
    """Reply: the request is refused."""

    code: Name
    """Kind of refusal, for programs."""
    reason: Reason
    """Explanation, for people."""


class DescribeRequest(Message):
    """Request for a robot's description; answered by `Description`."""


class ExperienceOffer(Message):
    """A stored inverse model, without its weights."""

    sha256: Digest
    """SHA-256 of the stored file, by which it can be fetched."""
    size_bytes: Count
    """Length of the stored file."""
    manifest: ExperienceManifest
    """Origin and use of the model."""


class Description(Message):
    """A robot's properties, the agent process that serves it, and the experience it has."""

    robot: Name
    """Name of the robot."""
    boot_id: Identifier
    """Identifier of the agent process, new at every start."""
    spec: RobotSpec
    """Axes, limits and sample time of the robot."""
    state_names: tuple[Name, ...] = ()
    """Names of the states that the robot measures on every axis."""
    experiences: tuple[ExperienceOffer, ...] = ()
    """Experiences that the robot learned itself."""
    prior: ExperienceOffer | None = None
    """Experience that was transferred to the robot."""
    companions: Annotated[tuple[ExperienceOffer, ...], Field(max_length=MIXTURE_MAX - 1)] = ()
    """Further ones that were transferred, for a mixture with the prior."""
    own_flight_s: dict[Name, NonNegative] = Field(default_factory=dict)
    """Duration of the motions that tell the robot of each of its axes. A robot that knows nothing
    of itself cannot guard a flight."""
    owner: Identifier | None = None
    """Orchestrator that last commanded the robot under a lease."""
    epoch: Epoch = 0
    """Epoch of that lease; requests with a lower epoch are refused."""

    @property
    def priors(self) -> tuple[ExperienceOffer, ...]:
        """All experiences that were transferred to the robot, in their order."""
        return () if self.prior is None else (self.prior, *self.companions)

    @property
    def baseline_known(self) -> bool:
        """Whether the robot knows how its baseline behaves, so that a flight can be guarded."""
        return bool(self.own_flight_s)

    @property
    def least_known_s(self) -> float:
        """Duration of the motions that tell the robot of its least known axis."""
        return min(self.own_flight_s.get(axis.name, 0.0) for axis in self.spec.axes)


class GoalRequest(Message):
    """Request for one motion.

    A request with the same id and content as an earlier one refers to the same goal and causes no
    second motion.
    """

    goal_id: Identifier
    """Identifier of the goal."""
    owner: Identifier
    """Orchestrator that requests the motion."""
    epoch: Epoch = 0
    """Epoch of the orchestrator's lease on the robot."""
    motion: Motion
    """Frequency test or flight to perform."""
    acknowledges: Annotated[tuple[Identifier, ...], Field(max_length=64)] = ()
    """Earlier goals whose results have arrived, so that the agent may discard them."""


class GoalAccepted(Message):
    """Reply: the goal is accepted, now or by an earlier identical request."""

    goal_id: Identifier
    """Identifier of the goal."""
    boot_id: Identifier
    """Identifier of the agent process that accepted it."""
    plan: MotionPlan
    """The motion as it will be performed."""
    wall_duration_s: NonNegative
    """Expected duration on the wall clock."""


class CancelRequest(Message):
    """Request to end a goal early, with the robot brought to rest."""

    sender: Identifier
    """Orchestrator that sends the request."""
    epoch: Epoch = 0
    """Epoch of its lease on the robot."""
    goal_id: Identifier
    """Goal to cancel."""


class ResultRequest(Message):
    """Request for the result of a goal."""

    goal_id: Identifier
    """Goal whose result is wanted."""


class AcknowledgeRequest(Message):
    """Notice that the results of these goals have arrived and may be discarded."""

    sender: Identifier
    """Orchestrator that received the results."""
    epoch: Epoch = 0
    """Epoch of its lease on the robot."""
    goal_ids: Annotated[tuple[Identifier, ...], Field(max_length=64)]
    """Goals whose results arrived."""


class GoalResult(Message):
    """The outcome of a goal and its measurements.

    Reference and response have the same shape: (samples,) for a frequency test of one axis,
    (samples, axes played) for one of several, and (samples, axes) for a flight. Sample k was taken
    at k × `plan.sample_time_s` on the robot's own clock. The result of a goal that ended early
    holds the samples up to its end; that of a completed goal holds all samples of its plan.
    """

    goal_id: Identifier
    """Identifier of the goal."""
    boot_id: Identifier
    """Identifier of the agent process that performed it."""
    outcome: Outcome
    """The way in which it ended."""
    reason: Reason
    """Explanation of the outcome, for people."""
    plan: MotionPlan
    """The motion as it was planned."""
    reference: Float64Array
    """Reference sent to the robot, in the unit of its axes, (samples,) or (samples, axes)."""
    response: Float64Array
    """Measured output, same unit and shape as the reference."""
    details: FlightDetails | None = None
    """Further measurements of a flight; None for a frequency test."""
    timing: Timing | None = None
    """Times of a test's samples; None for a robot that does not record them."""
    late_samples: Count = 0
    """Number of samples of a real robot that began more than a sample time after their turn."""

    @model_validator(mode="after")
    def _samples_agree(self) -> GoalResult:
        samples = _samples(self.reference, self.response)
        columns = self.plan.columns if isinstance(self.plan, ExcitationPlan) else None
        if columns is None and self.reference.ndim != 2:
            raise ValueError("a flight has one column of samples per axis")
        if columns is not None and self.reference.shape[1:] != columns:
            raise ValueError(
                "a test of one axis has one-dimensional samples, one of several a column for each"
            )
        whole = self.plan.samples
        if samples > whole or (self.outcome is Outcome.COMPLETED and samples != whole):
            raise ValueError(f"{samples} samples do not fit a {self.outcome} plan of {whole}")
        return self

    @property
    def test_plan(self) -> ExcitationPlan:
        """The plan of a frequency test.

        Raises:
            MalformedMessageError: the goal was another motion.
        """
        if not isinstance(self.plan, ExcitationPlan):
            raise MalformedMessageError(f"{self.goal_id} is not a frequency test")
        return self.plan


class FetchRequest(Message):
    """Request for the file of an experience or prior that a robot has."""

    sha256: Digest
    """SHA-256 of the file."""


class ExperienceFile(Message):
    """A stored experience, in the format of `nufleet.shared.experience.file`."""

    sha256: Digest
    """SHA-256 of the payload."""
    payload: Bytes
    """The file."""


class InstallRequest(Message):
    """Request to store an experience on a robot: as its own, or as the prior that it flies with."""

    sender: Identifier
    """Orchestrator that sends the request."""
    epoch: Epoch = 0
    """Epoch of its lease on the robot."""
    sha256: Digest
    """SHA-256 of the payload."""
    payload: Bytes
    """The experience's file."""
    beside: bool = False
    """True if a prior joins those that the robot holds; False if it takes their place."""


class RemovePriorRequest(Message):
    """Request to remove all priors of a robot, or its model of itself."""

    sender: Identifier
    """Orchestrator that sends the request."""
    epoch: Epoch = 0
    """Epoch of its lease on the robot."""
    what: Literal["priors", "own-model"] = "priors"
    """What the robot is to forget. Without a model of itself it knows its baseline no longer."""


WAYS_MAX = 32
"""Largest number of ways of flying in one forecast: a mixture's sources, and a few besides."""


class ForeseenWay(Way):
    """A way of following a path, whose error is to be predicted."""

    after_rich_flight_s: Annotated[float, Field(ge=0, le=3600)] = 0.0
    """Duration of a rich flight that is to come before, which can be predicted for the robot's
    model of itself alone."""

    @model_validator(mode="after")
    def _learned_from(self) -> ForeseenWay:
        if self.after_rich_flight_s and self.inverse != "own":
            raise ValueError("what a rich flight will teach is known for the inverse 'own' alone")
        return self


class ForecastRequest(Message):
    """Request for the errors that a robot expects along a path; nothing moves.

    Predicting takes seconds per way, and a request is answered at once. The same request, sent
    again, returns what has been found since; once it is no longer sent, the robot stops predicting.
    """

    desired: Float64Array
    """Path, shape (samples, axes), one row per sample of the robot, in the axes' unit."""
    ways: Annotated[tuple[ForeseenWay, ...], Field(min_length=1, max_length=WAYS_MAX)]
    """Ways of following it."""

    @model_validator(mode="after")
    def _columns(self) -> ForecastRequest:
        if self.desired.ndim != 2:
            raise ValueError(f"desired must be of shape (samples, axes), got {self.desired.shape}")
        return self


class Foreseen(Strict):
    """What a robot expects of one way of following a path."""

    predicted: PredictedError | None = None
    """Error that it expects; None if it cannot fly so, or cannot tell."""
    code: Name | None = None
    """Kind of refusal where there is no prediction, as for a flight; for programs."""
    reason: Reason = ""
    """Why there is no prediction, or else what of the path is unlike all that it rests on; for
    people."""

    @model_validator(mode="after")
    def _either(self) -> Foreseen:
        if (self.predicted is None) == (self.code is None):
            raise ValueError("either there is a prediction, or a reason why there is none")
        return self


class PathForecast(Message):
    """Reply: what has been predicted until now."""

    foreseen: Annotated[tuple[Foreseen | None, ...], Field(max_length=WAYS_MAX)]
    """Prediction for each way of the request, in its order; None while it is being made."""


class StopRequest(Message):
    """Request to stop a robot at once; it stays stopped until it is explicitly released."""

    sender: Identifier
    """Identifier of the person or program that stops the robot."""
    reason: Reason
    """Why it is stopped."""
    kill: bool = False
    """Whether to cut the motors instead of coming to rest."""
    order_id: Identifier = Field(default_factory=new_order_id)
    """Id of the order, the same in every copy of it; an order without an id is a new one."""


class ReleaseRequest(Message):
    """Request to let a stopped robot move again."""

    sender: Identifier
    """Identifier of the person or program that releases the robot."""


class Done(Message):
    """Reply: the request has been carried out."""


class RobotState(Message):
    """A robot's state, published at every change and, as its heartbeat, twice a second."""

    robot: Name
    """Name of the robot."""
    boot_id: Identifier
    """Identifier of the agent process, new at every start."""
    sequence: Count
    """Number of this message, counted from the start of the agent process."""
    status: RobotStatus
    """Activity of the robot."""
    goal_id: Identifier | None
    """Goal in progress."""
    progress: Fraction
    """Fraction of that goal that is done."""
    reason: Reason
    """Explanation of the status, for people."""
    last_goal_id: Identifier | None
    """Goal that ended last."""
    robot_time_s: NonNegative
    """Time on the robot's own clock."""
    health: Health | None = None
    """Condition of the robot; None for one that reports none."""


class Telemetry(Message):
    """A batch of samples of a running test, for display only; batches may be lost.

    Reference and response have the same shape, (n,) or (n, axes).
    """

    goal_id: Identifier
    """Goal in progress."""
    first_sample: Count
    """Index of the first sample of the batch within the test."""
    sample_time_s: NonNegative
    """Time between samples."""
    reference: Float64Array
    """Reference sent to the robot, in the unit of its axes."""
    response: Float64Array
    """Measured output, in the same unit."""

    @model_validator(mode="after")
    def _samples_agree(self) -> Telemetry:
        _samples(self.reference, self.response)
        return self


class TrackingTelemetry(Message):
    """A batch of n samples of a flight along a path, for display; see also `TrackingDetails`."""

    goal_id: Identifier
    """Goal in progress."""
    first_sample: Count
    """Index of the first sample of the batch within the flight."""
    sample_time_s: NonNegative
    """Time between samples."""
    desired: Float64Array
    """Desired path, shape (n, axes), in the axes' unit."""
    actual: Float64Array
    """Measured output, shape (n, axes), in the axes' unit."""
    prior: Float64Array
    """γ from the prior, shape (n, axes), in unit/s."""
    mean: Float64Array
    """Posterior mean of γ less the prior, shape (n, axes), in unit/s."""
    variance: Float64Array
    """Posterior variance of γ, shape (n, axes), in (unit/s)²."""
    share: Float64Array
    """Fraction of the correction that acted, shape (n,)."""
    experts: tuple[Name, ...] = ()
    """Sources of the experiences in a mixture; empty without one."""
    weights: Float64Array | None = None
    """Weight of each of them and, last, of no experience, shape (n, experts + 1)."""

    @model_validator(mode="after")
    def _samples_agree(self) -> TrackingTelemetry:
        shapes = {a.shape for a in (self.actual, self.prior, self.mean, self.variance)}
        if shapes != {self.desired.shape} or self.desired.shape[:1] != self.share.shape:
            raise ValueError(f"the arrays differ in shape: {self.desired.shape} and {shapes}")
        check_weights(self.experts, self.weights, len(self.desired))
        return self


def _samples(reference: FloatArray, response: FloatArray) -> int:
    """Return the number of samples of two arrays; raise ValueError unless their shapes agree."""
    if reference.ndim > 2 or reference.shape != response.shape:
        raise ValueError(
            "reference and response must have the same shape, (samples,) or (samples, axes), "
            f"got {reference.shape} and {response.shape}"
        )
    return len(reference)
