"""Plain values of a goal's pursuit: its events, the questions to its robot, and how it ends."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum
from typing import ClassVar

from nufleet.shared.errors import NufleetError, RefusedError
from nufleet.shared.wire.messages import GoalAccepted, GoalResult, RobotState


class Question(StrEnum):
    """The kinds of questions to a robot; at most one of each kind is open at a time."""

    GOAL = "goal"
    RESULT = "result"
    CANCEL = "cancel"


# Events.


@dataclass(frozen=True)
class Accepted:
    """The robot has accepted the goal."""

    accepted: GoalAccepted
    """The robot's acceptance, with its plan of the motion."""
    question: ClassVar[Question] = Question.GOAL
    """Question that was answered."""


@dataclass(frozen=True)
class Fetched:
    """The robot returned the goal's result."""

    result: GoalResult
    """Result that the robot returned."""
    question: ClassVar[Question] = Question.RESULT
    """Question that was answered."""


@dataclass(frozen=True)
class CancelTaken:
    """The robot confirmed that the goal ends now, or will never begin."""

    question: ClassVar[Question] = Question.CANCEL
    """Question that was answered."""


@dataclass(frozen=True)
class Refused:
    """The robot answered a question with a refusal."""

    question: Question
    """Question that was answered."""
    error: RefusedError
    """The robot's refusal."""


@dataclass(frozen=True)
class Unanswered:
    """A question remained without an answer: none arrived in time, or it cannot be decoded."""

    question: Question
    """Question that remained open."""
    error: NufleetError
    """Reason why there is no answer."""


@dataclass(frozen=True)
class Heard:
    """The robot published its state."""

    state: RobotState
    """State that the robot published."""


@dataclass(frozen=True)
class TokenLost:
    """The robot's liveliness token disappeared."""


@dataclass(frozen=True)
class TokenBack:
    """The robot's liveliness token reappeared."""


@dataclass(frozen=True)
class InterruptAsked:
    """The goal is to end, or must never begin, because of Ctrl-C or a lost lease."""


@dataclass(frozen=True)
class Passed:
    """Time passed, and nothing else happened."""


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
    """A question to be put to the robot; exactly one of its answers must come back as an event."""

    question: Question
    """Question to put."""
    goal_id: str
    """Id of the goal that the question is about."""


@dataclass(frozen=True)
class Ended:
    """The end of a pursuit: a result, or the reason why there is none."""

    result: GoalResult | None = None
    """Result that the robot returned."""
    error: NufleetError | None = None
    """Reason why there is no result, unless the pursuit was only interrupted."""
    interrupted: bool = False
    """Whether the pursuit ended without a result after an interruption."""
    abandoned: tuple[str, ...] = ()
    """Ids of the goals that may still move the robot, since it did not confirm their end."""


@dataclass(frozen=True)
class Sighting:
    """What is known of a robot when a pursuit begins."""

    alive: bool
    """Whether the robot's liveliness token is present."""
    heard_s: float = -math.inf
    """Monotonic time at which the robot was last heard, in s; −∞ if never."""
