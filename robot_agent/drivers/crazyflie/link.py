"""The link to one Crazyflie, opened, set up and closed through cflib."""

from __future__ import annotations

import logging
import threading
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from typing import Any

import numpy as np

from nufleet.robot_agent.drivers.crazyflie.settings import (
    CONTROLLERS,
    ESTIMATORS,
    CrazyflieSettings,
)
from nufleet.robot_agent.drivers.crazyflie.supervisor import Supervisor
from nufleet.robot_agent.drivers.crazyflie.telemetry import (
    STATE_VARIABLES,
    STATUS_PERIOD_S,
    STATUS_VARIABLES,
    Telemetry,
)
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError

SILENT_MAX_S = 3.0
"""Time without any packet after which an attempt to connect is given up."""

CONNECTING_MAX_S = 25.0
"""Time for all attempts to connect, tables of contents included; one that hears nothing is not
repeated when less is left than it takes."""

PARAMETER_MAX_S = 3.0
"""Time in which the firmware confirms a parameter."""

STOP_INTERVAL_S = 0.02
STOP_MAX_S = 10.0
"""Emergency stops are repeated at this interval until the supervisor confirms one, for this long at
most, since packets may be lost."""

SUPERVISOR_PROTOCOL = 12
"""First version of the protocol with a port for the supervisor."""

_log = logging.getLogger(__name__)


class Link:
    """Speaks to one Crazyflie; callbacks of cflib's threads fill a `Telemetry`."""

    def __init__(self, settings: CrazyflieSettings, telemetry: Telemetry) -> None:
        """Prepare a link.

        Args:
            settings: Settings of the drone.
            telemetry: Where what it logs is kept.
        """
        self._settings, self._telemetry = settings, telemetry
        self._cf: Any = None
        self._blocks: list[Any] = []
        self._changed = threading.Condition()
        self._heard_s = 0.0
        self._stopping: threading.Thread | None = None
        self._connected = False
        self.lost: str | None = None
        """Why the link is lost; None while it is not."""

    def open(self) -> None:
        """Connect and begin to log.

        Raises:
            RobotError: It cannot be reached, or its firmware lacks something.
        """
        deadline_s = time.monotonic() + CONNECTING_MAX_S
        while not self._attempt(deadline_s):
            _log.info("%s: connecting again, since packets got lost", self._settings.uri)
        self._log(STATE_VARIABLES, self._settings.log_period_s, self._telemetry.take_state)
        self._log(
            STATUS_VARIABLES,
            STATUS_PERIOD_S,
            lambda _, values, arrived_s: self._telemetry.take_status(values, arrived_s),
        )

    def set_up(self) -> None:
        """Set the parameters that the settings ask for.

        Raises:
            RobotError: There is no such parameter, or it is not confirmed.
        """
        for name, value in self._wanted_parameters().items():
            self.set_parameter(name, value)

    def close(self) -> None:
        """Stop logging and close the link; does nothing when it is closed.

        An emergency stop is confirmed or given up first.
        """
        if self._stopping is not None:
            self._stopping.join(STOP_MAX_S)
        cf, self._cf = self._cf, None
        if cf is None:
            return
        for block in self._blocks:
            block.data_received_cb.callbacks.clear()
            if cf.link is not None:
                block.stop()
                block.delete()
        self._blocks.clear()
        # cflib would send zero thrust, also to a drone that is still in the air.
        cf.commander.send_setpoint = lambda *_: None
        link = cf.link
        if link is not None:
            # A thread of cflib that sends meanwhile would report that its socket is closed, and
            # cflib would close the link from that thread, which would then wait for itself.
            link.link_error_callback = None
        cf.close_link()

    def set_parameter(self, name: str, value: float) -> None:
        """Set a parameter of the firmware, and wait until it confirms it.

        Raises:
            RobotError: There is no such parameter, or it is not confirmed.
        """
        group, _, own = name.partition(".")
        try:
            self._cf.param.set_value(name, value)
        except (KeyError, ValueError, AttributeError) as error:
            raise RobotError(
                f"{self._settings.uri}: the firmware has no parameter {name!r} that can be set to "
                f"{value:g}: {error}"
            ) from error
        deadline_s = time.monotonic() + PARAMETER_MAX_S
        while abs(float(self._cf.param.values[group][own]) - value) > 1e-6 * max(1.0, abs(value)):
            if time.monotonic() > deadline_s:
                raise RobotError(f"{self._settings.uri}: {name} = {value:g} was not confirmed")
            time.sleep(0.005)

    def reset_estimator(self) -> None:
        """Have the estimator begin again, where `start` says if it does.

        Raises:
            RobotError: A parameter is not confirmed.
        """
        start = self._settings.start
        if start is not None:
            for axis, value in zip("XYZ", start.position_m, strict=True):
                self.set_parameter(f"kalman.initial{axis}", value)
            self.set_parameter("kalman.initialYaw", start.yaw_rad)
        self.set_parameter("kalman.resetEstimation", 1)
        self.set_parameter("kalman.resetEstimation", 0)

    def arm(self, *, armed: bool) -> None:
        """Arm or disarm the motors."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # cflib warns of older firmware, and works with it
            self._cf.supervisor.send_arming_request(armed)

    def take_off(self, height_m: float, duration_s: float) -> None:
        """Have the firmware climb to a height above the origin of its frame."""
        self._cf.high_level_commander.takeoff(height_m, duration_s)

    def land(self, height_m: float, duration_s: float) -> None:
        """Have the firmware descend to a height, from set-points or from its own commands."""
        # The firmware ignores its high-level commander for as long as set-points are valid.
        self._cf.commander.send_notify_setpoint_stop()
        self._cf.high_level_commander.land(height_m, duration_s)

    def stop_motors(self) -> None:
        """Stop the motors of a drone that has landed."""
        self._cf.high_level_commander.stop()

    def feed_watchdog(self) -> None:
        """Tell the firmware's watchdog that this machine is alive."""
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # as above
            self._cf.supervisor.send_emergency_stop_watchdog()

    def send_setpoint(self, position_m: FloatArray, velocity_m_s: FloatArray) -> None:
        """Send where to be, and with which velocity; both of shape (3,), in the drone's frame."""
        if self._settings.setpoint == "position":
            self._cf.commander.send_position_setpoint(*position_m.tolist(), 0.0)
            return
        still = (0.0, 0.0, 0.0)
        level = (0.0, 0.0, 0.0, 1.0)
        self._cf.commander.send_full_state_setpoint(
            _whole_mm(position_m), _whole_mm(velocity_m_s), still, level, *still
        )

    def send_position(self, position_m: FloatArray) -> None:
        """Send where motion capture sees it, shape (3,)."""
        cf = self._cf
        if cf is not None:
            cf.loc.send_extpos(position_m.tolist())

    def send_pose(self, position_m: FloatArray, quaternion: FloatArray) -> None:
        """Send the pose that motion capture sees: shapes (3,) and (4,), x, y, z, w."""
        cf = self._cf
        if cf is not None:
            cf.loc.send_extpose(position_m.tolist(), quaternion.tolist())

    def cut_motors(self) -> None:
        """Send emergency stops, past every lock and queue of cflib; returns at once.

        A thread repeats them until the supervisor says that it is locked, for `STOP_MAX_S` at most.

        Raises:
            RobotError: There is no link.
        """
        from cflib.crtp.crtpstack import CRTPPacket, CRTPPort

        cf = self._cf
        link = None if cf is None else cf.link
        if link is None:
            raise RobotError(f"{self._settings.uri}: there is no link for an emergency stop")
        packet = CRTPPacket()
        new = cf.platform.get_protocol_version() >= SUPERVISOR_PROTOCOL
        packet.set_header(CRTPPort.SUPERVISOR if new else CRTPPort.LOCALIZATION, 1)
        packet.data = (3,)
        began_s = time.monotonic()

        def confirmed() -> bool:
            status = self._telemetry.status
            if status is None or status.arrived_s < began_s:
                return False
            return bool(status.supervisor & Supervisor.LOCKED)

        def send() -> None:
            while not confirmed():
                if cf.link is not link or time.monotonic() > began_s + STOP_MAX_S:
                    _log.error("%s: the emergency stop was not confirmed", self._settings.uri)
                    return
                try:
                    link.send_packet(packet)
                except Exception as error:  # noqa: BLE001 - one that fails must not be the last one
                    _log.warning("%s: an emergency stop failed: %r", self._settings.uri, error)
                time.sleep(STOP_INTERVAL_S)

        name = f"{self._settings.uri}-stop"
        self._stopping = threading.Thread(target=send, name=name, daemon=True)
        self._stopping.start()

    def _attempt(self, deadline_s: float) -> bool:
        """Connect; return False if packets got lost on the way, so that it should be tried again.

        Raises:
            RobotError: Nothing answers.
        """
        self._begin_attempt()
        while time.monotonic() < min(deadline_s, self._heard_s + SILENT_MAX_S):
            with self._changed:
                self._changed.wait_for(lambda: self._connected or self.lost is not None, 0.05)
            if self._connected:
                return True
            if self.lost is not None:
                self.close()
                raise RobotError(_in_words(self._settings.uri, self.lost))
        self.close()
        if time.monotonic() + SILENT_MAX_S < deadline_s:
            return False
        raise RobotError(
            f"{self._settings.uri}: nothing answers there. Is the drone switched on, and are "
            "channel, data rate and address those that it has (cfclient shows them)?"
        )

    def _begin_attempt(self) -> None:
        from cflib import crtp
        from cflib.crazyflie import Crazyflie

        if not crtp.CLASSES:
            crtp.init_drivers()
            # It warns twice per connection that it keeps no tables of contents.
            logging.getLogger("cflib.crazyflie.toccache").setLevel(logging.ERROR)
            # It prints a traceback of a missing radio, which is said in words here.
            logging.getLogger("cflib.crazyflie").addFilter(
                lambda record: "Couldn't load link driver" not in record.getMessage()
            )
        self._connected, self.lost = False, None
        self._heard_s = time.monotonic()
        self._cf = cf = Crazyflie()
        guard_sending(cf)
        cf.packet_received.add_callback(self._heard)
        cf.fully_connected.add_callback(lambda _: self._tell(connected=True))
        cf.connection_failed.add_callback(lambda _, why: self._tell(lost=why))
        cf.connection_lost.add_callback(lambda _, why: self._tell(lost=why))
        cf.disconnected_link_error.add_callback(lambda _, why: self._tell(lost=why))
        cf.open_link(self._settings.uri)
        if cf.link is not None and not self._settings.uri.startswith("radio"):
            # cflib assumes that these links are reliable and would wait forever for a lost table.
            cf.link.needs_resending = True

    def _heard(self, _: object) -> None:
        self._heard_s = time.monotonic()

    def _tell(self, *, connected: bool = False, lost: str | None = None) -> None:
        with self._changed:
            self._connected = self._connected or connected
            self.lost = self.lost or lost
            self._changed.notify_all()

    def _wanted_parameters(self) -> dict[str, float]:
        settings = self._settings
        wanted: dict[str, float] = {}
        if settings.estimator is not None:
            wanted["stabilizer.estimator"] = ESTIMATORS[settings.estimator]
        if settings.controller is not None:
            wanted["stabilizer.controller"] = CONTROLLERS[settings.controller]
        if "enHighLevel" in self._cf.param.toc.toc.get("commander", {}):
            wanted["commander.enHighLevel"] = 1.0  # firmware before 2024 asks for it
        return wanted | settings.parameters

    def _log(
        self,
        variables: tuple[tuple[str, str | None], ...],
        period_s: float,
        take: Callable[[int, dict[str, float], float], None],
    ) -> None:
        from cflib.crazyflie.log import LogConfig

        block = LogConfig("nufleet", round(1000 * period_s))
        for name, kind in variables:
            block.add_variable(name, kind)
        block.data_received_cb.add_callback(
            lambda stamp_ms, values, _: take(stamp_ms, values, time.monotonic())
        )
        try:
            self._cf.log.add_config(block)
        except KeyError as error:
            raise RobotError(
                f"{self._settings.uri}: the firmware does not log something that is needed "
                f"({error.args[0]}): update it"
            ) from error
        self._blocks.append(block)
        block.start()


def guard_sending(cf: Any) -> None:
    """Keep a packet that cannot be sent from blocking all that follow.

    cflib 0.1.34 takes a lock for each packet and leaves it taken when sending fails. Its repetition
    of a packet that is answered at the same moment fails, too. From then on no set-point would be
    sent, and to close the link would last forever. It sends nothing where there is no link, but
    fails if another thread closes the link meanwhile, or loses it; then nothing is sent, either.

    Args:
        cf: cflib's Crazyflie, not yet connected.
    """
    lock = cf._send_lock = threading.RLock()  # noqa: SLF001 - there is no other way
    send = cf.send_packet

    def send_packet(packet: Any, *args: Any, **named: Any) -> None:
        link = cf.link
        try:
            send(packet, *args, **named)
        except Exception as error:
            with suppress(RuntimeError):  # it failed before it took the lock
                lock.release()
            answered = isinstance(error, KeyError) and named.get("resend")
            # A link that is closed has no callback for its errors any more.
            closed = cf.link is not link or getattr(link, "link_error_callback", None) is None
            if not (answered or (closed and isinstance(error, AttributeError))):
                raise

    cf.send_packet = send_packet


def _whole_mm(values: FloatArray) -> FloatArray:
    # cflib cuts a full-state set-point off to whole millimetres, which would shift it towards 0.
    rounded = np.rint(1000 * values)
    whole: FloatArray = (rounded + 0.25 * np.sign(rounded)) / 1000
    return whole


def _in_words(uri: str, message: str) -> str:
    first = message.strip().splitlines()[0].removeprefix("Couldn't load link driver: ")
    if "Crazyradio" in first or "No backend" in first or "radio with serial" in first:
        return (
            f"{uri}: no Crazyradio: {first}. Plug it in, and allow this user to use it (Bitcraze's "
            "udev rules)"
        )
    if "Too many packets lost" in first or "communicating" in first:
        return f"{uri}: nothing answers there ({first}). Is the drone switched on?"
    return f"{uri}: {first}"
