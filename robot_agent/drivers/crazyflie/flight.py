"""One connected Crazyflie in the air: arming, taking off, set-points, landing."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

import numpy as np

from nufleet.robot_agent.drivers.crazyflie.condition import misplaced
from nufleet.robot_agent.drivers.crazyflie.link import Link
from nufleet.robot_agent.drivers.crazyflie.settings import AXES, CrazyflieSettings
from nufleet.robot_agent.drivers.crazyflie.supervisor import Supervisor, why_down
from nufleet.robot_agent.drivers.crazyflie.telemetry import Measurement, Telemetry
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import OutsideLimitsError, RobotDownError, RobotError

UNMEASURED_MAX_S = 0.3
"""Time without a measurement after which a motion ends. The firmware levels out when it hears
nothing for 0.5 s, and stops the motors after 2 s."""

GRACE_S = 0.1
"""Time in which a measurement that is already on this machine is taken up."""

HOLD_INTERVAL_S = 0.1
"""Time without a set-point after which the last one is sent again."""

ARMING_MAX_S = 3.0
"""Time in which the drone arms."""

PATIENCE_S = 10.0
"""Time beyond what is planned in which the drone settles: its estimate, its height, itself."""

STILL_S = 0.3
STILL_M_S = 0.08
"""Time for which it has to stay within `rest_within_m` and below this speed to be at rest."""

COS_TILT_MIN = 0.36
"""Cosine of the tilt, 69 degrees, beyond which a motion ends."""

AGAIN_S = 0.5
"""Time after which a command that shows no effect is given again."""

BLIND_S = 1.0
"""Time that a drone which is not measured has in addition to land."""

STARTS_WITH_M = 0.05
"""Change of height that shows that a climb or a landing has begun."""

ARRIVES_WITHIN_M = 0.1
"""Distance from a commanded height within which the drone has arrived there."""

_log = logging.getLogger(__name__)


class Flight:
    """Flies one drone for as long as it is connected.

    The firmware's high-level commander takes off and lands. In between the drone follows
    set-points: those of a motion, or the last one, which a thread repeats. If this process dies or
    the radio does, the firmware therefore levels out and switches off by itself.

    Offsets are positions relative to the origin, shape (3,), in m.
    """

    def __init__(
        self, name: str, settings: CrazyflieSettings, link: Link, telemetry: Telemetry
    ) -> None:
        """Watch over a drone that is connected and stands on the ground.

        Args:
            name: Name of the robot, for errors.
            settings: Settings of the drone.
            link: Link to it, open.
            telemetry: What it logs.
        """
        self._name, self._settings = name, settings
        self._link, self._telemetry = link, telemetry
        self._columns = [AXES.index(axis) for axis in settings.axes]
        self.origin_m = np.array(settings.origin_m)
        """Position of the drone at reference 0 in m, shape (3,)."""
        self._ground_m = 0.0
        self._cut = False
        self._sending = threading.Lock()
        self._setpoint_m: FloatArray | None = None
        self._sent_at_s = 0.0
        self._guarded = False
        self.failure: str | None = None
        """Why set-points are not repeated; None while they are."""
        self._over = threading.Event()
        self._keeper = threading.Thread(target=self._keep, name=f"{name}-keeper", daemon=True)
        self._keeper.start()
        self.airborne = False
        """Whether the drone has left the ground, or might have."""
        self.offset, self.velocity = np.zeros(3), np.zeros(3)
        """The last set-point, in m and m/s."""

    @property
    def down(self) -> str | None:
        """Reason why the drone no longer responds to commands; None while it does."""
        if self._cut:
            return "its motors were cut"
        if self._link.lost is not None:
            return f"the link to it is lost: {self._link.lost.splitlines()[0]}"
        status = self._telemetry.status
        return None if status is None else why_down(status.supervisor)

    def offset_of(self, measurement: Measurement) -> FloatArray:
        """Return the drone's position in a measurement."""
        offset: FloatArray = measurement.position_m - self.origin_m
        return offset

    def newest(self) -> Measurement:
        """Return the newest measurement.

        Raises:
            RobotError: There is none that is new enough.
        """

        # After a freeze of this process, the thread that receives them may not have run yet.
        arrives = self._telemetry.wait_for(lambda: self.measured, GRACE_S)
        newest = self._telemetry.newest
        if newest is None or not arrives:
            raise RobotError(self._unmeasured())
        return newest

    @property
    def measured(self) -> bool:
        """Whether its newest measurement is new enough and its time stamps can be right."""
        newest, now_s = self._telemetry.newest, time.monotonic()
        recent = newest is not None and now_s - newest.arrived_s < UNMEASURED_MAX_S
        return recent and self._telemetry.fault is None

    def next(self) -> Measurement:
        """Wait for the next measurement and return it.

        Raises:
            RobotError: None arrives.
            RobotDownError: The drone no longer responds to commands.
        """
        self.raise_if_down()
        telemetry, before = self._telemetry, self._telemetry.newest
        if not telemetry.wait_for(lambda: telemetry.newest is not before, UNMEASURED_MAX_S):
            raise RobotError(self._unmeasured())
        return self.newest()

    def reset_estimator(self, timeout_s: float) -> bool:
        """Let the position estimate settle on the ground; return whether it did in time."""
        telemetry = self._telemetry
        if self._settings.estimator not in ("kalman", "ukf"):
            return True
        self._link.reset_estimator()
        telemetry.forget_variances()
        return telemetry.wait_for(lambda: telemetry.steady, timeout_s)

    def take_off(self, check_wanted: Callable[[], None]) -> None:
        """Find out where it is, arm, and climb to the height of its origin.

        Args:
            check_wanted: Raises RobotError if it is to stay on the ground after all.

        Raises:
            RobotError: It does not know where it is, stands too far away, or does not get there.
            RobotDownError: The drone no longer responds to commands.
        """
        self._find_position()
        check_wanted()
        try:
            self._arm()
            check_wanted()
            self.newest()
        except RobotError:
            # The order to arm may have arrived. To land on the ground would spin the motors up.
            self._disarm()
            raise
        self.airborne = self._guarded = True
        height_m, takes_s = self._settings.origin_m[2], self._settings.takeoff_s
        self._climb_to(height_m, takes_s, lambda: self._link.take_off(height_m, takes_s))
        self.offset, self.velocity = self.offset_of(self.newest()), np.zeros(3)

    def land(self) -> None:
        """Land where it is, and disarm.

        Raises:
            RobotError: It does not reach the ground, or cannot be measured on its way.
            RobotDownError: The drone no longer responds to commands.
        """
        self.raise_if_down()
        link, ground_m, takes_s = self._link, self._ground_m, self._settings.landing_s
        with self._sending:
            self._setpoint_m = None
        try:
            self._climb_to(ground_m, takes_s, lambda: link.land(ground_m, takes_s))
        except RobotError as error:
            if self.down is not None or self.measured:
                raise
            self._land_blind(takes_s, error)
        self._disarm()
        self.airborne = False

    def send(self, offset: FloatArray, velocity: FloatArray) -> float:
        """Send a set-point; return when, on the monotonic clock.

        Raises:
            RobotDownError: The motors were cut.
        """
        with self._sending:
            self._raise_if_cut()
            sent_s = self._sent_at_s = time.monotonic()
            self._setpoint_m = self.origin_m + offset
            self.offset, self.velocity = offset, velocity
            self._link.send_setpoint(self._setpoint_m, velocity)
        return sent_s

    def wait_until_still(self) -> None:
        """Wait until it stays at reference 0.

        Raises:
            RobotError: It does not come to rest there.
            RobotDownError: The drone no longer responds to commands.
        """
        telemetry, settings = self._telemetry, self._settings
        fence_m = settings.limits.fence_m
        since: list[float] = []

        def still() -> bool:
            newest = telemetry.newest
            if self.down is not None or newest is None or self._strayed_m > fence_m:
                return True
            away_m = np.abs(self.offset_of(newest)[self._columns]).max()
            if away_m > settings.rest_within_m or np.linalg.norm(newest.velocity_m_s) > STILL_M_S:
                since.clear()
            elif not since:
                since.append(newest.device_s)
            return bool(since) and newest.device_s - since[0] >= STILL_S

        rested = telemetry.wait_for(still, settings.settling_time_s + PATIENCE_S)
        self.check_near()
        if not rested:
            away_m = self.offset_of(self.newest())
            where = ", ".join(f"{AXES[k]} at {away_m[k]:.3g} m" for k in self._columns)
            raise RobotError(
                telemetry.fault
                or f"{self._name} does not come to rest within {settings.rest_within_m:g} m of "
                f"reference 0 (rest_within_m): {where}"
            )

    def check(self, measured: Measurement) -> None:
        """Check that it still flies as it should.

        Raises:
            OutsideLimitsError: It has lost its place along something that is no axis.
            RobotDownError: The drone no longer responds to commands.
            RobotError: It tilts too far, or what it logs contradicts itself.
        """
        self.raise_if_down()
        if self._telemetry.fault is not None:
            raise RobotError(self._telemetry.fault)
        limits = self._settings.limits
        watched = [("x", limits.fence_m), ("y", limits.fence_m), ("z", limits.height_error_m)]
        for (axis, limit_m), away_m in zip(watched, self.offset_of(measured), strict=True):
            if axis not in self._settings.axes and abs(away_m) > limit_m:
                place, name = ("height", "height_error_m") if axis == "z" else (axis, "fence_m")
                raise OutsideLimitsError(
                    f"{self._name} is {away_m:+.2f} m off its {place}; {limit_m:g} m are allowed "
                    f"(limits.{name})"
                )
        if measured.thrust_axis[2] < COS_TILT_MIN:
            raise RobotError(
                f"{self._name} tilts to a cosine of {measured.thrust_axis[2]:.2f}: drive it more "
                "gently"
            )

    def check_near(self) -> None:
        """Check that it is near enough to its set-point to be led back from there.

        Raises:
            OutsideLimitsError: It is not; its position has jumped, or it does not follow.
            RobotDownError: The drone no longer responds to commands.
        """
        self.raise_if_down()
        strayed_m, limit_m = self._strayed_m, self._settings.limits.fence_m
        if strayed_m > limit_m:
            raise OutsideLimitsError(
                f"{self._name} is {strayed_m:.2f} m away from its set-point, and at most "
                f"{limit_m:g} m are allowed (limits.fence_m): it is not led back, since its "
                "position may have jumped"
            )

    @property
    def _strayed_m(self) -> float:
        newest = self._telemetry.newest
        if newest is None or not self.measured:
            return 0.0
        return float(np.abs(self.offset_of(newest) - self.offset).max())

    @property
    def flying(self) -> bool:
        """Whether its supervisor says that it is in the air."""
        return self._says(Supervisor.FLYING)

    def raise_if_down(self) -> None:
        """Raise RobotDownError if the drone no longer responds to commands."""
        why = self.down
        if why is not None:
            raise RobotDownError(f"{self._name}: {why}")

    def _raise_if_cut(self) -> None:
        if self._cut:
            raise RobotDownError(f"{self._name}: its motors were cut")

    def cut_motors(self) -> None:
        """Have the firmware stop the motors: the drone falls."""
        self._cut = True
        self._link.cut_motors()

    def release(self) -> None:
        """Send nothing more."""
        self._over.set()
        self._keeper.join()

    def _keep(self) -> None:
        """Repeat the last set-point where none was sent for a while, and feed the watchdog."""
        while not self._over.wait(HOLD_INTERVAL_S / 2):
            try:
                with self._sending:
                    if self._cut or self._link.lost is not None:
                        return
                    held_m, now_s = self._setpoint_m, time.monotonic()
                    if held_m is not None and now_s - self._sent_at_s > HOLD_INTERVAL_S:
                        self._link.send_setpoint(held_m, np.zeros(3))
                        self._sent_at_s = now_s
                    if self._settings.watchdog and self._guarded:
                        self._link.feed_watchdog()
                self.failure = None
            except Exception as error:  # noqa: BLE001 - it is reported, and the next one is tried
                if self.failure is None:
                    _log.exception("%s: a set-point could not be repeated", self._name)
                self.failure = f"its set-points are not repeated: {error}"

    def _find_position(self) -> None:
        settings, telemetry = self._settings, self._telemetry
        if not self.reset_estimator(PATIENCE_S):
            raise RobotError(
                telemetry.fault
                or f"{self._name} does not find out where it is: the variance of its position has "
                f"not settled within {PATIENCE_S:g} s. Can it see its base stations, or can "
                "the motion capture system see it?"
            )
        stands = self.next()
        why = misplaced(settings, stands)
        if why is not None:
            raise RobotError(f"{self._name} {why}")
        self._ground_m = float(stands.position_m[2])

    def _land_blind(self, takes_s: float, why: RobotError) -> None:
        """Land a drone that is not measured any more, by the clock alone; it ends as an error."""
        ends_s = time.monotonic() + takes_s + BLIND_S
        self._link.land(self._ground_m, takes_s)
        time.sleep(max(0.0, ends_s - time.monotonic()))
        self._link.stop_motors()
        self._link.arm(armed=False)
        self.airborne = False
        raise RobotError(f"{self._name} was landed unseen: {why}") from why

    def _says(self, bits: Supervisor) -> bool:
        status = self._telemetry.status
        return status is not None and status.supervisor & bits == bits

    def _arm(self) -> None:
        def arm() -> None:
            if not self._says(Supervisor.ARMS_ITSELF):
                self._link.arm(armed=True)

        ready = Supervisor.ARMED | Supervisor.CAN_FLY
        if not self._insist(arm, lambda: self._says(ready), ARMING_MAX_S, AGAIN_S):
            status = self._telemetry.status
            info = "nothing" if status is None else f"{Supervisor(status.supervisor)!r}"
            raise RobotError(
                self._telemetry.fault or f"{self._name} does not arm: its supervisor says {info}"
            )

    def _disarm(self) -> None:
        def disarm() -> None:
            self._link.stop_motors()
            self._link.arm(armed=False)

        def off() -> bool:
            return not self._says(Supervisor.ARMED) or self._says(Supervisor.ARMS_ITSELF)

        if not self._insist(disarm, off, ARMING_MAX_S, AGAIN_S):
            raise RobotError(f"{self._name} does not disarm: keep away from it")

    def _climb_to(self, height_m: float, takes_s: float, command: Callable[[], None]) -> None:
        telemetry = self._telemetry

        def height() -> float:
            newest = telemetry.newest
            return float("nan") if newest is None else float(newest.position_m[2])

        from_m = height()  # however old: a drone that is not measured has to land, too

        def moved() -> bool:
            return self.down is not None or abs(height() - from_m) > STARTS_WITH_M

        def there() -> bool:
            return self.down is not None or abs(height() - height_m) < ARRIVES_WITHIN_M

        far = abs(height_m - from_m) > ARRIVES_WITHIN_M
        again_s = max(AGAIN_S, 0.6 * takes_s)
        began_s = time.monotonic()
        arrived = self._insist(command, moved if far else there, takes_s + PATIENCE_S, again_s)
        arrived = arrived and telemetry.wait_for(there, takes_s + PATIENCE_S)
        # It is there when it is near, and the firmware has finished with it.
        time.sleep(max(0.0, began_s + takes_s - time.monotonic()) if arrived else 0.0)
        self.raise_if_down()
        if not arrived:
            fails = f"does not reach a height of {height_m:.2f} m, but is at {height():.2f} m"
            raise RobotError(f"{self._name} {fails}" if self.measured else self._unmeasured())

    def _insist(
        self,
        command: Callable[[], None],
        condition: Callable[[], bool],
        timeout_s: float,
        again_s: float,
    ) -> bool:
        """Give a command, again and again since it may get lost; return whether it is obeyed.

        Raises:
            RobotDownError: The motors were cut; a command might start them again.
        """
        deadline_s = time.monotonic() + timeout_s
        while True:
            self._raise_if_cut()
            command()
            left_s = deadline_s - time.monotonic()
            if self._telemetry.wait_for(condition, min(again_s, max(0.0, left_s))):
                return True
            if left_s <= 0 or self._telemetry.fault is not None:
                return False

    def _unmeasured(self) -> str:
        return self._telemetry.fault or (
            f"{self._name} has sent no measurement for {UNMEASURED_MAX_S:g} s: check the link"
        )
