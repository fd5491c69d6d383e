"""What goes wrong with a vehicle: one sentence each, if possible before it moves."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from mavlink_air import Air, air

from nufleet.shared.errors import OutsideLimitsError, RobotDownError, RobotError
from nufleet.sims.mavlink_vehicle.vehicle import VehicleSettings
from nufleet.sims.mavlink_vehicle.virtual_line import LinkSettings

SYS_STATUS, BATTERY_STATUS = 1, 147
ARM, TAKE_OFF, LAND, INTERVAL, TERMINATE = 400, 22, 21, 511, 185


def at(flown: Air, after_s: float, happens: Callable[[], None]) -> None:
    flown.line.at.append((flown.clock.now_s + after_s, happens))


def test_nothing_moves_without_a_link_or_with_the_wrong_vehicle() -> None:
    deaf = air()
    deaf.line.silent = True
    with pytest.raises(RobotError, match=r"no heartbeat of system 1 arrived at udpin://.* check"):
        deaf.robot.connect()
    assert deaf.robot.health().reason == "it is not connected"
    other = air(vehicle=VehicleSettings(profile="ardupilot"))
    with pytest.raises(RobotError, match="system 1 runs ArduPilot, and the fleet file says"):
        other.robot.connect()


def test_nothing_moves_without_a_position_estimate_and_the_vehicle_says_why() -> None:
    blind = air()
    blind.vehicle.estimates = False
    with pytest.raises(RobotError, match="no LOCAL_POSITION_NED arrived within 5 s: the vehicle"):
        blind.robot.connect()
    lost = air()
    lost.robot.connect()
    lost.vehicle.estimates = False
    lost.vehicle.sends_position = True
    lost.wait(1.0)
    assert "its estimator has no position (flags 0x81)" in lost.robot.health().reason
    with pytest.raises(RobotError, match="its estimator has no position"):
        lost.robot.begin()
    assert ARM not in lost.vehicle.commands


def test_nothing_moves_with_a_clock_that_tells_nothing() -> None:
    mute = air()
    mute.vehicle.answers_timesync = False
    with pytest.raises(RobotError, match="does not answer TIMESYNC"):
        mute.robot.connect()
    slow = air(LinkSettings(delay_s=0.05))
    with pytest.raises(RobotError, match=r"known only to 29 ms.* delay_uncertainty_s is 5 ms"):
        slow.robot.connect()


def test_nothing_moves_with_telemetry_that_is_refused_or_too_slow() -> None:
    refused = air()
    refused.vehicle.refuses[INTERVAL] = ""
    with pytest.raises(RobotError, match="did not accept LOCAL_POSITION_NED at 50 Hz: it denies"):
        refused.robot.connect()
    slow = air()
    slow.vehicle.interval_min_s = 0.1
    with pytest.raises(RobotError, match=r"50 LOCAL_POSITION_NED a second were .*, and 10 arrive"):
        slow.robot.connect()


def test_nothing_moves_on_an_empty_battery_and_the_charge_is_compared_with_the_motion() -> None:
    empty = air(vehicle=VehicleSettings(charge=0.2))
    empty.robot.connect()
    empty.wait(2.0)
    with pytest.raises(RobotError, match=r"its battery is at 20 % \(14\.\d\d V\), and 25 % are"):
        empty.robot.begin()
    assert ARM not in empty.vehicle.commands
    half = air(vehicle=VehicleSettings(charge=0.5), flight_time_s=1000.0)
    half.robot.connect()
    half.wait(2.0)
    health = half.robot.health()
    assert (health.ready, health.battery, health.endurance_s) == (True, 0.5, 250.0)


def test_a_charge_that_no_longer_arrives_is_not_taken_for_the_present_one() -> None:
    silent = air(flight_time_s=1000.0)
    silent.robot.connect()
    silent.wait(2.0)
    for message in (SYS_STATUS, BATTERY_STATUS):
        del silent.vehicle._interval_s[message]
    silent.wait(9.0)
    assert silent.robot.health().battery == 0.9
    silent.wait(3.0)
    health = silent.robot.health()
    assert (health.ready, health.battery, health.endurance_s) == (False, None, None)
    with pytest.raises(RobotError, match=r"charge of its battery has not arrived for 1[12] s"):
        silent.robot.begin()


def test_a_vehicle_with_a_low_battery_is_landed_before_it_is_released() -> None:
    low = air().in_the_air()
    low.vehicle.charge = 0.2
    low.wait(2.0)
    assert not low.robot.health().ready
    low.robot.disconnect()
    assert (low.vehicle.armed, low.vehicle.commands[-1]) == (False, LAND)


def test_a_port_that_cannot_be_read_is_the_reason_that_nothing_moves() -> None:
    cut = air()
    cut.robot.connect()
    cut.line.failure = "serial:///dev/ttyUSB0:57600: nothing arrives any more: unplugged"
    with pytest.raises(RobotError, match="nothing arrives any more: unplugged"):
        cut.robot.begin()
    assert ARM not in cut.vehicle.commands


def test_a_vehicle_that_does_not_arm_says_why_in_its_own_words() -> None:
    stubborn = air()
    stubborn.robot.connect()
    stubborn.vehicle.refuses[ARM] = "Preflight Fail: Compass Sensor 0 missing"
    with pytest.raises(RobotError, match=r"PX4 did not accept arming: it denies it; it says: Pre"):
        stubborn.robot.begin()
    stubborn.robot.end()
    before = stubborn.vehicle.set_points
    stubborn.wait(2.0)
    assert stubborn.vehicle.set_points == before  # no stream is left behind
    assert stubborn.robot.health().ready


def test_a_vehicle_that_is_armed_already_is_not_taken_over() -> None:
    flying = air()
    flying.robot.connect()
    flying.vehicle.armed = flying.vehicle.in_air = True
    flying.wait(1.0)
    asked = len(flying.vehicle.commands)
    with pytest.raises(RobotError, match="is armed already, in position mode: land and disarm it"):
        flying.robot.begin()
    flying.robot.end()
    flying.robot.disconnect()
    assert (len(flying.vehicle.commands), flying.vehicle.set_points) == (asked, 0)


@pytest.mark.parametrize(
    ("profile", "mode", "says"),
    [
        ("px4", "position", r"a pilot took over \(position mode\)"),
        ("px4", "hold", "left offboard mode for hold mode, by a failsafe of its own or a ground"),
        ("ardupilot", "stabilize", r"a pilot took over \(stabilize mode\)"),
    ],
)
def test_a_pilot_or_a_failsafe_that_takes_over_ends_the_motion_and_is_left_alone(
    profile: str, mode: str, says: str
) -> None:
    flown = air(profile=profile).in_the_air()
    at(flown, 1.0, lambda: flown.vehicle.take_over(mode))
    with pytest.raises(RobotDownError, match=says):
        flown.hold(5.0)
    assert not flown.robot.health().ready
    asked, sent = list(flown.vehicle.commands), flown.vehicle.set_points
    for call in (flown.robot.rest, flown.robot.end):
        with pytest.raises(RobotDownError):
            call()
    flown.robot.disconnect()
    flown.wait(2.0)
    assert flown.vehicle.commands == asked
    assert flown.vehicle.set_points - sent <= 3
    assert flown.vehicle.mode == mode


def test_a_battery_that_runs_low_in_the_air_is_named_with_what_the_vehicle_says() -> None:
    flown = air().in_the_air()
    at(flown, 1.0, lambda: setattr(flown.vehicle, "charge", 0.09))
    with pytest.raises(
        RobotDownError, match=r"for return mode, .* it says: Low battery: returning"
    ):
        flown.hold(5.0)


def test_silence_is_bridged_or_ends_the_motion_or_ends_the_flight() -> None:
    flown = air().in_the_air()

    def silence(for_s: float) -> None:
        at(flown, 0.5, lambda: setattr(flown.line, "silent", True))
        at(flown, 0.5 + for_s, lambda: setattr(flown.line, "silent", False))

    silence(0.3)
    flown.hold(2.0)
    flown.robot.rest()
    silence(0.8)
    with pytest.raises(RobotError, match=r"no LOCAL_POSITION_NED has arrived for 0\.5\d s"):
        flown.hold(2.0)
    flown.robot.rest()
    assert flown.vehicle.mode == "offboard"
    silence(2.5)
    with pytest.raises(RobotError, match="no LOCAL_POSITION_NED has arrived"):
        flown.hold(2.0)
    with pytest.raises(RobotDownError, match="left offboard mode for land mode, by a failsafe"):
        flown.robot.rest()


def test_a_vehicle_that_falls_silent_for_good_is_given_up() -> None:
    flown = air().in_the_air()
    flown.line.silent = True
    with pytest.raises(RobotError):
        flown.hold(2.0)
    with pytest.raises(RobotDownError, match="only the vehicle's own failsafe, or a pilot"):
        flown.robot.rest()
    flown.robot.disconnect()


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_a_driver_that_dies_has_the_vehicle_land_by_its_failsafe(profile: str) -> None:
    flown = air(profile=profile).in_the_air()
    flown.line.close()  # nothing beats any more
    flown.wait(12.0)
    assert (flown.vehicle.mode, flown.vehicle.armed) == ("land", False)


@pytest.mark.parametrize(
    ("parameters", "says"),
    [
        (
            {"SYSID_MYGCS": 255.0, "FS_GCS_ENABLE": 5.0},
            "watches system 255 .* set SYSID_MYGCS = 245",
        ),
        (
            {"MAV_GCS_SYSID": 1.0, "FS_GCS_ENABLE": 5.0},
            "watches system 1 .* set MAV_GCS_SYSID = 245",
        ),
        (
            {"SYSID_MYGCS": 245.0, "FS_GCS_ENABLE": 0.0},
            "does nothing when .* set FS_GCS_ENABLE = 5",
        ),
        ({}, "does not tell SYSID_MYGCS or MAV_GCS_SYSID, and FS_GCS_ENABLE"),
    ],
)
def test_an_ardupilot_that_would_not_notice_that_the_driver_dies_is_refused(
    parameters: dict[str, float], says: str
) -> None:
    unaware = air(profile="ardupilot")
    unaware.vehicle.parameters = parameters
    with pytest.raises(RobotError, match=says):
        unaware.robot.connect()


def test_a_vehicle_that_drifts_along_what_is_not_an_axis_leaves_its_limits() -> None:
    flown = air().in_the_air()
    at(flown, 0.5, lambda: flown.vehicle.loop.put(np.array([0.0, 0.0, 2.1])))
    with pytest.raises(
        OutsideLimitsError, match=r"0\.\d+ m away from its origin along z, which is"
    ):
        flown.hold(2.0)


def test_time_stamps_that_go_back_and_two_vehicles_with_one_id_are_found_out() -> None:
    restarted = air()
    restarted.robot.connect()
    restarted.vehicle.clock_jump_s = -100.0
    restarted.wait(0.5)
    says = "time stamps of LOCAL_POSITION_NED went back by 99.5 s: the vehicle restarted, its"
    assert says in restarted.robot.health().reason
    with pytest.raises(RobotError, match="two vehicles answer as system 1; give each its own MAV"):
        restarted.robot.begin()
    two = air()

    def sent_by(source: str) -> None:
        two.line.source = source

    for k in range(20):
        two.line.at.append((0.1 * k, lambda k=k: sent_by(f"10.0.0.{5 + k % 2}")))
    with pytest.raises(RobotDownError, match=r"two vehicles, at 10\.0\.0\.\d and 10\.0\.0\.\d"):
        two.robot.connect()
    assert ARM not in two.vehicle.commands


@pytest.mark.parametrize(("way", "command"), [("disarm", ARM), ("flight-termination", TERMINATE)])
def test_its_motors_are_cut_at_once_and_nothing_more_is_asked_of_it(way: str, command: int) -> None:
    flown = air(kill=way).in_the_air()
    flown.hold(0.5)
    began_s = flown.clock.now_s
    flown.robot.kill()
    assert flown.clock.now_s - began_s < 0.1
    assert (flown.vehicle.armed, flown.vehicle.commands[-1]) == (False, command)
    for call in (lambda: flown.robot.step(np.zeros(2)), flown.robot.rest, flown.robot.end):
        with pytest.raises(RobotDownError, match="its motors were cut"):
            call()
    assert flown.robot.health().reason == "its motors were cut"
    flown.wait(3.0)
    assert flown.vehicle.position[2] == 0.0
    flown.robot.connect()
    assert flown.robot.health().ready


def test_a_cut_that_is_not_answered_is_said_and_repeated_until_it_arrives() -> None:
    flown = air().in_the_air()
    flown.line.silent = True
    with pytest.raises(RobotError, match="did not answer the command that cuts its motors"):
        flown.robot.kill()
    flown.line.silent = False
    flown.wait(0.2)
    assert not flown.vehicle.armed


def stays_on_the_ground(flown: Air) -> bool:
    sent = flown.vehicle.set_points
    flown.wait(3.0)
    return not flown.vehicle.armed and flown.vehicle.set_points <= sent + 1


@pytest.mark.parametrize(
    ("profile", "after_s"), [("px4", 0.5), ("px4", 1.45), ("ardupilot", 0.003)]
)
def test_a_vehicle_whose_motors_are_cut_before_it_is_armed_is_not_armed(
    profile: str, after_s: float
) -> None:
    flown = air(profile=profile)
    flown.robot.connect()
    at(flown, after_s, flown.robot.kill)
    with pytest.raises(RobotDownError, match="its motors were cut"):
        flown.robot.begin()
    assert stays_on_the_ground(flown)


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
@pytest.mark.parametrize("armed", [False, True])
def test_a_vehicle_that_is_stopped_before_it_takes_off_stays_on_the_ground(
    profile: str, *, armed: bool
) -> None:
    flown = air(profile=profile)
    flown.robot.connect()
    answers = iter([False] if armed else [])
    flown.robot.called_off = lambda: next(answers, True)
    with pytest.raises(RobotError, match="it was stopped before it took off"):
        flown.robot.begin()
    flown.robot.end()
    assert stays_on_the_ground(flown)


def test_a_cut_is_repeated_until_the_vehicle_says_that_it_is_disarmed() -> None:
    flown = air()
    flown.robot.connect()
    send = flown.line.send

    def sends(message: object) -> None:
        arms = getattr(message, "command", 0) == ARM and getattr(message, "param1", 0.0) == 1.0
        if arms:  # the order to arm is overtaken by the cut, and its answer is taken for the cut's
            flown.line.send = send  # type: ignore[method-assign]
            with pytest.raises(RobotError, match="was being armed or disarmed, and its answer"):
                flown.robot.kill()
        send(message)

    flown.line.send = sends  # type: ignore[method-assign]
    with pytest.raises(RobotDownError, match="its motors were cut"):
        flown.robot.begin()
    assert stays_on_the_ground(flown)
    asked = len(flown.vehicle.commands)
    flown.wait(1.0)
    assert len(flown.vehicle.commands) == asked  # the repetition has ended


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_a_vehicle_that_is_given_up_is_not_kept_in_the_air(profile: str) -> None:
    blind, restarted = air(profile=profile).in_the_air(), air(profile=profile).in_the_air()
    blind.vehicle.sends_position = False
    with pytest.raises(RobotError, match="no LOCAL_POSITION_NED has arrived"):
        blind.hold(2.0)
    with pytest.raises(RobotDownError, match="nothing has been measured for 3 s"):
        blind.robot.rest()
    restarted.vehicle.clock_jump_s = -100.0
    with pytest.raises(RobotDownError, match="went back by"):
        restarted.hold(2.0)
    for flown in (blind, restarted):
        flown.wait(6.0)
        assert (flown.vehicle.mode, flown.vehicle.armed) == ("land", False)
        assert flown.vehicle.commands.count(LAND) == 1


def test_a_landing_that_is_refused_is_said() -> None:
    flown = air().in_the_air()
    flown.vehicle.refuses[LAND] = "no landing here"
    with pytest.raises(RobotError, match="PX4 did not accept landing: it denies it; it says: no"):
        flown.robot.end()
    del flown.vehicle.refuses[LAND]
    flown.robot.end()
    assert not flown.vehicle.armed
