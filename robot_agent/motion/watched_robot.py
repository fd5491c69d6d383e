"""A robot whose driver is watched: a call that does not return is noticed, and named."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from concurrent.futures import Future, wait
from contextlib import contextmanager
from dataclasses import dataclass

from nufleet.robot_agent.motion.pace import GAP_MAX_S
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.robots.spec import RobotSpec

SLOW_CALL_MAX_S = 60.0
"""What connecting, coming to rest and simulating as fast as possible may take at a time."""

LETTING_GO_LOOK_S = 0.1
"""How often a driver that is to let go of its robot is looked at."""

LOOK_MAX_S = 1.0
"""Two looks further apart count as this: the whole process was frozen, not the driver alone."""


@dataclass(eq=False)
class _Call:
    """A call of the driver that is in progress, and for how long it has been seen to be."""

    what: str
    allowed_s: float
    seen_s: float = 0.0
    hangs: bool = False


class WatchedRobot(Robot):
    """Passes every call on to a driver, one at a time.

    No other thread can end a call. So a robot that hangs cannot be brought to rest from here; what
    can be done is to say so.
    """

    def __init__(self, robot: Robot, *, realtime: float | None) -> None:
        """Watch a robot; a simulated one plays at this multiple of real time, None for any."""
        self._robot = robot
        free = realtime is None and robot.spec.simulated
        self._sample_max_s = SLOW_CALL_MAX_S if free else GAP_MAX_S + robot.spec.sample_time_s
        self._busy = threading.Lock()
        self._call: _Call | None = None
        self._looked_s = time.monotonic()

    @property
    def spec(self) -> RobotSpec:
        """The driver's own."""
        return self._robot.spec

    @property
    def state_names(self) -> tuple[str, ...]:
        """The driver's own."""
        return self._robot.state_names

    @property
    def hangs(self) -> bool:
        """Whether a call was found to hang and has not returned since."""
        call = self._call
        return call is not None and call.hangs

    def look(self) -> str | None:
        """Return what is wrong with a call that hangs; to be asked regularly."""
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
        with self._calling("connect", SLOW_CALL_MAX_S):
            self._robot.connect()

    def measure_output(self) -> FloatArray:
        """Measure the output at rest."""
        with self._calling("measure_output", self._sample_max_s):
            return self._robot.measure_output()

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample."""
        with self._calling("step", self._sample_max_s):
            return self._robot.step(reference)

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a whole reference signal."""
        lasts_s = len(references) * self._robot.spec.sample_time_s
        with self._calling("run", SLOW_CALL_MAX_S + lasts_s):
            return self._robot.run(references)

    def observe(self) -> FloatArray:
        """Measure the state now."""
        with self._calling("observe", self._sample_max_s):
            return self._robot.observe()

    def rest(self) -> None:
        """Bring the robot to rest."""
        with self._calling("rest", SLOW_CALL_MAX_S):
            self._robot.rest()

    def disconnect(self) -> None:
        """Let go of the robot; raises RobotError while another call is in progress."""
        with self._calling("disconnect", SLOW_CALL_MAX_S):
            self._robot.disconnect()

    def let_go(self) -> None:
        """Disconnect for good, without waiting for a driver that does not return.

        Raises:
            RobotError: the driver hangs, so that the robot may not be at rest.
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

    @contextmanager
    def _calling(self, what: str, allowed_s: float) -> Iterator[None]:
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
        finally:
            self._call = None
            self._busy.release()
