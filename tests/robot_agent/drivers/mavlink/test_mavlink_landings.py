"""A vehicle comes down again, also when it is not told to, or does not hear it."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from mavlink_air import Air, air

from nufleet.shared.errors import OutsideLimitsError, RobotDownError, RobotError

ARM, LAND = 400, 21
HEARTBEAT, EXTENDED_SYS_STATE = 0, 245


def comes_down(flown: Air) -> bool:
    flown.wait(12.0)
    return not flown.vehicle.in_air and not flown.vehicle.armed


def deaf_to(flown: Air, command: int) -> None:
    """The vehicle hears all but one command, which gets lost each time."""
    send = flown.line.send
    lost = lambda message: getattr(message, "command", 0) == command  # noqa: E731
    flown.line.send = lambda message: None if lost(message) else send(message)  # type: ignore[method-assign]


def silent_about(flown: Air, message: int) -> None:
    """The vehicle no longer sends one message."""
    flown.vehicle._interval_s.pop(message)


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_a_vehicle_that_does_not_take_its_landing_is_left_to_its_failsafe(profile: str) -> None:
    refusing, deaf = air(profile=profile).in_the_air(), air(profile=profile).in_the_air()
    refusing.vehicle.refuses[LAND] = ""
    deaf_to(deaf, LAND)
    for flown in (refusing, deaf):
        with pytest.raises(RobotError, match=r"did not (accept|answer) landing"):
            flown.robot.end()
        assert comes_down(flown)


@pytest.mark.parametrize("profile", ["px4", "ardupilot"])
def test_a_vehicle_that_is_given_up_and_does_not_hear_its_landing_comes_down(profile: str) -> None:
    flown = air(profile=profile).in_the_air()
    deaf_to(flown, LAND)
    flown.vehicle.clock_jump_s = -100.0
    with pytest.raises(RobotDownError, match="went back by"):
        flown.hold(2.0)
    assert comes_down(flown)


def test_a_vehicle_whose_mode_is_not_known_is_not_moved_on() -> None:
    flown = air().in_the_air()
    silent_about(flown, HEARTBEAT)
    with pytest.raises(
        RobotDownError, match=r"no heartbeat has arrived for 3\.5 s, so its mode is"
    ):
        flown.hold(5.0)
    assert LAND not in flown.vehicle.commands  # a pilot may fly it by now


def test_a_climb_in_which_nothing_is_measured_any_more_ends() -> None:
    flown = air(height_m=10.0)
    flown.robot.connect()
    flown.line.at.append((flown.clock.now_s + 4.0, lambda: silent_about(flown, 32)))
    with pytest.raises(RobotDownError, match="nothing has been measured for 3 s"):
        flown.robot.begin()
    assert flown.vehicle.position[2] < 6.0
    flown.wait(0.1)
    assert LAND in flown.vehicle.commands


def test_a_vehicle_that_arms_after_it_was_given_up_is_disarmed_on_the_ground() -> None:
    flown = air()
    flown.robot.connect()
    obey = flown.vehicle._arm

    def armed_late(on: bool, *, forced: bool) -> int:
        at_s = flown.clock.now_s + 0.5
        if on:
            flown.line.at.append((at_s, lambda: obey(on, forced=forced)))  # type: ignore[arg-type]
            return 4
        return obey(on, forced=forced)

    flown.vehicle._arm = armed_late  # type: ignore[method-assign]
    with pytest.raises(RobotError, match="did not accept arming: it failed"):
        flown.robot.begin()
    flown.robot.end()
    flown.wait(0.8)
    assert not flown.vehicle.armed
    assert LAND in flown.vehicle.commands


def test_a_vehicle_of_which_it_is_not_known_whether_it_is_armed_is_said() -> None:
    flown = air()
    flown.robot.connect()
    flown.vehicle.refuses[ARM] = ""
    with pytest.raises(RobotError, match="did not accept arming"):
        flown.robot.begin()
    flown.line.silent = True
    with pytest.raises(RobotError, match="does not say whether it is armed: keep away from it"):
        flown.robot.end()


def test_an_old_word_of_standing_on_the_ground_is_none_while_it_lands() -> None:
    flown = air()
    flown.robot.connect()
    flown.wait(1.0)
    silent_about(flown, EXTENDED_SYS_STATE)
    flown.robot.begin()
    flown.robot.end()
    assert not flown.vehicle.armed
    assert flown.vehicle.commands.count(ARM) == 1  # it disarms itself; in the air it would refuse


def test_a_vehicle_whose_position_has_jumped_is_not_flown_by_the_jump() -> None:
    flown = air().in_the_air()
    flown.hold(0.2)
    flown.vehicle.loop.put(np.array([2.0, 0.0, 1.5]))
    flown.wait(0.1)
    with pytest.raises(OutsideLimitsError, match=r"\d m away from its set-point, .* \(1\.5 m\)"):
        flown.robot.rest()
    flown.robot.end()
    assert not flown.vehicle.armed


def test_a_clock_that_contradicts_itself_or_dates_nothing_is_refused() -> None:
    torn = air()
    receive, numbers = torn.vehicle.receive, iter(range(10**9))

    def answers(message: Any, now_s: float) -> list[Any]:
        asked = message.get_type() == "TIMESYNC"
        torn.vehicle.clock_jump_s = 0.2 * (asked and next(numbers) % 2)
        told = receive(message, now_s)
        torn.vehicle.clock_jump_s = 0.0
        return told

    torn.vehicle.receive = answers  # type: ignore[method-assign]
    with pytest.raises(RobotError, match="answers to TIMESYNC contradict one another"):
        torn.robot.connect()
    two_clocks = air()
    measured = two_clocks.vehicle.measured

    def shifted() -> tuple[float, np.ndarray, np.ndarray]:
        at_s, place, velocity = measured()
        return at_s + 1e6, place, velocity

    two_clocks.vehicle.measured = shifted  # type: ignore[method-assign]
    with pytest.raises(RobotError, match=r"LOCAL_POSITION_NED are \+1e\+06 s off the clock"):
        two_clocks.robot.connect()
