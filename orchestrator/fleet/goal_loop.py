"""Runs the pursuits of many goals: one thread handles their events, and none waits for a reply.

This module is the shell with all effects around `goal_pursuit`; it makes no decisions itself.
"""

from __future__ import annotations

import logging
import math
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

from nufleet.orchestrator.fleet import goal_events as events
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.goal_events import Ask, Ended, Question
from nufleet.orchestrator.fleet.goal_pursuit import Pursuit
from nufleet.orchestrator.fleet.requests import Reply
from nufleet.orchestrator.fleet.robot_watch import RobotWatch
from nufleet.shared.errors import NufleetError, RefusedError
from nufleet.shared.wire.messages import GoalAccepted, GoalRequest, GoalResult

TICK_S = 0.05
"""Interval at which pursuits are checked for deadlines, in s."""

REPLIES_S = 0.002
REPLIES_EACH_S = 1e-4
"""Interval at which the replies to open questions are looked for, in s, and how much longer it is
for each of them, so that looking takes about a hundredth of a processor at most."""

_LOOK_S = 0.2

ASKING_AT_ONCE = 32
"""Number of goals and results that are asked for at the same time. A process that serves hundreds
of robots is thus asked for further ones only as fast as it answers: if it began all motions at
once, those that it began first would stand still until it has begun the last."""

SLOW_S = 0.5
"""Time after which a question without an answer is no longer counted among them, in s: its robot
may be cut off or frozen, and others are not to wait for that."""

CANCELLING_AT_ONCE = 256
"""Number of cancellations that may be asked for at the same time; they wait for nothing else."""

Answer = Reply[GoalAccepted] | Reply[GoalResult]

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class Errand:
    """A goal to be pursued; its callbacks run on the loop's thread and must return at once."""

    robot: str
    """Name of the robot."""
    request: GoalRequest
    """Request that is sent to the robot."""
    on_accepted: Callable[[GoalAccepted], None]
    """Callback that is called once, when the robot has accepted the goal."""
    on_ended: Callable[[Ended], None]
    """Callback that is called once, when the pursuit has ended."""
    taken_before: bool = False
    """Whether the robot accepted the goal from an earlier orchestrator already."""
    abandoned: Iterable[str] = ()
    """Ids of earlier goals that may still move the robot; they are cancelled first."""


@dataclass(frozen=True)
class _Asked:
    """A question that was put to a robot."""

    run: _Run
    ask: Ask
    answer: Answer
    asked_s: float


class GoalLoop:
    """Pursues errands; a context manager whose exit does not wait for any robot."""

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._inbox: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._askers = ThreadPoolExecutor(CANCELLING_AT_ONCE, thread_name_prefix="ask")
        self._waiting: deque[tuple[_Run, Ask]] = deque()
        self._open: list[_Asked] = []
        self._running: dict[Errand, _Run] = {}
        self._interrupted = False
        self._crash: BaseException | None = None
        self._thread = threading.Thread(target=self._work, name="goals", daemon=True)

    def __enter__(self) -> GoalLoop:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._inbox.put(None)
        self._thread.join()
        self._askers.shutdown(wait=False, cancel_futures=True)

    def begin(self, errand: Errand) -> None:
        """Start pursuing an errand; after an interrupt, the errand ends without being sent."""
        self.post(lambda: self._begin(errand))

    def interrupt(self) -> None:
        """End every errand with its robot at rest, and keep later errands from starting."""
        self.post(self._interrupt)

    @property
    def is_interrupted(self) -> bool:
        """Whether `interrupt` was called."""
        return self._interrupted

    def post(self, job: Callable[[], None]) -> None:
        """Run a job on the loop's thread."""
        self._inbox.put(job)

    def wait_for(self, done: threading.Event) -> None:
        """Wait until an errand's callback sets an event.

        An unexpected error on the loop's thread is raised here, once all robots are at rest.
        """
        while not done.wait(_LOOK_S):
            if self._crash is not None and not self._running:
                break
        if self._crash is not None:
            raise self._crash

    # The loop's thread.

    def _work(self) -> None:
        tick_s = replies_s = -math.inf
        while True:
            now_s = time.monotonic()
            job: Callable[[], None] | None
            if tick_s <= now_s:
                tick_s, job = now_s + TICK_S, self._tick
            elif self._open and replies_s <= now_s:
                replies_s = now_s + REPLIES_S + REPLIES_EACH_S * len(self._open)
                job = self._take_replies
            else:
                until_s = min(tick_s, replies_s) if self._open else tick_s
                try:
                    job = self._inbox.get(timeout=until_s - now_s)
                except queue.Empty:
                    continue
            if job is None:
                break
            try:
                job()
            except Exception as error:  # noqa: BLE001 - no robot may fly on alone for it
                _log.exception("the pursuit of goals failed")
                self._crash = self._crash or error
                self._interrupt()
        for run in self._running.values():
            run.leave()

    def _tick(self) -> None:
        now_s = time.monotonic()
        self._have_taken(
            events.Passed(), (r for r in self._running.values() if r.pursuit.wake_s <= now_s)
        )

    def _begin(self, errand: Errand) -> None:
        run = self._running[errand] = _Run(self, self._fleet, errand)
        run.begin()
        if self._interrupted:
            run.take(events.InterruptAsked())

    def _interrupt(self) -> None:
        self._interrupted = True
        # The robots are asked to forgo the goals that have not been sent yet, as if they had been.
        self._waiting = deque(
            (run, ask) for run, ask in self._waiting if ask.question is not Question.GOAL
        )
        self._have_taken(events.InterruptAsked(), self._running.values())

    def _have_taken(self, event: events.Event, runs: Iterable[_Run]) -> None:
        # One job per pursuit: an error concerning one robot must not keep the event from the
        # others.
        for run in runs:
            self.post(partial(run.take, event))

    def ask(self, run: _Run, ask: Ask) -> None:
        """Ask a question, or let it wait until fewer of its kind are open."""
        if ask.question is Question.CANCEL:
            self._askers.submit(run.cancel, ask)
        else:
            self._waiting.append((run, ask))
            self._ask_waiting()

    def _take_replies(self) -> None:
        asked, self._open = self._open, []
        for one in asked:
            if not one.answer.over():
                self._open.append(one)
            elif one.answer.unsure():
                self._askers.submit(one.run.answer, one.ask, one.answer.take)
            else:
                self.post(partial(one.run.answer, one.ask, one.answer.take))
        self._ask_waiting()

    def _ask_waiting(self) -> None:
        now_s = time.monotonic()
        counted = sum(now_s - one.asked_s < SLOW_S for one in self._open)
        while self._waiting and counted < ASKING_AT_ONCE:
            run, ask = self._waiting.popleft()
            if run.pursuit.ended is None:
                self._open.append(_Asked(run, ask, run.question(ask), now_s))
                counted += 1

    def ended(self, errand: Errand, ended: Ended) -> None:
        """Report the end of an errand and forget it."""
        try:
            errand.on_ended(ended)
        finally:
            del self._running[errand]


class _Run:
    """One pursuit, with the network requests and callbacks that it causes."""

    def __init__(self, loop: GoalLoop, fleet: Fleet, errand: Errand) -> None:
        self._loop = loop
        self._fleet = fleet
        self._errand = errand
        self._watch: RobotWatch = fleet.watch(errand.robot)
        self._unfollow: Callable[[], None] = lambda: None
        self._accepted = False
        self.pursuit: Pursuit

    def begin(self) -> None:
        errand = self._errand
        sighting, self._unfollow = self._watch.follow(
            lambda event: self._loop.post(lambda: self.take(event))
        )
        self.pursuit = Pursuit(
            errand.robot,
            errand.request.goal_id,
            sighting,
            time.monotonic(),
            taken_before=errand.taken_before,
            abandoned=errand.abandoned,
        )
        if not self._loop.is_interrupted:
            self.take(events.Passed())

    def leave(self) -> None:
        """Stop following the robot's states."""
        self._unfollow()

    def take(self, event: events.Event) -> None:
        """Handle an event, and put the questions that follow from it to the robot."""
        if self.pursuit.ended is not None:
            return
        # Questions go out before the callbacks run: an error in a callback must not lose one.
        for ask in self.pursuit.take(event, time.monotonic()):
            self._loop.ask(self, ask)
        if self.pursuit.accepted is not None and not self._accepted:
            self._accepted = True
            self._errand.on_accepted(self.pursuit.accepted)
        if self.pursuit.ended is not None:
            self.leave()
            self._loop.ended(self._errand, self.pursuit.ended)

    def question(self, ask: Ask) -> Answer:
        """Ask for what the robot makes of the goal, or for its result."""
        try:
            if ask.question is Question.GOAL:
                return self._fleet.submit_later(self._errand.robot, self._errand.request)
            return self._fleet.result_later(self._errand.robot, ask.goal_id)
        except Exception as error:  # noqa: BLE001 - a question always has an end
            return _failed(error)

    # Any thread.

    def cancel(self, ask: Ask) -> None:
        """Ask the robot to end a goal, and wait for its answer."""
        self.answer(ask, lambda: self._fleet.cancel(self._errand.robot, ask.goal_id))

    def answer(self, ask: Ask, take: Callable[[], GoalAccepted | GoalResult | None]) -> None:
        """Take the answer to a question, and handle it on the loop's thread."""
        event = self._answer(ask, take)
        self._loop.post(lambda: self.take(event))

    def _answer(
        self, ask: Ask, take: Callable[[], GoalAccepted | GoalResult | None]
    ) -> events.Event:
        robot = self._errand.robot
        try:
            match take():
                case GoalAccepted() as accepted:
                    return events.Accepted(accepted)
                case GoalResult() as result:
                    return events.Fetched(result)
                case None:
                    return events.CancelTaken()
        except RefusedError as error:
            return events.Refused(ask.question, error)
        except NufleetError as error:
            _log.info("%s: asking again", error)
            return events.Unanswered(ask.question, error)
        except Exception as error:  # noqa: BLE001 - a question always has an end
            _log.exception("a request to %s about %s failed", robot, ask.goal_id)
            return events.Unanswered(ask.question, NufleetError(f"asking {robot}: {error!r}"))


def _failed(error: Exception) -> Answer:
    def fail() -> GoalAccepted:
        raise error

    return Reply(lambda: True, fail)
