"""Pursues one goal on one robot on behalf of its orchestrator: a pure state machine.

It holds no socket, thread or clock. `take` receives an event and the time, and returns the
questions to be put to the robot; `wake_s` is the time of its next deadline; `ended` is set once.

Every rule follows from five facts about the network and the robot:

- A question may be lost, and so may its answer. Asking again is always safe: a goal id moves its
  robot at most once, and a result is kept until it is acknowledged.
- States may be lost or late. A state is therefore only ever a reason to *ask* about the goal; the
  robot's answer decides. A robot that is heard, through any message, is not given up for silence.
- A goal may arrive long after it was sent. It must therefore be expected to begin until the robot
  has confirmed its cancellation; the robot stores the ids of cancelled goals.
- A refused goal may arrive a second time, when what spoke against it is gone. A goal that was sent
  is therefore cancelled also after its final refusal.
- A robot that was given up may return and still be moving. A goal that ended without the robot's
  confirmation is therefore abandoned, not over: before the next goal is sent, the abandoned one is
  cancelled until the robot confirms.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from typing import NamedTuple

from nufleet.orchestrator.fleet import goal_events as events
from nufleet.orchestrator.fleet.goal_events import Ask, Ended, Question, Sighting
from nufleet.orchestrator.fleet.overdue import Overdue
from nufleet.orchestrator.fleet.robot_watch import HEARTBEAT_LOST_S
from nufleet.shared.errors import NufleetError, RefusedError, RobotLostError
from nufleet.shared.wire.messages import GoalAccepted, Outcome, RobotState

RETURN_PATIENCE_S = 10.0
"""Time in s after which a robot that is not heard is given up."""

ANSWER_PATIENCE_S = 300.0
"""Time in s after which a robot that is heard but answers no question is given up."""

ANSWER_TRIES = 10
"""Number of consecutive unanswered questions that such a robot must also have reached."""

REFUSAL_PATIENCE_S = 10.0
"""Time in s for which a refusal is tolerated whose cause is not the goal itself."""

REFUSALS_PATIENCE_S = 30.0
"""Time in s for which such refusals are tolerated in all, if one cause follows another."""

FROZEN_S = 5.0
"""Time in s between two refusals from which on the orchestrator itself did not run: a question is
answered, or counts as unanswered, in less. What the robot refused before may have passed since."""

REST_PATIENCE_S = 90.0
"""Time in s that a robot has to come to rest after a cancel; longer than any driver's `rest`.

A goal waits as long for the end of another motion, since its own is next.
"""

ASK_AGAIN_S = 0.05
LOOK_AGAIN_S = 0.5
"""Interval in s between requests for the result of a goal that is still running: one heartbeat."""

PASSING = frozenset(
    {
        "owner-not-alive",
        "overloaded",
        "shutting-down",
        "two-agents",
        "frozen",
        "not-ready",
        "damaged",
    }
)
"""Codes of refusals whose cause is temporary and not the goal itself.

After a restart of the router, the robot may learn of the goal before it learns that the goal's
owner is alive; an agent that restarts or was frozen accepts the goal a little later. A robot may
lose its position estimate, or its link, for a moment. A question that was altered on its way is not
altered again.
"""

NEVER_BEGINS = frozenset({"goal-ended", "stale-epoch"})
"""Codes of refused cancellations that amount to a confirmation: the goal can no longer move."""


class _Refusals(NamedTuple):
    """Refusals of one question in a row."""

    code: str
    """Code of the latest refusals; empty if the question got no answer after them."""
    since_s: float
    """Time of the first refusal with this code."""
    first_s: float
    """Time of the first refusal."""
    latest_s: float
    """Time of the latest refusal, or of a question after it that got no answer."""


class Pursuit:
    """Pursues one goal until it has ended; the module docstring explains the rules."""

    def __init__(
        self,
        robot: str,
        goal_id: str,
        sighting: Sighting,
        now_s: float,
        *,
        taken_before: bool = False,
        abandoned: Iterable[str] = (),
    ) -> None:
        """Begin a pursuit; `take(Passed(), now_s)` then returns the first questions.

        Args:
            robot: Name of the robot.
            goal_id: Id of the goal.
            sighting: Present knowledge of the robot.
            now_s: Current time in s, on the same clock as all later times.
            taken_before: Whether the robot accepted this goal from an earlier orchestrator. If so,
                the goal is never sent again; only its result is requested.
            abandoned: Ids of goals that may still move this robot; they are cancelled first.
        """
        self.robot = robot
        self.goal_id = goal_id
        self.ended: Ended | None = None
        self.accepted: GoalAccepted | None = None
        self._alive = sighting.alive
        self._heard_s = sighting.heard_s
        self._lost_s = now_s
        self._lost = ""
        self._progress = 0.0
        self._abandoned = list(abandoned)
        self._open: set[Question] = set()
        self._not_before_s: dict[Question, float] = {}
        self._unanswered: tuple[int, float] | None = None
        self._refusals: dict[Question, _Refusals] = {}
        self._sent = False
        self._taken = taken_before
        self._fetch = taken_before
        self._over = False
        self._overdue = Overdue(0.0, now_s)
        self._interrupted = False
        self._given_up: NufleetError | None = None
        self._cancelled_s: float | None = None

    @property
    def wake_s(self) -> float:
        """Time in s at which `take` must be called with `Passed`, if no other event comes first."""
        if self.ended is not None:
            return math.inf
        times = [self._give_up_s, *self._not_before_s.values()]
        if self._taken and not self._fetch:
            times.append(self._heard_s + HEARTBEAT_LOST_S)
        if self._may_be_overdue:
            times.append(self._overdue.deadline_s)
        if self._cancelled_s is not None:
            times.append(self._cancelled_s + REST_PATIENCE_S)
        return min(times)

    def take(self, event: events.Event, now_s: float) -> tuple[Ask, ...]:
        """Handle an event and return the questions to ask now.

        Args:
            event: Event to handle. An answer belongs to the open question of its kind; an answer
                without an open question is ignored.
            now_s: Current time in s; it never decreases.
        """
        if self.ended is None:
            self._note(event, now_s)
        if self.ended is None:
            self._note_time(now_s)
        return () if self.ended is not None else tuple(self._questions(now_s))

    # Handling of events.

    def _note(self, event: events.Event, now_s: float) -> None:
        match event:
            case events.Heard(state):
                self._heard_s = now_s
                self._note_state(state)
            case events.Unanswered(question, error):
                self._note_silence(question, error, now_s)
            case events.TokenLost():
                self._alive = False
                self._lost_s = now_s
                self._lost = f"robot {self.robot} disappeared during {self.goal_id}"
            case events.TokenBack():
                self._alive = True
                self._heard_s = now_s
                # The goal may have ended meanwhile, and the state that said so been lost.
                self._fetch = self._taken
            case events.InterruptAsked():
                self._interrupted = True
                self._end_if_never_sent()
            case events.Passed():
                for question, at_s in tuple(self._not_before_s.items()):
                    if at_s <= now_s:
                        del self._not_before_s[question]
            case _:
                self._note_answer(event, now_s)

    def _note_answer(
        self,
        answer: events.Accepted | events.Fetched | events.CancelTaken | events.Refused,
        now_s: float,
    ) -> None:
        if answer.question not in self._open:
            return
        self._heard_s = now_s
        self._unanswered = None
        self._open.discard(answer.question)
        match answer:
            case events.Accepted(accepted):
                if not self._taken:
                    self._taken, self.accepted = True, accepted
                    self._overdue = Overdue(accepted.wall_duration_s, now_s)
            case events.Fetched(result):
                if self._given_up is None or result.outcome is Outcome.COMPLETED:
                    self.ended = Ended(result=result)
                else:
                    self.ended = Ended(error=self._given_up, interrupted=self._interrupted)
            case events.CancelTaken():
                self._note_cancelled(now_s)
            case events.Refused(question, error):
                self._note_refusal(question, error, now_s)

    def _note_state(self, state: RobotState) -> None:
        if state.goal_id == self.goal_id:
            self._progress = state.progress
        elif self._taken:
            # Either the goal has ended or this state is older than the goal: the robot's answer
            # decides.
            self._fetch = True
            if state.last_goal_id == self.goal_id:
                self._over = True
                self._not_before_s.pop(Question.RESULT, None)

    def _note_cancelled(self, now_s: float) -> None:
        self._refusals.pop(Question.CANCEL, None)
        if self._abandoned:
            self._abandoned.pop(0)
            if self._interrupted:
                self._end_if_never_sent()
        elif self._cancelled_s is None:
            self._cancelled_s = now_s
            self._fetch = True

    def _note_refusal(self, question: Question, error: RefusedError, now_s: float) -> None:
        match question:
            case Question.CANCEL if error.code in NEVER_BEGINS:
                self._note_cancelled(now_s)
            case Question.CANCEL if self._refused_before(error) or self._outlasts(
                question, error.code, REFUSAL_PATIENCE_S, now_s
            ):
                self._give_up(error)
            case Question.RESULT if error.code == "not-finished":
                self._fetch = self._cancelled_s is not None
                self._not_before_s[question] = now_s + LOOK_AGAIN_S
            case Question.RESULT if error.code not in PASSING and not self._may_begin_yet:
                self._end_without_result(error)
            case Question.GOAL if not self._taken and not self._interrupted:
                self._note_goal_refused(error, now_s)
            case _:
                self._not_before_s[question] = now_s + ASK_AGAIN_S

    def _note_goal_refused(self, error: RefusedError, now_s: float) -> None:
        passes_s = REFUSAL_PATIENCE_S if error.code in PASSING else 0.0
        patience_s = REST_PATIENCE_S if error.code == "busy" else passes_s
        if not self._outlasts(Question.GOAL, error.code, patience_s, now_s):
            self._not_before_s[Question.GOAL] = now_s + ASK_AGAIN_S
        else:
            # A copy of the goal may still be under way, and find the robot willing when it arrives.
            self._given_up = error

    def _refused_before(self, error: RefusedError) -> bool:
        """Return whether the goal itself was finally refused for the same reason."""
        refused = self._given_up
        return isinstance(refused, RefusedError) and refused.code == error.code

    def _outlasts(self, question: Question, code: str, patience_s: float, now_s: float) -> bool:
        """Return whether a question has been refused for one reason for at least `patience_s`.

        Another reason is another trouble, which may pass as well; but a robot that finds one reason
        after another is not asked for ever.
        """
        earlier = self._refusals.get(question)
        if earlier is None or now_s - earlier.latest_s > FROZEN_S:
            earlier = _Refusals(code, now_s, now_s, now_s)
        since_s = earlier.since_s if code == earlier.code else now_s
        self._refusals[question] = _Refusals(code, since_s, earlier.first_s, now_s)
        longest_s = max(patience_s, REFUSALS_PATIENCE_S)
        return now_s >= min(since_s + patience_s, earlier.first_s + longest_s)

    def _note_silence(self, question: Question, error: NufleetError, now_s: float) -> None:
        if question not in self._open:
            return
        self._open.discard(question)
        self._not_before_s[question] = now_s + ASK_AGAIN_S
        if question in self._refusals:
            # What was refused before the silence may have passed, and have come again.
            self._refusals[question] = self._refusals[question]._replace(code="", latest_s=now_s)
        tries, since_s = self._unanswered or (0, now_s)
        self._unanswered = (tries + 1, since_s)
        if tries + 1 >= ANSWER_TRIES and now_s - since_s >= ANSWER_PATIENCE_S:
            self._give_up(error)

    # Deadlines.

    @property
    def _give_up_s(self) -> float:
        return max(self._heard_s, self._lost_s) + RETURN_PATIENCE_S

    def _note_time(self, now_s: float) -> None:
        overdue, cancelled_s = self._overdue, self._cancelled_s
        if now_s >= self._give_up_s:
            self._give_up(RobotLostError(self._silent(now_s)))
        elif cancelled_s is not None and now_s >= cancelled_s + REST_PATIENCE_S:
            reason = (
                f"robot {self.robot} was told to end {self.goal_id} but is not at rest after "
                f"{REST_PATIENCE_S:g} s; stop it, and check whether its driver hangs"
            )
            self._give_up(RobotLostError(reason))
        elif self._may_be_overdue and overdue.is_late(self._progress, now_s):
            # The robot is still heard, so it can be brought to rest before it is given up.
            self._given_up = RobotLostError(
                f"robot {self.robot} is overdue with {self.goal_id}: for {overdue.grace_s:.0f} s "
                f"it got no further than {overdue.progress:.0%}; check whether its agent hangs"
            )
        if self._taken and now_s >= self._heard_s + HEARTBEAT_LOST_S:
            # The robot's states do not arrive, but its answers may.
            self._fetch = True

    def _silent(self, now_s: float) -> str:
        if not self._sent and not self._taken:
            return (
                f"robot {self.robot} is gone and did not return for goal {self.goal_id} within "
                f"{RETURN_PATIENCE_S:g} s; is its agent running?"
            )
        if self._lost and not self._alive:
            return f"{self._lost}, and it did not return"
        return (
            f"robot {self.robot} went silent during {self.goal_id}: nothing was heard of it for "
            f"{now_s - max(self._heard_s, self._lost_s):.1f} s"
        )

    # Ends of the pursuit.

    def _end_if_never_sent(self) -> None:
        if not self._sent and not self._taken and not self._abandoned:
            self.ended = Ended(interrupted=True)

    def _end_without_result(self, error: RefusedError) -> None:
        if self._interrupted or self._given_up is not None:
            self.ended = Ended(error=self._given_up, interrupted=self._interrupted)
        else:
            lost = self._lost or (
                f"robot {self.robot} had accepted {self.goal_id}, but its agent may have restarted"
            )
            self.ended = Ended(error=RobotLostError(f"{lost}: {error.reason}"))

    def _give_up(self, error: NufleetError) -> None:
        own = (self.goal_id,) if self._sent or self._taken else ()
        self.ended = Ended(
            error=self._given_up or error,
            interrupted=self._interrupted,
            abandoned=(*self._abandoned, *own),
        )

    # Questions to the robot.

    @property
    def _may_be_overdue(self) -> bool:
        return self._taken and not self._over and not self._cancelling

    @property
    def _cancelling(self) -> bool:
        return self._interrupted or self._given_up is not None

    @property
    def _may_begin_yet(self) -> bool:
        """Whether the goal is being cancelled and the robot has not confirmed it yet."""
        return self._cancelling and self._cancelled_s is None

    def _questions(self, now_s: float) -> Iterator[Ask]:
        is_there = self._alive or self._heard_s > self._lost_s
        if self._may_begin_yet and not self._abandoned:
            yield from self._ask(Question.CANCEL, self.goal_id, now_s)
        if not is_there:
            return
        if self._abandoned:
            yield from self._ask(Question.CANCEL, self._abandoned[0], now_s)
            return
        if not self._taken and not self._cancelling:
            for ask in self._ask(Question.GOAL, self.goal_id, now_s):
                self._sent = True
                yield ask
        if self._fetch:
            yield from self._ask(Question.RESULT, self.goal_id, now_s)

    def _ask(self, question: Question, goal_id: str, now_s: float) -> Iterator[Ask]:
        if question in self._open or now_s < self._not_before_s.get(question, -math.inf):
            return
        self._open.add(question)
        self._not_before_s.pop(question, None)
        yield Ask(question, goal_id)
