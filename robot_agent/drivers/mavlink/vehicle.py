"""One vehicle as the driver sees it: commanded, and judged by its telemetry."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.robot_agent.drivers.mavlink.condition import present_charge, weakness
from nufleet.robot_agent.drivers.mavlink.keeper import Keeper
from nufleet.robot_agent.drivers.mavlink.line import Line
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
            self._line.send(self.command(command, confirmation, parameters))
            if not self.until(lambda: command in answers, ANSWER_S):
                self.check_trouble()
                continue
            self.until(lambda: answers.get(command, in_progress) != in_progress, FOUND_S)
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
        if not self.until(lambda: self.mode == mode, HEARTBEATS_S):
            raise RobotError(
                f"{self.profile.name} acknowledged {mode} mode, but stays in {self.mode} mode"
                f"{self.telemetry.words(self._line.now_s())}"
            )

    def land(self) -> None:
        """Have it land in a mode of its own.

        Raises:
            RobotError: It is refused, or not answered. Then it is left to its failsafe, which lands
                a vehicle that hears nothing more.
        """
        try:
            self.ask("landing", dialect.MAV_CMD_NAV_LAND, 0.0, 0.0, 0.0, math.nan)
        except RobotError:
            self.keeper.abandon()
            raise
        self.controlled = False
        self.keeper.release()
        self.telemetry.landed = None  # until it tells again

    def check_disarmed(self) -> bool:
        """Wait until it is certain whether it is armed; return whether it is not.

        An order to arm that was not answered may still have been obeyed.

        Raises:
            RobotError: It does not say.
        """
        sure_s = self._line.now_s() + CUT_SURE_S

        def told() -> bool:
            heartbeat = self.telemetry.heartbeat
            return heartbeat is not None and heartbeat.arrived_s > sure_s

        if not self.until(told, CUT_SURE_S + HEARTBEATS_S):
            self.keeper.abandon()
            raise RobotError(
                f"{self.profile.name} does not say whether it is armed: keep away from it"
                f"{self.telemetry.words(self._line.now_s())}"
            )
        return not self.armed

    def arm(self) -> None:
        """Arm the motors, and wait until they are."""
        self.ask("arming", dialect.MAV_CMD_COMPONENT_ARM_DISARM, 1.0)
        if not self.until(lambda: self.armed, HEARTBEATS_S):
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
        message = self.command(command, 0, parameters)
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

    def check_trouble(self) -> None:
        """Check that its measurements can be trusted; raises RobotDownError."""
        if self.telemetry.trouble:
            self._give_up()
            raise RobotDownError(self.telemetry.trouble)

    def check_obeys(self) -> None:
        """Check that it still follows our set-points.

        Raises:
            RobotDownError: It does not.
        """
        self.check_trouble()
        lost = self._lost_control()
        if lost:
            self.keeper.release()
            raise RobotDownError(f"{lost}{self.telemetry.words(self._line.now_s())}")

    def check_in_touch(self) -> None:
        """Check that the vehicle can still be heard.

        Raises:
            RobotDownError: It measures nothing for `LOST_S`, or sends no heartbeat for
                `HEARTBEATS_S`: only its own failsafe can land it.
        """
        newest, now_s = self.telemetry.newest, self._line.now_s()
        lost = ""
        if newest is None or now_s - newest.arrived_s > LOST_S:
            lost = f"nothing has been measured for {LOST_S:g} s"
        elif not self._beats(now_s):
            lost = f"no heartbeat has arrived for {HEARTBEATS_S:g} s, so its mode is not known"
        if lost:
            self._give_up()
            raise RobotDownError(
                f"{lost}: only the vehicle's own failsafe, or a pilot, can land it"
                f"{self.telemetry.words(now_s)}"
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

    def _give_up(self) -> None:
        """Have it land, by its failsafe if it does not hear us, rather than keep it in the air."""
        if not self.controlled or self.cut_off or self.mode != self.profile.obeys:
            self.keeper.release()
            return
        if self._beats(self._line.now_s()):  # else a pilot may fly it by now
            land = (0.0, 0.0, 0.0, math.nan)
            self._line.send(self.command(dialect.MAV_CMD_NAV_LAND, 0, land))
        self.keeper.abandon()

    def _beats(self, now_s: float) -> bool:
        heartbeat = self.telemetry.heartbeat
        return heartbeat is not None and now_s - heartbeat.arrived_s <= HEARTBEATS_S

    def _check_not_cut(self) -> None:
        if self.cut_off:
            raise RobotDownError("its motors were cut")

    def until(self, condition: Callable[[], bool], within_s: float) -> bool:
        """Wait until a condition holds; return whether it does.

        Raises:
            RobotDownError: The motors were cut.
        """
        until_s = self._line.now_s() + within_s
        holds = self._line.wait(until_s, lambda: self.cut_off or condition())
        self._check_not_cut()
        return holds

    def command(self, command: int, confirmation: int, parameters: tuple[float, ...]) -> Any:
        """Return the message with a command, MAV_CMD, and its first parameters."""
        seven = (*parameters, *(0.0,) * (7 - len(parameters)))
        settings = self._settings
        return dialect.MAVLink_command_long_message(
            settings.system_id, settings.component_id, command, confirmation, *seven
        )
