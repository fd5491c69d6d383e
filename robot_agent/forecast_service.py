"""Answers what error a robot expects along a path, while it stands still.

A forecast is not a goal: it moves nothing, changes nothing that the robot remembers, and needs no
lease. It lasts too long for one reply, so the same request is sent again until all
of its answers are there. A requester that is gone sends no more, and its forecast ends.
"""

from __future__ import annotations

import hashlib
import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from contextlib import suppress

from nufleet.robot_agent.flight.rehearsing import RehearsalTask, write_task
from nufleet.robot_agent.network.endpoint import MAX_LARGE_REQUEST_BYTES
from nufleet.robot_agent.planner import Planner, digest
from nufleet.shared.errors import RefusedError
from nufleet.shared.wire.codec import Message, decode
from nufleet.shared.wire.messages import (
    ForecastRequest,
    Foreseen,
    ForeseenWay,
    PathForecast,
    Refusal,
)
from nufleet.shared.wire.motions import PredictedError, Tracking

PATIENCE_S = 3.0
"""Time after the last request for a forecast until its requester counts as gone."""

REMEMBERED = 256
"""Number of predictions that are remembered until the flights that they are of."""

LESS_URGENT = 5
"""Niceness of the process that rehearses.

A third of the weight of a normal process. With the least, a machine whose processors are all busy
would let the person who ranks wait for minutes.
"""

_log = logging.getLogger(__name__)


class ForecastService:
    """Rehearses flights in a process of their own.

    The endpoint's thread asks for forecasts, and alone begins them. Every other method returns at
    once even while that plans, so that no heartbeat waits.
    """

    def __init__(
        self,
        planner: Planner,
        moving: Callable[[], str | None],
        *,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Prepare to serve.

        Args:
            planner: Planner of the robot's motions, which refuses what the robot would not fly.
            moving: Function that returns the id of the goal in progress; None at rest.
            clock: Clock in s.
        """
        self._planner, self._moving, self._clock = planner, moving, clock
        self._lock = threading.Lock()
        self._job: _Job | None = None
        self._remembered: dict[str, PredictedError] = {}

    def asked(self, payload: bytes) -> Message:
        """Return what has been predicted for a request until now; the first one begins it.

        Args:
            payload: The request, encoded. Everyone who may watch the fleet can send a large one at
                any time, so it is not read while the robot moves.

        Raises:
            MalformedMessageError: The payload is not a request for a forecast.
        """
        goal = self._moving()
        if goal is not None:
            reason = f"running goal {goal}; it rehearses at rest alone"
            return Refusal(code="busy", reason=reason)
        key = hashlib.sha256(payload).hexdigest()
        with self._lock:
            job = self._job
            if job is not None and job.key == key:
                job.asked_s = self._clock()
                return PathForecast(foreseen=job.found())
        if job is not None and job.lasts and self._clock() - job.asked_s <= PATIENCE_S:
            return Refusal(code="busy", reason="it is rehearsing other flights; ask again later")
        request = decode(payload, ForecastRequest, max_bytes=MAX_LARGE_REQUEST_BYTES)
        self.end()
        job = self._begun(key, request)
        with self._lock:
            # A busy machine may have taken seconds to start the process, and its requester waited.
            job.asked_s, self._job = self._clock(), job
        return PathForecast(foreseen=job.found())

    def foretold(self, motion: Tracking) -> PredictedError | None:
        """Return the error that was last predicted for a flight; None if it never was."""
        key = digest(motion)
        with self._lock:
            return self._remembered.get(key)

    def look(self) -> None:
        """End a forecast whose requester is gone; to be called regularly."""
        with self._lock:
            job = self._job
            if job is None or self._clock() - job.asked_s <= PATIENCE_S:
                return
            self._job = None
        job.end()

    def end(self) -> None:
        """End the forecast in progress, since the robot is about to move; returns at once."""
        self._ended()

    def close(self) -> None:
        """End the forecast in progress, and wait until its process is gone."""
        job = self._ended()
        if job is not None:
            job.join()

    def _ended(self) -> _Job | None:
        with self._lock:
            job, self._job = self._job, None
        if job is not None:
            job.end()
        return job

    def _begun(self, key: str, request: ForecastRequest) -> _Job:
        planner, memory = self._planner, self._planner.memory
        refused = [self._refused(way, request) for way in request.ways]
        records, priors = memory.exported()
        if not memory.flown_s:
            reason = "it knows nothing of itself yet: let it fly a path, or a rich flight, first"
            nothing = Foreseen(code="no-own-model", reason=reason)
            refused = [found or nothing for found in refused]
        job = _Job(key, request, refused, self._keep, self._clock())
        open_ways = tuple(
            way for way, found in zip(request.ways, refused, strict=True) if found is None
        )
        if open_ways:
            task = RehearsalTask(
                spec=planner.spec,
                state_names=planner.state_names,
                records=records,
                priors=len(priors),
                desired=request.desired,
                ways=open_ways,
            )
            job.begin(task, priors)
        return job

    def _refused(self, way: ForeseenWay, request: ForecastRequest) -> Foreseen | None:
        motion = way.along(request.desired)
        try:
            if way.after_rich_flight_s:
                # What it does not know yet, it may know after that flight.
                motion = Tracking(desired=request.desired, inverse="baseline")
            self._planner.plan(motion)
        except RefusedError as error:
            return Foreseen(code=error.code, reason=error.reason)
        return None

    def _keep(self, request: ForecastRequest, way: ForeseenWay, found: Foreseen) -> None:
        if found.predicted is None or way.after_rich_flight_s:
            return
        key = digest(way.along(request.desired))
        with self._lock:
            self._remembered.pop(key, None)
            self._remembered[key] = found.predicted
            while len(self._remembered) > REMEMBERED:
                del self._remembered[next(iter(self._remembered))]


class _Job:
    """One forecast, and the process that makes it."""

    def __init__(
        self,
        key: str,
        request: ForecastRequest,
        refused: Sequence[Foreseen | None],
        keep: Callable[[ForecastRequest, ForeseenWay, Foreseen], None],
        asked_s: float,
    ) -> None:
        """Prepare.

        Args:
            key: Digest of the request.
            request: What was asked for.
            refused: Why a way cannot be flown, for every way of the request; None where it can.
            keep: Function that takes every prediction as it comes.
            asked_s: Time of the latest request for it, in s, which its owner keeps up to date.
        """
        self.key, self.asked_s = key, asked_s
        self._request, self._found, self._keep = request, list(refused), keep
        self._process: subprocess.Popen[bytes] | None = None
        self._thread: threading.Thread | None = None
        self._ended = False

    def begin(self, task: RehearsalTask, priors: Sequence[bytes]) -> None:
        """Have a process rehearse the ways that are not refused; returns at once."""
        try:
            self._process = process = _started()
        except OSError as error:
            self._fail(f"its rehearsal could not begin: {error}")
            return
        self._thread = threading.Thread(
            target=self._work, args=(process, task, priors), name="forecast", daemon=True
        )
        self._thread.start()

    @property
    def lasts(self) -> bool:
        """Whether an answer is still to come."""
        return None in self._found

    def found(self) -> tuple[Foreseen | None, ...]:
        """Return what is known of every way."""
        return tuple(self._found)

    def end(self) -> None:
        """End the process, if it runs; returns at once."""
        self._ended = True
        if self._process is not None:
            self._process.kill()

    def join(self) -> None:
        """Wait until nothing of it is left."""
        if self._thread is not None:
            self._thread.join()

    def _work(
        self, process: subprocess.Popen[bytes], task: RehearsalTask, priors: Sequence[bytes]
    ) -> None:
        failure = "its rehearsal ended early"
        commands, answers = process.stdin, process.stdout
        if commands is None or answers is None:
            raise RuntimeError("the process was started without pipes")
        places = [place for place, found in enumerate(self._found) if found is None]
        try:
            write_task(commands, task, priors)
            for place in places:
                line = answers.readline()
                if not line:
                    break
                found = Foreseen.model_validate_json(line)
                self._keep(self._request, self._request.ways[place], found)
                self._found[place] = found
        except (OSError, ValueError) as error:
            failure = f"{failure}: {error}"
        finally:
            process.kill()
            with suppress(OSError):
                commands.close()  # which first writes what the process no longer takes
            answers.close()
            process.wait()
            if self.lasts:
                self._fail(failure)

    def _fail(self, reason: str) -> None:
        """Answer what is still open with the reason why nothing came of it."""
        if not self._ended:
            _log.warning("a forecast failed: %s", reason)
        nothing = Foreseen(code="rehearsal", reason=reason)
        self._found = [found or nothing for found in self._found]


def _started() -> subprocess.Popen[bytes]:
    # One thread each: a companion computer has other work, and small matrices gain nothing.
    environment = {**os.environ, "OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    process = subprocess.Popen(
        [sys.executable, "-P", "-m", "nufleet.robot_agent.flight.rehearsing"],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        env=environment,
        start_new_session=True,  # a Ctrl-C is for the agent, which ends it
    )
    # At once, since its imports alone take seconds. An agent may run with real-time priority, which
    # the process has inherited, and to which niceness means nothing.
    if sys.platform == "linux":
        os.sched_setscheduler(process.pid, os.SCHED_BATCH, os.sched_param(0))
    os.setpriority(os.PRIO_PROCESS, process.pid, LESS_URGENT)
    return process
