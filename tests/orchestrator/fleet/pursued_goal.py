"""One goal, pursued on a clock of its own, by a test that says what happens to it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from nufleet.orchestrator.fleet.goal_events import (
    Accepted,
    Ask,
    Ended,
    Event,
    Fetched,
    Heard,
    Passed,
    Question,
    Refused,
    Sighting,
    Unanswered,
)
from nufleet.orchestrator.fleet.goal_pursuit import Pursuit
from nufleet.shared.errors import NoReplyError, RefusedError
from nufleet.shared.frequency_test.excitation import ExcitationPlan, Tone
from nufleet.shared.wire.messages import GoalAccepted, GoalResult, Outcome, RobotState, RobotStatus

PLAN = ExcitationPlan(
    axis="x",
    tones=(Tone(omega_rad_s=1.0),),
    amplitude=0.1,
    sample_time_s=0.01,
    ramp_samples=2,
    settle_samples=1,
    segments=3,
    segment_samples=4,
)
GOAL = "study.1.r1.1"
EARLIER = "study.0.r1.1"
BEGAN_S = 1000.0
HEARTBEAT_S = 0.5


def state(
    goal_id: str | None = GOAL,
    *,
    last_goal_id: str | None = None,
    progress: float = 0.0,
    boot_id: str = "boot-1",
) -> Heard:
    """The robot says which goal moves it, and which one did before."""
    return Heard(
        RobotState(
            robot="r1",
            boot_id=boot_id,
            sequence=1,
            status=RobotStatus.IDLE if goal_id is None else RobotStatus.RUNNING,
            goal_id=goal_id,
            progress=progress,
            reason="",
            last_goal_id=last_goal_id,
            robot_time_s=0.0,
        )
    )


def accepted(*, wall_duration_s: float = 27.0) -> Accepted:
    return Accepted(
        GoalAccepted(goal_id=GOAL, boot_id="boot-1", plan=PLAN, wall_duration_s=wall_duration_s)
    )


def fetched(outcome: Outcome = Outcome.COMPLETED) -> Fetched:
    return Fetched(
        GoalResult(
            goal_id=GOAL,
            boot_id="boot-1",
            outcome=outcome,
            reason="",
            plan=PLAN,
            reference=np.zeros(PLAN.samples),
            response=np.zeros(PLAN.samples),
        )
    )


def refused(question: Question, code: str) -> Refused:
    return Refused(question, RefusedError(code, f"for the reason {code}", "r1"))


def lost(question: Question) -> Unanswered:
    return Unanswered(question, NoReplyError(f"robot r1 did not answer {question}"))


class PursuedGoal:
    """A pursuit that is woken in time; it asks nothing twice at a time, and ends once."""

    def __init__(
        self, *, alive: bool = True, taken_before: bool = False, abandoned: Iterable[str] = ()
    ) -> None:
        self.now_s = BEGAN_S
        self.asked: list[Ask] = []
        self.open: dict[Question, str] = {}
        self.ended_s: float | None = None
        self.ended_by: Event | None = None
        sighting = Sighting(alive, BEGAN_S) if alive else Sighting(alive)
        self.pursuit = Pursuit(
            "r1", GOAL, sighting, BEGAN_S, taken_before=taken_before, abandoned=abandoned
        )
        self.happens(Passed())

    @property
    def ended(self) -> Ended | None:
        return self.pursuit.ended

    @property
    def error(self) -> str:
        """Why there is no result."""
        assert self.ended is not None
        return str(self.ended.error)

    def happens(self, *events: Event) -> list[Question]:
        """Let things happen now; return what is asked at that."""
        before = len(self.asked)
        for event in events:
            self._take(event)
        return [ask.question for ask in self.asked[before:]]

    def passes(self, time_s: float) -> list[Question]:
        """Let time pass in which nothing happens; return what is asked meanwhile."""
        before = len(self.asked)
        until_s = self.now_s + time_s
        while (wake_s := self.pursuit.wake_s) <= until_s:
            self.now_s = max(self.now_s, wake_s)
            self._take(Passed())
            assert self.ended is not None or self.pursuit.wake_s > self.now_s, "a busy loop"
        self.now_s = until_s
        return [ask.question for ask in self.asked[before:]]

    def freezes(self, time_s: float) -> None:
        """Let time pass in which the orchestrator does not run."""
        self.now_s += time_s

    def beats(self, time_s: float, heard: Heard) -> list[Question]:
        """Let time pass in which the robot says the same at each heartbeat."""
        before = len(self.asked)
        for _ in range(round(time_s / HEARTBEAT_S)):
            self.passes(HEARTBEAT_S)
            self.happens(heard)
        return [ask.question for ask in self.asked[before:]]

    def _take(self, event: Event) -> None:
        ended = self.ended
        question = getattr(event, "question", None)
        if question is not None:
            self.open.pop(question, None)
        asks = self.pursuit.take(event, self.now_s)
        assert ended is None or (self.ended is ended and not asks)
        if ended is None and self.ended is not None:
            self.ended_s, self.ended_by = self.now_s, event
        for ask in asks:
            assert ask.question not in self.open, "asked twice at a time"
            self.open[ask.question] = ask.goal_id
            self.asked.append(ask)


def running() -> PursuedGoal:
    """A goal that its robot has taken and plays."""
    goal = PursuedGoal()
    goal.happens(accepted(), state())
    return goal
