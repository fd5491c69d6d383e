"""One vehicle as the driver sees it: commanded, and judged by its telemetry."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.robot_agent.drivers.mavlink import failsafe
from nufleet.robot_agent.drivers.mavlink.condition import present_charge, weakness
from nufleet.robot_agent.drivers.mavlink.keeper import Keeper
from nufleet.robot_agent.drivers.mavlink.line import Line
from nufleet.robot_agent.drivers.mavlink.opening import check_kind, helpful_messages
from nufleet.robot_agent.drivers.mavlink.profiles import PROFILES, RESULTS
from nufleet.robot_agent.drivers.mavlink.settings import MavlinkSettings
from nufleet.robot_agent.drivers.mavlink.telemetry import Measurement, Telemetry
from nufleet.shared.errors import RobotDownError, RobotError
from nufleet.shared.robots.health import Health

FOUND_S = 5.0
"""Time in which a vehicle's heartbeat has to arrive, and then its measurements."""

ANSWER_S, ASKED_TIMES = 0.5, 6
"""Time to wait for the answer to a command, and how often it is sent."""

SILENT_S = 0.5
"""Age of the newest measurement from which on the vehicle is out of touch."""

LOST_S = 3.0
"""Age of the newest measurement from which on it is given up."""

HEARTBEATS_S = 3.5
"""Time without a heartbeat, sent once a second, from which on the link counts as lost."""

RATE_SHARE = 0.7
"""Share of the requested telemetry rate that has to arrive."""

CUT_ANSWER_S = 0.15
"""Time in which `cut` waits for an answer; the command is repeated afterwards, too."""

CUT_SURE_S = 1.0
"""Time after which a command that was sent before the cut no longer arrives: only then does a
heartbeat that says "disarmed" end the repetition."""

FORCE = 21196.0
"""Second parameter of MAV_CMD_COMPONENT_ARM_DISARM that disarms in the air, too."""


class Vehicle:
    """The connection to one vehicle, from `open` to `close`."""

    def __init__(self, settings: MavlinkSettings, line: Line) -> None:
        self._settings, self._line = settings, line
        self.profile = PROFILES[settings.profile]
        """What its autopilot calls things."""
        self.telemetry = Telemetry(
            self.profile, settings.system_id, settings.own_system_id, settings.measured_by
        )
        """Measurements and status received from the vehicle."""
        self.keeper = Keeper(line.send, self.telemetry.clock, settings.sample_time_s)
        """What continues to be sent."""
        self.controlled = False
        """Whether the vehicle follows our set-points; that can end at any time."""
        self.cut_off = False
        """Whether its motors were cut."""
        self._cut_s = math.inf
        self._asked: int | None = None

    def receive(self, message: Any, source: object, arrived_s: float) -> None:
        """Take a message that came from an address."""
        self.telemetry.receive(message, source, arrived_s)

    def beat(self, now_s: float) -> float:
        """Send what is due; return when something is due next."""
        heartbeat = self.telemetry.heartbeat
        newer = heartbeat is not None and heartbeat.arrived_s > self._cut_s + CUT_SURE_S
        if newer and not self.armed:
            self.keeper.repeat(None)
        return self.keeper.beat(now_s)

    def open(self) -> None:
        """Find the vehicle, have it send what is needed, and compare the clocks.

        Raises:
            RobotError: It does not answer, or it lacks what a motion needs.
        """
        settings, telemetry = self._settings, self.telemetry
        self._line.open(self)
        if not self._until(lambda: telemetry.heartbeat is not None, FOUND_S):
            others = [f"{i}" for i in self._line.heard_systems() if i != settings.system_id]
            heard = f"; others were heard: system {', '.join(others)}" if others else ""
            raise RobotError(
                f"no heartbeat of system {settings.system_id} arrived at {settings.url} within "
                f"{FOUND_S:g} s{heard}: check the address, the cable or radio, and "
                f"{self.profile.id_parameter}"
            )
        assert telemetry.heartbeat is not None  # noqa: S101 - was waited for
        check_kind(telemetry.heartbeat, self.profile, settings)
        self._check_failsafe()
        self._request_messages()
        if not self._until(lambda: telemetry.newest is not None, FOUND_S):
            raise RobotError(
                f"no {settings.measured_by} arrived within {FOUND_S:g} s: the vehicle has no "
                "position estimate (GPS, optical flow or motion capture)"
                f"{telemetry.words(self._line.now_s())}"
            )
        self._check_rate()
        self._check_clock()
        self._check_trouble()

    def close(self) -> None:
        """Leave the vehicle alone."""
        self.keeper.release()
        self._line.close()

    def ask(self, what: str, command: int, *parameters: float) -> None:
        """Send a command until it is acknowledged.

        Args:
            what: What is asked for, as in "arming".
            command: MAV_CMD.
            parameters: Its first parameters; the others are 0.

        Raises:
            RobotError: It is refused, or not answered.
            RobotDownError: The motors were cut meanwhile.
        """
        answers = self.telemetry.acknowledged
        in_progress = dialect.MAV_RESULT_IN_PROGRESS
        self._asked = command  # before the check, so that a cut sees what may still be sent
        answers.pop(command, None)
        for confirmation in range(ASKED_TIMES):
            self._check_not_cut()
            self._line.send(self._command(command, confirmation, parameters))
            if not self._until(lambda: command in answers, ANSWER_S):
                self._check_trouble()
                continue
            self._until(lambda: answers.get(command, in_progress) != in_progress, FOUND_S)
            result = answers.get(command, in_progress)
            self._asked = None
            if result == dialect.MAV_RESULT_ACCEPTED:
                return
            why = RESULTS.get(result, f"its result is {result}")
            words = self.telemetry.words(self._line.now_s())
            raise RobotError(f"{self.profile.name} did not accept {what}: {why}{words}")
        raise RobotError(
            f"{self.profile.name} did not answer {what}, which was sent {ASKED_TIMES} times"
        )

    def enter(self, mode: str) -> None:
        """Switch to a mode, and wait until the vehicle says that it is in it."""
        set_mode = dialect.MAV_CMD_DO_SET_MODE
        self.ask(f"{mode} mode", set_mode, *self.profile.mode_parameters(mode))
        if not self._until(lambda: self.mode == mode, HEARTBEATS_S):
            raise RobotError(
                f"{self.profile.name} acknowledged {mode} mode, but stays in {self.mode} mode"
                f"{self.telemetry.words(self._line.now_s())}"
            )

    def arm(self) -> None:
        """Arm the motors, and wait until they are."""
        self.ask("arming", dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        if not self._until(lambda: self.armed, HEARTBEATS_S):
            words = self.telemetry.words(self._line.now_s())
            raise RobotError(f"the vehicle acknowledged arming, but is not armed{words}")

    def cut(self) -> None:
        """Cut the motors, from any thread, without waiting for any other call.

        Raises:
            RobotError: The vehicle refuses, or does not answer; it is asked again and again.
        """
        command = dialect.MAV_CMD_COMPONENT_ARM_DISARM
        parameters = (0.0, FORCE)
        if self._settings.kill == "flight-termination":
            command, parameters = dialect.MAV_CMD_DO_FLIGHTTERMINATION, (1.0, 0.0)
        message = self._command(command, 0, parameters)
        answers = self.telemetry.acknowledged
        self.cut_off = True
        ambiguous = self._asked == command
        answers.pop(command, None)
        self.keeper.repeat(message)
        self._line.send(message)
        if command == dialect.MAV_CMD_COMPONENT_ARM_DISARM:
            self._cut_s = self._line.now_s()
        if not self._line.wait(self._line.now_s() + CUT_ANSWER_S, lambda: command in answers):
            raise RobotError(
                f"{self.profile.name} did not answer the command that cuts its motors within "
                f"{CUT_ANSWER_S:g} s; it is repeated every 50 ms until the robot is released"
            )
        result = answers[command]
        if result != dialect.MAV_RESULT_ACCEPTED:
            raise RobotError(
                f"{self.profile.name} does not cut its motors: {RESULTS.get(result, result)}"
            )
        if ambiguous:
            self._asked = None
            raise RobotError(
                f"{self.profile.name} was being armed or disarmed, and its answer does not say "
                "which: the command that cuts its motors is repeated until it says that it is "
                "disarmed; ask again to make sure"
            )
        if command == dialect.MAV_CMD_DO_FLIGHTTERMINATION:  # never asked for anything else
            self.keeper.repeat(None)

    @property
    def mode(self) -> str:
        """Name of its present mode."""
        heartbeat = self.telemetry.heartbeat
        return "no" if heartbeat is None else self.profile.mode_name(heartbeat.custom_mode)

    @property
    def armed(self) -> bool:
        """Whether its motors are armed."""
        return self.telemetry.heartbeat is not None and self.telemetry.heartbeat.armed

    def check_obeys(self) -> None:
        """Check that it still follows our set-points.

        Raises:
            RobotDownError: It does not.
        """
        self._check_trouble()
        lost = self._lost_control()
        if lost:
            self.keeper.release()
            raise RobotDownError(f"{lost}{self.telemetry.words(self._line.now_s())}")

    def check_in_touch(self) -> None:
        """Check that the vehicle can still be heard.

        Raises:
            RobotDownError: It is silent for more than `LOST_S`: only its own failsafe can land it.
        """
        newest, now_s = self.telemetry.newest, self._line.now_s()
        if newest is None or now_s - newest.arrived_s > LOST_S:
            self._give_up()
            raise RobotDownError(
                f"nothing has been measured for {LOST_S:g} s: only the vehicle's own failsafe, or "
                f"a pilot, can land it{self.telemetry.words(now_s)}"
            )

    def measured(self) -> Measurement:
        """Return the newest measurement.

        Raises:
            RobotError: It is too old.
        """
        newest = self.telemetry.newest
        if newest is None:
            raise RobotError("the vehicle is not connected")
        age_s = self._line.now_s() - newest.arrived_s
        if age_s > SILENT_S:
            raise RobotError(
                f"no {self._settings.measured_by} has arrived for {age_s:.2f} s: check the link "
                f"and the position estimate{self.telemetry.words(self._line.now_s())}"
            )
        return newest

    def health(self) -> Health:
        """Return its condition."""
        telemetry, settings, now_s = self.telemetry, self._settings, self._line.now_s()
        charge, flight_s = present_charge(telemetry, now_s), settings.flight_time_s
        endurance_s = None
        if charge is not None and flight_s is not None:
            endurance_s = max(0.0, charge - settings.battery_min) * flight_s
        broken = self.out_of_hand() or self._line.failure
        reason = broken or weakness(telemetry, settings, now_s)
        return Health(
            ready=not reason,
            reason=reason,
            battery=charge,
            endurance_s=endurance_s,
            link=telemetry.arriving,
        )

    def out_of_hand(self) -> str:
        """Return why the vehicle does not answer or obey; nothing if it does."""
        telemetry, now_s = self.telemetry, self._line.now_s()
        heartbeat, newest = telemetry.heartbeat, telemetry.newest
        if self.cut_off:
            return "its motors were cut"
        if heartbeat is None or newest is None:
            return "it is not connected"
        if telemetry.trouble:
            return telemetry.trouble
        if now_s - heartbeat.arrived_s > HEARTBEATS_S:
            return f"no heartbeat has arrived for {now_s - heartbeat.arrived_s:.1f} s"
        if now_s - newest.arrived_s > LOST_S:
            return f"no position has arrived for {now_s - newest.arrived_s:.1f} s"
        lost = self._lost_control()
        if lost:
            return f"{lost}{telemetry.words(now_s)}"
        return ""

    def _lost_control(self) -> str:
        if self.cut_off:
            return "its motors were cut"
        if not self.controlled:
            return ""
        if self.mode != self.profile.obeys:
            return self.profile.left_for(self.mode)
        return "" if self.armed else "the vehicle disarmed its motors"

    def _check_trouble(self) -> None:
        if self.telemetry.trouble:
            self._give_up()
            raise RobotDownError(self.telemetry.trouble)

    def _give_up(self) -> None:
        """Have it land if it can still hear us: held set-points would only keep it in the air."""
        if self.controlled and not self.cut_off and self.mode == self.profile.obeys:
            land = (0.0, 0.0, 0.0, math.nan)
            self._line.send(self._command(dialect.MAV_CMD_NAV_LAND, 0, land))
        self.keeper.release()

    def _check_not_cut(self) -> None:
        if self.cut_off:
            raise RobotDownError("its motors were cut")

    def _check_failsafe(self) -> None:
        if not self.profile.counts_heartbeats:
            return
        settings, parameters = self._settings, self.telemetry.parameters
        for _ in range(ASKED_TIMES):
            for name in failsafe.NEEDED:
                self._line.send(
                    dialect.MAVLink_param_request_read_message(
                        settings.system_id, settings.component_id, name.encode(), -1
                    )
                )
            if self._until(lambda: failsafe.known(parameters), ANSWER_S):
                break
        reason = failsafe.unwatched(parameters, settings.own_system_id)
        if reason:
            raise RobotError(reason)

    def _request_messages(self) -> None:
        settings = self._settings
        measured = getattr(dialect, f"MAVLINK_MSG_ID_{settings.measured_by}")
        interval_us = 1e6 / settings.telemetry_hz
        self.ask(
            f"{settings.measured_by} at {settings.telemetry_hz:g} Hz",
            dialect.MAV_CMD_SET_MESSAGE_INTERVAL,
            float(measured),
            interval_us,
        )
        # Helpful and not needed: their answers are not waited for.
        for message, rate_hz in helpful_messages(self.profile).items():
            parameters = (float(message), 1e6 / rate_hz)
            self._line.send(self._command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, parameters))

    def _check_rate(self) -> None:
        wanted_hz, telemetry = self._settings.telemetry_hz, self.telemetry
        if not self._until(lambda: telemetry.rate_hz > RATE_SHARE * wanted_hz, FOUND_S):
            self._check_trouble()
            raise RobotError(
                f"{wanted_hz:g} {self._settings.measured_by} a second were asked for, and "
                f"{telemetry.rate_hz:.3g} arrive: raise the rate of this link in the vehicle (PX4 "
                "MAV_x_RATE and SER_x_BAUD, ArduPilot SERIALx_BAUD), or lower telemetry_hz"
            )

    def _check_clock(self) -> None:
        clock, settings = self.telemetry.clock, self._settings

        def error_s() -> float:
            _, bound = clock.offset(np.array([self._line.now_s()]))
            return float(bound[0]) / math.sqrt(3)  # as if evenly distributed within the bound

        if not self._until(lambda: error_s() <= settings.delay_uncertainty_s, FOUND_S):
            if not clock.exchanges:
                raise RobotError(
                    "the vehicle does not answer TIMESYNC, so that its time stamps tell nothing: "
                    "enable it on this link (a MAVLink 2 router may filter it)"
                )
            raise RobotError(
                f"the vehicle's clock is known only to {1e3 * error_s():.2g} ms, since its "
                f"answers take long, and delay_uncertainty_s is "
                f"{1e3 * settings.delay_uncertainty_s:g} ms: use a faster link, or state more"
            )

    def _until(self, condition: Any, within_s: float) -> bool:
        until_s = self._line.now_s() + within_s
        holds = self._line.wait(until_s, lambda: self.cut_off or condition())
        self._check_not_cut()
        return holds

    def _command(self, command: int, confirmation: int, parameters: tuple[float, ...]) -> Any:
        seven = (*parameters, *(0.0,) * (7 - len(parameters)))
        settings = self._settings
        return dialect.MAVLink_command_long_message(
            settings.system_id, settings.component_id, command, confirmation, *seven
        )
