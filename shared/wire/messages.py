"""Every message between an orchestrator and a robot's agent."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field, model_validator

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.experience.manifest import ExperienceManifest
from nufleet.shared.frequency_test.excitation import ExcitationPlan
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.strict import Digest, Identifier, Name, NonNegative, Reason
from nufleet.shared.wire.codec import Bytes, Float64Array, Message
from nufleet.shared.wire.motions import FlightDetails, Motion, MotionPlan

Count = Annotated[int, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]
Epoch = Annotated[int, Field(ge=0, lt=2**63)]
"""Of the lease under which an orchestrator commands a robot; 0 when it has none.

Wider than what robots obey, so that one that was told more can say so.
"""

EPOCH_MAX = 2**53
"""No robot obeys a higher epoch: there would soon be none above it, and JSON holds no more."""

EPOCH_JUMP_MAX = 2**20
"""So far above the last epoch a robot obeys the next: as many leases as nobody takes in years."""


class RobotStatus(StrEnum):
    """What a robot is doing."""

    IDLE = "idle"
    RUNNING = "running"
    RESTING = "resting"
    STOPPED = "stopped"
    FAULT = "fault"


class Outcome(StrEnum):
    """How a goal ended; one that is `LOST` ended with the agent process that played it."""

    COMPLETED = "completed"
    CANCELLED = "cancelled"
    ABORTED = "aborted"
    FAILED = "failed"
    LOST = "lost"


class Refusal(Message):
    """The answer no: `code` for programs, `reason` for people."""

    code: Name
    reason: Reason


class DescribeRequest(Message):
    """Asks a robot what it is."""


class ExperienceOffer(Message):
    """A stored inverse model, without its weights."""

    sha256: Digest
    size_bytes: Count
    manifest: ExperienceManifest


class Description(Message):
    """What a robot is, which agent process serves it, and what it has learned.

    `state_names` is what it measures on every axis; `experiences` are its own, `prior` is what was
    transferred to it, `baseline_known` says whether a flight with that can be guarded. `owner`
    commanded it last under a lease, and `epoch` is that lease's: lower ones are refused.
    """

    robot: Name
    boot_id: Identifier
    spec: RobotSpec
    state_names: tuple[Name, ...] = ()
    experiences: tuple[ExperienceOffer, ...] = ()
    prior: ExperienceOffer | None = None
    baseline_known: bool = False
    owner: Identifier | None = None
    epoch: Epoch = 0


class GoalRequest(Message):
    """Asks for one motion. The same id and content again is the same goal: one motion.

    `acknowledges` names earlier goals whose results arrived, so that the agent may forget them.
    """

    goal_id: Identifier
    owner: Identifier
    epoch: Epoch = 0
    motion: Motion
    acknowledges: Annotated[tuple[Identifier, ...], Field(max_length=64)] = ()


class GoalAccepted(Message):
    """The goal is, or was already, taken; `wall_duration_s` is what it takes on the wall clock."""

    goal_id: Identifier
    boot_id: Identifier
    plan: MotionPlan
    wall_duration_s: NonNegative


class CancelRequest(Message):
    """Asks to end a goal early, with the robot at rest."""

    sender: Identifier
    epoch: Epoch = 0
    goal_id: Identifier


class ResultRequest(Message):
    """Asks for the result of a goal."""

    goal_id: Identifier


class AcknowledgeRequest(Message):
    """Says that these goals' results arrived and may be forgotten."""

    sender: Identifier
    epoch: Epoch = 0
    goal_ids: Annotated[tuple[Identifier, ...], Field(max_length=64)]


class GoalResult(Message):
    """How a goal ended and what was measured: reference and response, of one shape.

    That is (samples,) for a frequency test, which moves one axis, and (samples, axes) for a flight.
    Sample k was taken at k × `plan.sample_time_s` on the robot's own clock. A goal that ended early
    holds the samples up to its end; a completed one holds all of its plan.
    """

    goal_id: Identifier
    boot_id: Identifier
    outcome: Outcome
    reason: Reason
    plan: MotionPlan
    reference: Float64Array
    response: Float64Array
    details: FlightDetails | None = None

    @model_validator(mode="after")
    def _samples_agree(self) -> GoalResult:
        samples = _samples(self.reference, self.response)
        if (self.reference.ndim == 1) != isinstance(self.plan, ExcitationPlan):
            raise ValueError("a test has one column, a flight one for each axis")
        whole = self.plan.samples
        if samples > whole or (self.outcome is Outcome.COMPLETED and samples != whole):
            raise ValueError(f"{samples} samples of a {self.outcome} plan of {whole}")
        return self

    @property
    def test_plan(self) -> ExcitationPlan:
        """The plan of a frequency test; raises MalformedMessageError for any other motion."""
        if not isinstance(self.plan, ExcitationPlan):
            raise MalformedMessageError(f"{self.goal_id} is no frequency test")
        return self.plan


class FetchRequest(Message):
    """Asks for the file of an experience or prior that a robot has."""

    sha256: Digest


class ExperienceFile(Message):
    """A stored experience, as `nufleet.shared.experience.file` reads and writes it."""

    sha256: Digest
    payload: Bytes


class InstallRequest(Message):
    """Gives a robot an experience: as its own, or as the prior that it flies with."""

    sender: Identifier
    epoch: Epoch = 0
    sha256: Digest
    payload: Bytes


class RemovePriorRequest(Message):
    """Takes a robot's prior away."""

    sender: Identifier
    epoch: Epoch = 0


class PredictRequest(Message):
    """Asks an experience for γ at inputs of shape (m, inputs), in the manifest's units."""

    sha256: Digest
    inputs: Float64Array


class Prediction(Message):
    """γ in unit/s, shape (m,)."""

    gamma: Float64Array


class StopRequest(Message):
    """Stops a robot at once and for good, until it is released on purpose."""

    sender: Identifier
    reason: Reason


class ReleaseRequest(Message):
    """Lets a stopped robot move again."""

    sender: Identifier


class Done(Message):
    """The answer yes."""


class RobotState(Message):
    """What a robot publishes of itself: at every change, and twice a second as its heartbeat."""

    robot: Name
    boot_id: Identifier
    sequence: Count
    status: RobotStatus
    goal_id: Identifier | None
    progress: Fraction
    reason: Reason
    last_goal_id: Identifier | None
    robot_time_s: NonNegative


class Telemetry(Message):
    """A batch of a running test's samples, for whoever watches; losing some is allowed."""

    goal_id: Identifier
    first_sample: Count
    sample_time_s: NonNegative
    reference: Float64Array
    response: Float64Array

    @model_validator(mode="after")
    def _samples_agree(self) -> Telemetry:
        _samples(self.reference, self.response)
        return self


class TrackingTelemetry(Message):
    """A batch of samples along a path; shapes (n, axes), `share` (n,), see `TrackingDetails`."""

    goal_id: Identifier
    first_sample: Count
    sample_time_s: NonNegative
    desired: Float64Array
    actual: Float64Array
    prior: Float64Array
    mean: Float64Array
    variance: Float64Array
    share: Float64Array

    @model_validator(mode="after")
    def _samples_agree(self) -> TrackingTelemetry:
        shapes = {a.shape for a in (self.actual, self.prior, self.mean, self.variance)}
        if shapes != {self.desired.shape} or self.desired.shape[:1] != self.share.shape:
            raise ValueError(f"arrays of different shapes: {self.desired.shape} and {shapes}")
        return self


def _samples(reference: FloatArray, response: FloatArray) -> int:
    """Return how many samples two arrays hold; raise ValueError unless both hold as many."""
    if reference.ndim > 2 or reference.shape != response.shape:
        raise ValueError(
            "reference and response must have one shape, (samples,) or (samples, axes), "
            f"got {reference.shape} and {response.shape}"
        )
    return len(reference)
