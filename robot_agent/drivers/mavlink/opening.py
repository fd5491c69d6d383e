"""What a vehicle has to be, and to send, before the driver asks it to move."""

from __future__ import annotations

import math

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.robot_agent.drivers.mavlink import failsafe
from nufleet.robot_agent.drivers.mavlink.line import Line
from nufleet.robot_agent.drivers.mavlink.profiles import (
    ARDUPILOT_AUTOPILOT,
    PX4_AUTOPILOT,
    Profile,
)
from nufleet.robot_agent.drivers.mavlink.settings import MavlinkSettings
from nufleet.robot_agent.drivers.mavlink.telemetry import Heartbeat
from nufleet.robot_agent.drivers.mavlink.vehicle import ANSWER_S, ASKED_TIMES, FOUND_S, Vehicle
from nufleet.shared.errors import RobotError

TAKES_NO_HOLD = {1: "a fixed-wing aircraft", 10: "a ground vehicle", 11: "a boat", 12: "submarine"}
"""Values of MAV_TYPE that cannot hover at reference 0."""

STAMPS_OFF_S = 1.0
"""Difference between the time stamps of measurements and TIMESYNC at which two clocks make them."""

RATE_SHARE = 0.7
"""Share of the requested telemetry rate that has to arrive."""


def open_vehicle(vehicle: Vehicle, settings: MavlinkSettings, line: Line) -> None:
    """Find a vehicle, have it send what is needed, and compare the clocks.

    Args:
        vehicle: The vehicle, with `line` not yet open.
        settings: Settings of the robot.
        line: Line to it.

    Raises:
        RobotError: It does not answer, or it lacks what a motion needs.
    """
    telemetry = vehicle.telemetry
    line.open(vehicle)
    if not vehicle.until(lambda: telemetry.heartbeat is not None, FOUND_S):
        others = [f"{i}" for i in line.heard_systems() if i != settings.system_id]
        heard = f"; others were heard: system {', '.join(others)}" if others else ""
        raise RobotError(
            f"no heartbeat of system {settings.system_id} arrived at {settings.url} within "
            f"{FOUND_S:g} s{heard}: check the address, the cable or radio, and "
            f"{vehicle.profile.id_parameter}"
        )
    assert telemetry.heartbeat is not None  # noqa: S101 - was waited for
    _check_kind(telemetry.heartbeat, vehicle.profile, settings)
    if vehicle.profile.counts_heartbeats:
        _check_failsafe(vehicle, settings, line)
    _request_messages(vehicle, settings, line)
    if not vehicle.until(lambda: telemetry.newest is not None, FOUND_S):
        raise RobotError(
            f"no {settings.measured_by} arrived within {FOUND_S:g} s: the vehicle has no "
            "position estimate (GPS, optical flow or motion capture)"
            f"{telemetry.words(line.now_s())}"
        )
    _check_rate(vehicle, settings)
    _check_clock(vehicle, settings, line)
    vehicle.check_trouble()


def _check_kind(heartbeat: Heartbeat, profile: Profile, settings: MavlinkSettings) -> None:
    """Check that a vehicle runs the autopilot of the fleet file, and can hover.

    Raises:
        RobotError: It does not, or cannot.
    """
    known = {PX4_AUTOPILOT: "PX4", ARDUPILOT_AUTOPILOT: "ArduPilot"}
    found = known.get(heartbeat.autopilot)
    if found is not None and found != profile.name:
        raise RobotError(
            f"system {settings.system_id} runs {found}, and the fleet file says "
            f"profile = {settings.profile!r}"
        )
    if heartbeat.vehicle_type in TAKES_NO_HOLD:
        raise RobotError(
            f"system {settings.system_id} is {TAKES_NO_HOLD[heartbeat.vehicle_type]}, "
            "which cannot hover at reference 0"
        )


def _check_failsafe(vehicle: Vehicle, settings: MavlinkSettings, line: Line) -> None:
    parameters = vehicle.telemetry.parameters
    for _ in range(ASKED_TIMES):
        for name in failsafe.NEEDED:
            line.send(
                dialect.MAVLink_param_request_read_message(
                    settings.system_id, settings.component_id, name.encode(), -1
                )
            )
        if vehicle.until(lambda: failsafe.known(parameters), ANSWER_S):
            break
    reason = failsafe.unwatched(parameters, settings.own_system_id)
    if reason:
        raise RobotError(reason)


def _request_messages(vehicle: Vehicle, settings: MavlinkSettings, line: Line) -> None:
    measured = getattr(dialect, f"MAVLINK_MSG_ID_{settings.measured_by}")
    interval_us = 1e6 / settings.telemetry_hz
    vehicle.ask(
        f"{settings.measured_by} at {settings.telemetry_hz:g} Hz",
        dialect.MAV_CMD_SET_MESSAGE_INTERVAL,
        float(measured),
        interval_us,
    )
    # Helpful and not needed: their answers are not waited for.
    for message, rate_hz in _helpful_messages(vehicle.profile).items():
        parameters = (float(message), 1e6 / rate_hz)
        line.send(vehicle.command(dialect.MAV_CMD_SET_MESSAGE_INTERVAL, 0, parameters))


def _check_rate(vehicle: Vehicle, settings: MavlinkSettings) -> None:
    wanted_hz, telemetry = settings.telemetry_hz, vehicle.telemetry
    if not vehicle.until(lambda: telemetry.rate_hz > RATE_SHARE * wanted_hz, FOUND_S):
        vehicle.check_trouble()
        raise RobotError(
            f"{wanted_hz:g} {settings.measured_by} a second were asked for, and "
            f"{telemetry.rate_hz:.3g} arrive: raise the rate of this link in the vehicle (PX4 "
            "MAV_x_RATE and SER_x_BAUD, ArduPilot SERIALx_BAUD), or lower telemetry_hz"
        )


def _check_clock(vehicle: Vehicle, settings: MavlinkSettings, line: Line) -> None:
    clock = vehicle.telemetry.clock

    def error_s() -> float:
        _, bound = clock.offset(np.array([line.now_s()]))
        if bound[0] < 0:
            return math.inf  # its answers contradict one another
        return float(bound[0]) / math.sqrt(3)  # as if evenly distributed within the bound

    if not vehicle.until(lambda: error_s() <= settings.delay_uncertainty_s, FOUND_S):
        if not clock.exchanges:
            raise RobotError(
                "the vehicle does not answer TIMESYNC, so that its time stamps tell nothing: "
                "enable it on this link (a MAVLink 2 router may filter it)"
            )
        if math.isinf(error_s()):
            raise RobotError(
                "the vehicle's answers to TIMESYNC contradict one another: its clock was set, "
                f"or two vehicles answer as system {settings.system_id}"
            )
        raise RobotError(
            f"the vehicle's clock is known only to {1e3 * error_s():.2g} ms, since its "
            f"answers take long, and delay_uncertainty_s is "
            f"{1e3 * settings.delay_uncertainty_s:g} ms: use a faster link, or state more"
        )
    newest = vehicle.measured()
    late_s = newest.arrived_s - float(clock.ours(np.array([newest.vehicle_s]))[0])
    if abs(late_s) > STAMPS_OFF_S:
        raise RobotError(
            f"the time stamps of {settings.measured_by} are {-late_s:+.3g} s off the clock that "
            "TIMESYNC tells, so that nothing can be dated: choose another measured_by"
        )


def _helpful_messages(profile: Profile) -> dict[int, float]:
    """Return the rates in Hz of messages that help and are not needed, by their numbers."""
    estimator = (
        dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS
        if profile.autopilot == PX4_AUTOPILOT
        else dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT
    )
    return {
        dialect.MAVLINK_MSG_ID_HEARTBEAT: 5.0,
        dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
        dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        dialect.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
        estimator: 2.0,
    }
