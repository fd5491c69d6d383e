"""Tells drones where a motion capture system sees them, through the package `motioncapture`."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from nufleet.robot_agent.drivers.crazyflie.settings import MotionCaptureSettings
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError

OnPose = Callable[[FloatArray, FloatArray], None]
"""Callback that receives a position, shape (3,) in m, and a quaternion, shape (4,), x, y, z, w."""

_log = logging.getLogger(__name__)


def connect_to(system: str, hostname: str) -> Any:
    """Connect to a motion capture system.

    Raises:
        RobotError: The package is not installed, or the system is not reached.
    """
    try:
        import motioncapture
    except ImportError as error:
        raise RobotError(
            "motion capture needs a package: pip install 'nufleet[crazyflie]'"
        ) from error
    try:
        return motioncapture.connect(system, {"hostname": hostname})
    except Exception as error:
        raise RobotError(f"the {system} system at {hostname} was not reached: {error}") from error


class MotionCapture:
    """One motion capture system, for all drones of this process that it sees."""

    def __init__(
        self, system: str, hostname: str, connect: Callable[[str, str], Any] = connect_to
    ) -> None:
        """Prepare for a system.

        Args:
            system: Kind of system.
            hostname: Host of its server.
            connect: Function that connects to it: `waitForNextFrame` of what it returns blocks,
                and `rigidBodies` has the bodies of the frame by name.
        """
        self._where = (system, hostname)
        self._connect = connect
        self._lock = threading.Lock()
        self._watchers: dict[str, OnPose] = {}
        self._thread: threading.Thread | None = None
        self._failure: str | None = None
        self._seen: frozenset[str] = frozenset()
        self._unsent: set[str] = set()

    @property
    def failure(self) -> str | None:
        """Reason why the system no longer delivers poses; None while it does."""
        return self._failure

    @property
    def bodies(self) -> frozenset[str]:
        """Names of the bodies in the last frame."""
        return self._seen

    def watch(self, body: str, on_pose: OnPose) -> None:
        """Call back, on a thread of its own, with each pose of a body.

        Raises:
            RobotError: The system is not reached.
        """
        with self._lock:
            self._watchers[body] = on_pose
            if self._thread is None:
                try:
                    source = self._connect(*self._where)
                except RobotError:
                    del self._watchers[body]
                    raise
                self._failure = None
                # A daemon: nothing can end a thread that waits for the frame of a dead server.
                name = f"motion capture at {self._where[1]}"
                self._thread = threading.Thread(
                    target=self._read, args=(source,), name=name, daemon=True
                )
                self._thread.start()

    def leave(self, body: str) -> None:
        """Stop calling back; the thread ends with the next frame after the last body has left."""
        with self._lock:
            self._watchers.pop(body, None)

    def _read(self, source: Any) -> None:
        try:
            while self._goes_on():
                source.waitForNextFrame()
                seen = source.rigidBodies
                self._seen = frozenset(seen)
                with self._lock:
                    watchers = dict(self._watchers)
                for body, on_pose in watchers.items():
                    if body in seen:
                        self._deliver(body, seen[body], on_pose)
        except Exception as error:  # noqa: BLE001 - of a foreign library, and told as it is
            _log.exception("motion capture at %s failed", self._where[1])
            self._failure = f"motion capture at {self._where[1]} failed: {error!r}"
            with self._lock:
                self._thread = None

    def _deliver(self, name: str, body: Any, on_pose: OnPose) -> None:
        turned = body.rotation
        position = np.asarray(body.position, dtype=np.float64)
        quaternion = np.array([turned.x, turned.y, turned.z, turned.w], dtype=np.float64)
        # Some systems name bodies that they do not see, with a pose of NaN.
        if not np.isfinite(position).all() or not np.isfinite(quaternion).all():
            return
        try:
            on_pose(position, quaternion)
        except Exception:  # noqa: BLE001 - the link of one drone must not blind the others
            if name not in self._unsent:
                _log.exception("poses of body %r cannot be sent to its drone", name)
            self._unsent.add(name)
        else:
            self._unsent.discard(name)

    def _goes_on(self) -> bool:
        with self._lock:
            if not self._watchers:
                self._thread = None
            return self._thread is not None


class Sighting:
    """One drone as motion capture sees it; passes on as many poses as its radio carries."""

    def __init__(self, settings: MotionCaptureSettings, capture: MotionCapture) -> None:
        self._settings, self._capture = settings, capture
        self._due_s = 0.0
        self._seen_s: float | None = None

    def begin(self, send_position: Callable[[FloatArray], None], send_pose: OnPose) -> None:
        """Pass poses on until `end`.

        Args:
            send_position: Function that sends a position to the drone.
            send_pose: Function that sends a position and an attitude.

        Raises:
            RobotError: The system is not reached.
        """
        self._seen_s = None

        def take(position_m: FloatArray, quaternion: FloatArray) -> None:
            now_s = time.monotonic()
            if now_s < self._due_s:
                self._seen_s = now_s
                return
            interval_s = 1 / self._settings.rate_hz
            self._due_s = max(self._due_s + interval_s, now_s)
            if self._settings.attitude:
                send_pose(position_m, quaternion)
            else:
                send_position(position_m)
            self._seen_s = now_s  # a pose that could not be sent tells the drone nothing

        self._capture.watch(self._settings.body, take)

    def end(self) -> None:
        """Pass on nothing more."""
        self._capture.leave(self._settings.body)

    def hindrance(self, unseen_max_s: float) -> str | None:
        """Return why the system tells the drone nothing; None while it does.

        Args:
            unseen_max_s: Time without a pose after which it counts as unseen.
        """
        if self._capture.failure is not None:
            return self._capture.failure
        if self._seen_s is None or time.monotonic() - self._seen_s > unseen_max_s:
            known = ", ".join(sorted(self._capture.bodies)) or "none"
            return f"motion capture does not see body {self._settings.body!r}; it sees {known}"
        return None
