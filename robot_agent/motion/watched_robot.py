"""A robot whose driver is watched: a call that does not return is detected and named."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, wait
from contextlib import contextmanager
from dataclasses import dataclass

from nufleet.robot_agent.motion.pace import GAP_MAX_S
from nufleet.robot_agent.robot import Record, Robot, RobotAround
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotDownError, RobotError

SLOW_CALL_MAX_S = 60.0
"""Time limit of one call that connects, comes to rest, or simulates as fast as possible."""

LETTING_GO_LOOK_S = 0.1
"""Interval between checks on a driver that is disconnecting its robot."""

LATE_SAMPLES = 1.0
"""How many sample times after its turn a sample begins that counts as late."""

LOOK_MAX_S = 1.0
"""Longest time counted between two checks on the driver; if more has passed, the whole process was
frozen, not the driver alone."""


@dataclass(eq=False)
class _Call:
    """A driver call in progress, and for how long the checks have found it in progress."""

    what: str
    """Name of the method called."""

    allowed_s: float
    """Time that the call may take."""

    seen_s: float = 0.0
    """Time for which the checks have found it in progress."""

    hangs: bool = False
    """Whether it has taken longer than it may."""


class WatchedRobot(RobotAround):
    """Passes every call on to a driver, one at a time.

    No other thread can end a call. A robot whose driver hangs therefore cannot be brought to rest
    from here; it can only be reported, or its motors cut. A robot that is down (`RobotDownError`)
    is asked for nothing until it is connected again.

    `late_samples` counts the samples of a real robot, all since it was made, that began later than
    `LATE_SAMPLES` after their turn, which is one sample time after the previous one.
    """

    def __init__(self, robot: Robot, *, realtime: float | None) -> None:
        """Watch a robot.

        Args:
            robot: The driver, disconnected.
            realtime: Multiple of real time at which a simulated robot plays; None when it is not
                paced.
        """
        super().__init__(robot)
        free = realtime is None and robot.spec.simulated
        self._sample_max_s = SLOW_CALL_MAX_S if free else GAP_MAX_S + robot.spec.sample_time_s
        self._busy = threading.Lock()
        self._call: _Call | None = None
        self._looked_s = time.monotonic()
        self._down: str | None = None
        self._stepped_s: float | None = None
        self.late_samples = 0

    @property
    def hangs(self) -> bool:
        """True while a call that was found to hang has not returned."""
        call = self._call
        return call is not None and call.hangs

    def look(self) -> str | None:
        """Check the call in progress; to be called regularly.

        Returns:
            A description of the call that hangs; None when there is none.
        """
        now_s = time.monotonic()
        passed_s, self._looked_s = min(now_s - self._looked_s, LOOK_MAX_S), now_s
        call = self._call
        if call is None:
            return None
        call.seen_s += passed_s
        call.hangs = call.seen_s > call.allowed_s
        if not call.hangs:
            return None
        return f"the driver has not returned from {call.what!r} for {call.seen_s:.1f} s"

    def connect(self) -> None:
        """Connect; raises RobotError."""
        self._down = None
        with self._calling("connect", SLOW_CALL_MAX_S):
            self._robot.connect()

    def begin(self) -> None:
        """Get the robot ready to move."""
        with self._calling("begin", SLOW_CALL_MAX_S):
            self._robot.begin()

    def end(self) -> None:
        """End what `begin` began."""
        with self._calling("end", SLOW_CALL_MAX_S):
            self._robot.end()

    def record(self) -> Record | None:
        """Return the measurements of the motion just played."""
        with self._calling("record", self._sample_max_s):
            return self._robot.record()

    def kill(self) -> None:
        """Cut the motors, also during another call; raises RobotError if that fails.

        A robot without such a switch stays as it is.
        """
        self._robot.kill()
        self._down = "its motors were cut"

    def measure_output(self) -> FloatArray:
        """Measure the output at rest, shape (axes,)."""
        with self._calling("measure_output", self._sample_max_s):
            return self._robot.measure_output()

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample; reference and output have shape (axes,)."""
        with self._calling("step", self._sample_max_s):
            self._note_step(time.monotonic())
            return self._robot.step(reference)

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a whole reference signal; references and outputs have shape (samples, axes)."""
        lasts_s = len(references) * self._robot.spec.sample_time_s
        with self._calling("run", self._sample_max_s + lasts_s):
            return self._robot.run(references)

    def run_observed(
        self, references: FloatArray, observed: Sequence[int]
    ) -> tuple[FloatArray, FloatArray]:
        """Follow a whole reference signal, and observe the states before some of its samples."""
        lasts_s = len(references) * self._robot.spec.sample_time_s
        with self._calling("run", self._sample_max_s + lasts_s):
            return self._robot.run_observed(references, observed)

    def observe(self) -> FloatArray:
        """Measure the state now, shape (axes, states)."""
        with self._calling("observe", self._sample_max_s):
            return self._robot.observe()

    def rest(self) -> None:
        """Bring the robot to rest."""
        with self._calling("rest", SLOW_CALL_MAX_S):
            self._stepped_s = None
            self._robot.rest()

    def disconnect(self) -> None:
        """Release the robot; raises RobotError while another call is in progress."""
        with self._calling("disconnect", SLOW_CALL_MAX_S, down_too=True):
            self._robot.disconnect()

    def let_go(self) -> None:
        """Disconnect for good, without waiting for a driver that does not return.

        Raises:
            RobotError: The driver hangs, so the robot may not be at rest.
        """
        done: Future[None] = Future()

        def disconnect() -> None:
            try:
                self.disconnect()
            except BaseException as error:  # noqa: BLE001 - raised where it is waited for
                done.set_exception(error)
            else:
                done.set_result(None)

        threading.Thread(target=disconnect, name="disconnecting", daemon=True).start()
        while not wait((done,), LETTING_GO_LOOK_S).done:
            hang = self.look()
            if hang is not None:
                raise RobotError(f"{hang}; the robot may not be at rest")
        done.result()

    def _note_step(self, now_s: float) -> None:
        spec, before_s = self._robot.spec, self._stepped_s
        self._stepped_s = now_s
        if before_s is None or spec.simulated:
            return
        self.late_samples += now_s - before_s > (1 + LATE_SAMPLES) * spec.sample_time_s

    @contextmanager
    def _calling(self, what: str, allowed_s: float, *, down_too: bool = False) -> Iterator[None]:
        if self._down is not None and not down_too:
            raise RobotDownError(self._down)
        if not self._busy.acquire(blocking=False):
            call = self._call
            raise RobotError(
                f"{what!r} cannot be called: the driver has not returned from "
                f"{'another call' if call is None else repr(call.what)}, "
                "so the robot may not be at rest"
            )
        self._call = _Call(what, allowed_s)
        try:
            yield
        except RobotDownError as error:
            self._down = str(error)
            raise
        finally:
            self._call = None
            self._busy.release()
