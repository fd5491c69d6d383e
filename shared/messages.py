"""Every message between an orchestrator and a robot's agent."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

from pydantic import Field, model_validator

from shared.arrays import FloatArray
from shared.codec import Float64Array, Message
from shared.excitation import Excitation, ExcitationPlan
from shared.robot_spec import RobotSpec
from shared.strict import Identifier, Name, NonNegative, Reason

Count = Annotated[int, Field(ge=0)]
Fraction = Annotated[float, Field(ge=0, le=1)]


class RobotStatus(StrEnum):
    """What a robot is doing."""

    IDLE = "idle"
    RUNNING = "running"
    RESTING = "resting"
    STOPPED = "stopped"
    FAULT = "fault"


class Outcome(StrEnum):
    """How a goal ended."""

    COMPLETED = "completed"
    CANCELLED = "cancelled"
    ABORTED = "aborted"
    FAILED = "failed"


class Refusal(Message):
    """The answer no: `code` for programs, `reason` for people."""

    code: Name
    reason: Reason


class DescribeRequest(Message):
    """Asks a robot what it is."""


class Description(Message):
    """What a robot is, which agent process serves it, and whether it is free."""

    robot: Name
    boot_id: Identifier
    spec: RobotSpec


class GoalRequest(Message):
    """Asks for one motion. The same id and content again is the same goal: one motion.

    `acknowledges` names earlier goals whose results arrived, so that the agent may forget them.
    """

    goal_id: Identifier
    owner: Identifier
    excitation: Excitation
    acknowledges: Annotated[tuple[Identifier, ...], Field(max_length=64)] = ()


class GoalAccepted(Message):
    """The goal is, or was already, taken; `wall_duration_s` is what it takes on the wall clock."""

    goal_id: Identifier
    boot_id: Identifier
    plan: ExcitationPlan
    wall_duration_s: NonNegative


class CancelRequest(Message):
    """Asks to end a goal early, with the robot at rest."""

    goal_id: Identifier


class ResultRequest(Message):
    """Asks for the result of a goal."""

    goal_id: Identifier


class AcknowledgeRequest(Message):
    """Says that these goals' results arrived and may be forgotten."""

    goal_ids: Annotated[tuple[Identifier, ...], Field(max_length=64)]


class GoalResult(Message):
    """How a goal ended and what was measured: reference and response, shape (samples,) each.

    Sample k was taken at k × `plan.sample_time_s` on the robot's own clock. A goal that ended early
    holds the samples up to its end; a completed one holds all of its plan.
    """

    goal_id: Identifier
    boot_id: Identifier
    outcome: Outcome
    reason: Reason
    plan: ExcitationPlan
    reference: Float64Array
    response: Float64Array

    @model_validator(mode="after")
    def _samples_agree(self) -> GoalResult:
        samples = _samples(self.reference, self.response)
        whole = self.plan.samples
        if samples > whole or (self.outcome is Outcome.COMPLETED and samples != whole):
            raise ValueError(f"{samples} samples of a {self.outcome} plan of {whole}")
        return self


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
    """A batch of a running goal's samples, for whoever watches; losing some is allowed."""

    goal_id: Identifier
    first_sample: Count
    sample_time_s: NonNegative
    reference: Float64Array
    response: Float64Array

    @model_validator(mode="after")
    def _samples_agree(self) -> Telemetry:
        _samples(self.reference, self.response)
        return self


def _samples(reference: FloatArray, response: FloatArray) -> int:
    """Return how many samples two arrays hold; raise ValueError unless both hold as many."""
    if reference.ndim != 1 or reference.shape != response.shape:
        raise ValueError(
            "reference and response must have one shape (samples,), "
            f"got {reference.shape} and {response.shape}"
        )
    return len(reference)
