"""What happens to a goal on its way, what is asked of its robot, and how it ends: plain values."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

from nufleet.shared.errors import NufleetError, RefusedError
from nufleet.shared.wire.messages import GoalAccepted, GoalResult, RobotState


class Question(StrEnum):
    """What is asked of a robot; at most one of each kind is open at a time."""

    GOAL = "goal"
    RESULT = "result"
    CANCEL = "cancel"


# Events: what happened.


@dataclass(frozen=True)
class Accepted:
    """The robot has taken the goal."""

    accepted: GoalAccepted
    question: ClassVar[Question] = Question.GOAL


@dataclass(frozen=True)
class Fetched:
    """The robot says how the goal ended."""

    result: GoalResult
    question: ClassVar[Question] = Question.RESULT


@dataclass(frozen=True)
class CancelTaken:
    """The robot says that the goal ends now, or will never begin."""

    question: ClassVar[Question] = Question.CANCEL


@dataclass(frozen=True)
class Refused:
    """The robot answered a question with a refusal."""

    question: Question
    error: RefusedError


@dataclass(frozen=True)
class Unanswered:
    """A question has no answer: none came in time, or what came is none."""

    question: Question
    error: NufleetError


@dataclass(frozen=True)
class Heard:
    """The robot published its state."""

    state: RobotState


@dataclass(frozen=True)
class TokenLost:
    """The robot's liveliness token disappeared."""


@dataclass(frozen=True)
class TokenBack:
    """The robot's liveliness token is there again."""


@dataclass(frozen=True)
class InterruptAsked:
    """The goal is to end, or must never begin: Ctrl-C, or the lease is lost."""


@dataclass(frozen=True)
class Passed:
    """Nothing but time."""


Event = (
    Accepted
    | Fetched
    | CancelTaken
    | Refused
    | Unanswered
    | Heard
    | TokenLost
    | TokenBack
    | InterruptAsked
    | Passed
)


@dataclass(frozen=True)
class Ask:
    """Ask the robot a question about a goal; one of its answers is to come back as an event."""

    question: Question
    goal_id: str


@dataclass(frozen=True)
class Ended:
    """How a pursuit ended: with a result, or with the reason why there is none.

    `interrupted` says that there is no result because the end was asked for. `abandoned` are the
    goals that may still move the robot, since it has not confirmed the opposite.
    """

    result: GoalResult | None = None
    error: NufleetError | None = None
    interrupted: bool = False
    abandoned: tuple[str, ...] = ()


@dataclass(frozen=True)
class Sighting:
    """What is known of a robot when a pursuit begins; `heard_s` is when it was last heard."""

    alive: bool
    heard_s: float = -math.inf
