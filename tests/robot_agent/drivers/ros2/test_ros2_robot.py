"""A robot on ROS 2 keeps the contract, goes slowly, and says what is wrong; in virtual time."""

from __future__ import annotations

import itertools
import math
from contextlib import suppress
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from ros2_lab import ARM, CART, DRONE, FLYING, Lab, settings

from nufleet.robot_agent.driver_kit.check import check_robot
from nufleet.robot_agent.drivers.ros2.clocks import Arrivals
from nufleet.robot_agent.drivers.ros2.driver import DRIVER
from nufleet.robot_agent.drivers.ros2.node import RosNode
from nufleet.shared.errors import OutsideLimitsError, RobotDownError, RobotError

BATTERY = {"topic": "battery", "motion_s": 400.0}


def flying(**start: float) -> Lab:
    """A drone that has begun."""
    lab = Lab(settings(services=FLYING, hold={"z": 1.0}, battery=BATTERY, idle_s=20.0), **start)
    lab.robot.connect()
    lab.robot.begin()
    return lab


@pytest.mark.parametrize("document", [{**DRONE, "services": {"kill": "kill"}}, ARM, CART])
def test_every_kind_of_robot_keeps_the_contract(document: dict[str, Any]) -> None:
    axes = [axis for axis in document["axes"] if axis["name"] != "y"]
    lab = Lab(settings(document, use_sim_time=True, settling_time_s=1.0, axes=axes))
    report = check_robot(lab.robot)
    assert not report.failed, str(report)


def test_connecting_sends_nothing() -> None:
    lab = Lab(settings(services=FLYING, idle_s=20.0))
    lab.robot.connect()
    assert (lab.link.sent, lab.link.calls) == ([], [])


def test_a_drone_is_armed_takes_off_and_goes_to_its_origin_no_faster_than_it_may() -> None:
    lab = flying(x=1.5, yaw=3.0)
    assert lab.link.calls == [("arm", True), ("take_off", True)]
    x = np.array([point.positions["x"] for point in lab.link.sent])
    assert (x[0], x[-1]) == (pytest.approx(1.5, abs=1e-6), 0.5)
    assert np.abs(np.diff(x)).max() <= 0.5 * 0.6 * 0.02 + 1e-9
    z, yaw = lab.link.sent[-1].positions["z"], lab.link.sent[-1].positions["yaw"]
    assert (z, yaw) == (1.0, pytest.approx(3.0))
    assert lab.robot.measure_output() == pytest.approx([0.0, 0.0], abs=1e-3)


def test_a_yaw_is_measured_and_reached_the_short_way_round() -> None:
    yaw = {"name": "yaw", "unit": "rad", "amplitude_max": 0.3, "velocity_max": 0.6}
    own = settings(axes=[{**yaw, "acceleration_max": 1.6, "origin": -3.0}])
    lab = Lab(own, yaw=3.0)
    lab.robot.connect()
    lab.robot.begin()
    commanded = [point.positions["yaw"] for point in lab.link.sent]
    assert commanded[0] == pytest.approx(3.0 - 2 * math.pi)
    assert np.ptp(commanded) < 0.3


def test_references_count_from_the_origin_at_exact_times() -> None:
    lab = flying()
    del lab.link.sent[:]
    began_s = lab.link.time_s
    for k in range(50):
        lab.robot.step(np.array([0.01 * k, 0.0]))
    assert [point.positions["x"] for point in lab.link.sent] == pytest.approx(
        [0.5 + 0.01 * k for k in range(50)]
    )
    record = lab.robot.record()
    assert np.diff(record.sample_s) == pytest.approx(0.02)
    assert record.sample_s[0] == pytest.approx(began_s)
    assert record.measured_s[0] <= record.sample_s[0]


@pytest.mark.parametrize(
    ("held_up_s", "then_s"), [(0.06, [0.06, 0.01, 0.01, 0.01]), (0.2, [0.2, 0.02, 0.02, 0.02])]
)
def test_a_process_that_was_held_up_catches_up_unless_the_reference_would_jump(
    held_up_s: float, then_s: list[float]
) -> None:
    lab = flying()
    lab.robot.step(np.zeros(2))
    lab.link.wait_until(lab.link.time_s + held_up_s)
    for _ in range(4):
        lab.robot.step(np.zeros(2))
    assert np.diff(lab.robot.record().sample_s) == pytest.approx(then_s)


def test_outputs_are_recorded_at_their_stamps_on_another_clock() -> None:
    lab = flying()
    for k in range(100):
        lab.robot.step(np.array([0.2 * math.sin(0.06 * k), 0.0]))
    record = lab.robot.record()
    # No clock can tell the time that a message travels from an offset.
    assert record.measured_s[-1] == pytest.approx(lab.link.taken_s, abs=1e-6)
    assert record.outputs.shape == (len(record.measured_s), 2)


def test_between_motions_the_robot_is_told_its_place_again_and_again() -> None:
    lab = flying()
    before = len(lab.link.sent)
    for _ in range(100):
        lab.link.tick()
    again = lab.link.sent[before:]
    assert len(again) >= 20
    assert all(point == again[0] for point in again)
    lab.robot.end()
    ended = len(lab.link.sent)
    for _ in range(100):
        lab.link.tick()
    assert len(lab.link.sent) == ended


def test_it_lands_and_disarms() -> None:
    lab = flying()
    lab.robot.end()
    assert lab.link.calls[2:] == [("land", True), ("arm", False)]


def test_a_drone_that_lands_slowly_is_disarmed_only_on_the_ground() -> None:
    lab = flying()
    lab.link.share = 0.0025  # it needs 7.6 s down to 0.15 m, and land_s is 5 s
    heights: list[float] = []
    lab.link.at_call = lambda: heights.append(lab.link.place["z"])
    lab.robot.end()
    assert lab.link.calls[2:] == [("land", True), ("arm", False)]
    assert heights[0] > 0.9
    assert abs(heights[1]) < 0.15


def test_a_drone_that_is_not_seen_to_land_stays_armed_and_is_landed_when_ended_again() -> None:
    lab = flying()
    lab.link.share = 0.0
    with pytest.raises(RobotError, match=r"cf-1 was not disarmed, .*: its z is \+1.00 m from"):
        lab.robot.end()
    assert lab.link.calls[2:] == [("land", True)]
    lab.link.share = 0.1
    lab.robot.end()
    assert lab.link.calls[3:] == [("land", True), ("arm", False)]


def test_a_drone_that_rose_by_set_points_alone_is_not_disarmed_in_the_air() -> None:
    lab = Lab(settings(services={"arm": "arm"}, hold={"z": 1.0}))
    lab.robot.connect()
    lab.robot.begin()
    with pytest.raises(RobotError, match="cf-1 was not disarmed"):
        lab.robot.end()
    assert lab.link.calls == [("arm", True)]


def test_a_drone_that_was_not_armed_here_is_neither_landed_nor_disarmed() -> None:
    axes = [{**DRONE["axes"][0], "output_max": 1.0}]
    lab = Lab(settings(services=FLYING, axes=axes, idle_s=20.0), x=2.0, z=1.0)
    lab.robot.connect()
    with pytest.raises(RobotError, match="outside its limits"):
        lab.robot.begin()
    lab.robot.end()
    assert lab.link.calls == []


def test_a_drone_whose_take_off_and_landing_are_refused_is_disarmed_on_the_ground() -> None:
    lab = Lab(settings(services=FLYING, idle_s=20.0))
    lab.robot.connect()
    lab.link.refusals = {"take_off": "the battery is low", "land": "not in the air"}
    with pytest.raises(RobotError, match="take_off refused"):
        lab.robot.begin()
    lab.robot.end()
    assert lab.link.calls == [("arm", True), ("arm", False)]


def test_a_drone_that_is_commanded_velocities_is_measured_where_it_lands() -> None:
    lab = Lab(settings(CART, services=FLYING, idle_s=20.0))
    lab.robot.connect()
    lab.robot.begin()
    lab.link.share = 0.0
    with pytest.raises(RobotError, match="cf-1 was not disarmed"):
        lab.robot.end()


def test_arming_by_two_services_disarms_by_the_second() -> None:
    lab = Lab(settings(services={"arm": "arm", "disarm": "disarm"}))
    lab.robot.connect()
    lab.robot.begin()
    lab.robot.end()
    assert lab.link.calls == [("arm", True), ("disarm", True)]


def test_a_refused_take_off_ends_before_any_set_point() -> None:
    lab = Lab(settings(services=FLYING, idle_s=20.0))
    lab.robot.connect()
    lab.link.refusals["take_off"] = "the battery is low"
    with pytest.raises(RobotError, match="take_off refused: the battery is low"):
        lab.robot.begin()
    assert lab.link.sent == []


def test_a_robot_outside_its_limits_is_not_moved() -> None:
    axes = [{**DRONE["axes"][0], "output_min": -1.0, "output_max": 1.0}]
    lab = Lab(settings(services=FLYING, axes=axes, idle_s=20.0), x=2.0)
    lab.robot.connect()
    with pytest.raises(RobotError, match=r"cf-1 is at x = 1.5 m, outside its limits -1.0 to 1.0"):
        lab.robot.begin()
    assert (lab.link.calls, lab.link.sent) == ([], [])


def test_a_robot_that_does_not_rise_has_not_begun() -> None:
    lab = Lab(settings(services=FLYING, hold={"z": 1.0}, idle_s=20.0))
    lab.robot.connect()
    lab.link.lift_m = 0.3
    send = lab.link.send
    lab.link.send = lambda point: (send(point), lab.link.goal.pop("z"))[0]  # type: ignore[method-assign]
    with pytest.raises(RobotError, match=r"cf-1 is not at z = 1: it is 0\.7 away"):
        lab.robot.begin()


@pytest.mark.parametrize("call", ["step", "rest"])
def test_a_robot_that_leaves_a_held_place_leaves_its_limits(call: str) -> None:
    lab = flying()
    lab.robot.step(np.zeros(2))
    send = lab.link.send
    lab.link.send = lambda point: (send(point), lab.link.goal.update(z=0.7))[0]  # type: ignore[method-assign]
    lab.link.wait_until(lab.link.time_s + 1.0)
    with pytest.raises(OutsideLimitsError, match=r"cf-1 is not at z = 1: it is 0\.3 away"):
        lab.robot.step(np.zeros(2)) if call == "step" else lab.robot.rest()


@pytest.mark.parametrize("call", ["step", "rest"])
def test_silence_on_the_topic_ends_a_motion_and_its_rest(call: str) -> None:
    lab = flying()
    lab.link.silent = True
    for _ in range(60):
        lab.link.tick()
    with pytest.raises(RobotError, match=r"nothing came on /cf1/measured for [\d.]+ s"):
        lab.robot.step(np.zeros(2)) if call == "step" else lab.robot.rest()
    with pytest.raises(RobotError, match=r"not disarmed, .*: nothing came on /cf1/measured"):
        lab.robot.end()  # it is told to land, and is not seen to
    assert lab.link.calls[-1] == ("land", True)


def test_stamps_that_go_backwards_end_a_motion() -> None:
    lab = flying()
    lab.robot.step(np.zeros(2))
    lab.link.stamp_offset_s = 76.0
    lab.link.tick()
    with pytest.raises(RobotError, match=r"went back by 0.9[89] s"):
        lab.robot.step(np.zeros(2))
    health = lab.robot.health()
    assert not health.ready
    assert "went back" in health.reason


def test_health_tells_the_charge_and_the_time_that_is_left() -> None:
    lab = flying()
    assert lab.robot.health().battery is None
    lab.link.battery = 0.7
    assert lab.robot.health().endurance_s == pytest.approx(200.0)
    lab.link.battery = 0.15
    health = lab.robot.health()
    assert (health.ready, health.endurance_s) == (False, 0.0)
    assert "at 15%, and 20% are kept for landing" in health.reason


def test_killed_motors_move_no_more_until_the_next_connection() -> None:
    lab = flying()
    lab.robot.step(np.zeros(2))
    lab.robot.kill()
    assert lab.link.calls[-1] == ("kill", True)
    for call in (lab.robot.rest, lab.robot.end, lab.robot.begin, lab.robot.measure_output):
        with pytest.raises(RobotDownError, match="its motors were cut"):
            call()
    assert not lab.robot.health().ready
    before = len(lab.link.sent)
    for _ in range(20):
        lab.link.tick()
    assert len(lab.link.sent) == before
    lab.robot.connect()
    lab.robot.begin()


def test_a_kill_during_arming_leaves_the_robot_disarmed_on_the_ground() -> None:
    lab = Lab(settings(services=FLYING, idle_s=20.0))
    lab.robot.connect()
    lab.link.at_call = lambda: lab.robot.kill() if lab.link.calls[-1] == ("arm", True) else None
    with pytest.raises(RobotDownError, match="its motors were cut"):
        lab.robot.begin()
    assert lab.link.calls == [("arm", True), ("kill", True), ("kill", True), ("arm", False)]


def test_a_robot_that_is_stopped_while_it_is_armed_does_not_take_off() -> None:
    lab = Lab(settings(services=FLYING, idle_s=20.0))
    lab.robot.connect()
    lab.robot.called_off = lambda: bool(lab.link.calls)
    with pytest.raises(RobotError, match="it was stopped before it took off"):
        lab.robot.begin()
    lab.robot.end()
    assert lab.link.calls == [("arm", True), ("arm", False)]


def test_a_kill_that_is_not_confirmed_is_repeated_and_the_robot_moves_no_more() -> None:
    lab = flying()
    lab.link.refusals["kill"] = "no"
    before = len(lab.link.sent)

    def waits() -> None:
        for _ in range(20):
            lab.link.tick()

    lab.link.at_call = waits
    with pytest.raises(RobotError, match="kill refused"):
        lab.robot.kill()
    lab.link.at_call = lambda: None
    assert (lab.link.kill_requests, len(lab.link.sent)) == (3, before)
    for call in (lambda: lab.robot.step(np.zeros(2)), lab.robot.rest, lab.robot.begin):
        with pytest.raises(RobotError, match="kill has not confirmed it"):
            call()
    assert not lab.robot.health().ready
    lab.robot.end()
    assert lab.link.calls[-2:] == [("land", True), ("arm", False)]


def test_a_kill_interrupts_a_take_off() -> None:
    lab = Lab(settings(services=FLYING, idle_s=20.0))
    lab.robot.connect()
    lab.link.at_call = lambda: lab.robot.kill() if lab.link.calls[-1][0] == "take_off" else None
    with pytest.raises(RobotDownError):
        lab.robot.begin()
    assert lab.link.sent == []
    # The robot may have been told to cut its motors before it was told to take off.
    assert lab.link.calls[1:4] == [("take_off", True), ("kill", True), ("kill", True)]


def test_without_a_service_that_cuts_motors_kill_says_so() -> None:
    lab = Lab(settings())
    lab.robot.connect()
    with pytest.raises(
        RobotError, match=r"no service that cuts the motors of cf-1 \(services.kill\)"
    ):
        lab.robot.kill()


def test_velocities_follow_the_reference_and_correct_the_distance() -> None:
    lab = Lab(settings(CART), x=0.5, yaw=0.3)
    lab.robot.connect()
    lab.robot.begin()
    lab.robot.step(np.array([0.0, 0.0]))
    lab.robot.step(np.array([0.01, 0.0]))
    newest = lab.link.sent[-1]
    # 10 mm in 20 ms, and three times the distance of 10 mm.
    assert newest.velocities["x"] == pytest.approx(0.53, abs=1e-6)
    assert newest.positions["yaw"] == pytest.approx(0.3)


def test_a_measurement_that_jumps_does_not_command_any_speed() -> None:
    lab = Lab(settings(CART, hold={"z": 0.0}), x=0.5)
    lab.robot.connect()
    lab.robot.begin()
    lab.link.place.update(x=3.5, y=-3.0, z=-3.0)
    lab.link.tick()
    lab.robot._resend()
    assert lab.link.sent[-1].velocities == {"x": -0.6, "y": 0.6, "z": 0.25}


@pytest.mark.parametrize("leaving", ["end", "disconnect", "silence", "freeze"])
def test_a_robot_that_is_commanded_velocities_is_never_left_moving(leaving: str) -> None:
    lab = Lab(settings(CART), x=0.5)
    lab.robot.connect()
    lab.robot.begin()
    lab.robot.step(np.array([0.1, 0.0]))
    assert lab.link.sent[-1].velocities["x"] > 1.0
    if leaving == "silence":
        lab.link.silent = True
        for _ in range(100):
            lab.link.tick()
    elif leaving == "freeze":
        freeze(lab)
    else:
        getattr(lab.robot, leaving)()
    # One message alone may be lost.
    assert [point.velocities for point in lab.link.sent[-5:]] == 5 * [{}]


def test_a_robot_is_not_led_by_a_measurement_that_only_repeats_with_new_stamps() -> None:
    lab = Lab(settings(CART), x=0.5)
    lab.robot.connect()
    lab.robot.begin()
    lab.robot.step(np.zeros(2))
    lab.link.repeats = {**lab.link.place, "x": 0.45}  # 50 mm short of where it shall be
    before = lab.link.place["x"]
    for _ in range(1000):
        lab.link.tick()
    assert lab.link.sent[-1].velocities == {}
    assert lab.link.place["x"] - before < 0.6 * 0.5 + 0.02  # as far as in half a second
    assert "/cf1/measured stays exactly the same while cf-1" in lab.robot.health().reason
    with pytest.raises(RobotError, match="lost to motion capture, or its estimator stands still"):
        lab.robot.rest()
    lab.link.repeats = None
    lab.link.tick()
    assert lab.robot.health().ready
    lab.robot.rest()
    assert lab.robot.measure_output() == pytest.approx([0.0, 0.0], abs=1e-3)


def freeze(lab: Lab) -> None:
    """Let time pass without the driver, as for a process that is stopped, and then with it."""
    lab.link.time_s += 5.0
    for _ in range(20):
        with suppress(RobotError):  # as the thread of the node does
            lab.link.tick()


def test_a_robot_that_was_sent_nothing_for_long_is_not_moved_again_and_is_landed() -> None:
    lab = flying()
    before = len(lab.link.sent)
    freeze(lab)
    for call in (lambda: lab.robot.step(np.zeros(2)), lab.robot.rest):
        with pytest.raises(RobotError, match=r"cf-1 was sent no set-point for 5 s, since this"):
            call()
    assert len(lab.link.sent) == before
    lab.robot.end()
    assert lab.link.calls[-2:] == [("land", True), ("arm", False)]


def test_a_robot_that_is_measured_no_more_is_not_flown_home() -> None:
    lab = flying()
    lab.robot.step(np.array([0.2, 0.0]))
    lab.link.silent = True
    for _ in range(60):
        lab.link.tick()
    with pytest.raises(RobotError, match="nothing came on"):
        lab.robot.rest()
    assert {point.positions["x"] for point in lab.link.sent[-10:]} == {0.7}


def test_measurements_that_arrive_long_after_they_were_taken_end_a_motion() -> None:
    lab = flying()
    lab.robot.step(np.zeros(2))
    lab.link.stamp_offset_s -= 0.7
    lab.link.time_s += 0.7
    lab.link.tick()
    with pytest.raises(RobotError, match=r"what comes on /cf1/measured is 0.7 s old: check the"):
        lab.robot.step(np.zeros(2))
    assert not lab.robot.health().ready


def test_a_process_that_was_held_up_does_not_hurry_a_robot_home() -> None:
    lab = flying()
    lab.robot.step(np.array([0.3, 0.0]))
    wait, waits = lab.link.wait_until, itertools.count()

    def held_up(due_s: float) -> None:
        wait(due_s + (0.3 if next(waits) == 20 else 0.0))

    lab.link.wait_until = held_up  # type: ignore[method-assign]
    first = len(lab.link.sent)
    lab.robot.rest()
    x = np.array([point.positions["x"] for point in lab.link.sent[first:]])
    moves = np.flatnonzero(np.diff(x, prepend=0.8))
    speeds = np.abs(np.diff(x[moves])) / np.diff(np.array(lab.link.sent_s[first:])[moves])
    assert speeds.max() <= 0.5 * 0.6 + 1e-6


def test_the_ground_is_where_the_robot_was_armed_also_when_it_is_connected_again() -> None:
    lab = Lab(settings(services={"arm": "arm"}, hold={"z": 1.0}))
    lab.robot.connect()
    lab.robot.begin()
    for _ in range(2):
        with pytest.raises(RobotError, match=r"not disarmed, .*: its z is \+1.00 m from where"):
            lab.robot.end()
        lab.start = {"z": 1.0}  # it still hovers
        lab.robot.connect()
        lab.robot.begin()


def test_a_robot_that_hovers_before_it_was_armed_is_left_as_it_is() -> None:
    lab = Lab(settings(services=FLYING, hold={"z": 1.0}, idle_s=20.0), z=0.95)
    lab.robot.connect()
    with pytest.raises(RobotError, match=r"cf-1 is at z = 0.95, where it shall hover \(z = 1\)"):
        lab.robot.begin()
    lab.robot.end()
    assert lab.link.calls == []


def test_a_robot_that_answers_and_stays_on_the_ground_is_not_moved_there() -> None:
    lab = Lab(settings(services=FLYING, idle_s=20.0))
    lab.robot.connect()
    lab.link.lift_m = 0.1
    with pytest.raises(RobotError, match=r"cf-1 has not taken off: its z is \+0.10 m from"):
        lab.robot.begin()
    assert lab.link.sent == []
    lab.robot.end()
    assert lab.link.calls[2:] == [("land", True), ("arm", False)]


def test_a_robot_that_is_measured_no_more_while_it_is_armed_does_not_take_off() -> None:
    lab = Lab(settings(services=FLYING, idle_s=20.0))
    lab.robot.connect()

    def silence() -> None:
        lab.link.silent = True
        lab.link.wait_until(lab.link.time_s + 1.0)

    lab.link.at_call = silence
    with pytest.raises(RobotError, match="nothing came on /cf1/measured"):
        lab.robot.begin()
    assert lab.link.calls == [("arm", True)]


def test_topics_and_services_are_looked_at_again_before_a_robot_is_armed() -> None:
    lab = Lab(settings(services=FLYING, idle_s=20.0))
    lab.robot.connect()
    lab.link.found = "another program sends set-points on /cf1/command"
    with pytest.raises(RobotError, match="another program sends set-points"):
        lab.robot.begin()
    assert lab.link.calls == []
    assert lab.robot.health().reason == lab.link.found


def test_a_simulation_that_is_slow_is_not_told_its_place_between_two_samples() -> None:
    told: list[str] = []
    link = SimpleNamespace(
        _settings=settings(), _resend=lambda: told.append("again"), _sent_s=7.0, now_s=lambda: 7.01
    )
    RosNode._repeat(link)  # type: ignore[arg-type]
    assert told == []
    link.now_s = lambda: 7.04
    RosNode._repeat(link)  # type: ignore[arg-type]
    assert told == ["again"]


def test_a_link_that_is_closed_while_its_health_is_asked_for_says_so() -> None:
    link = RosNode.__new__(RosNode)  # without ROS 2
    link._closed = False

    def closed_meanwhile() -> None:
        link._closed = True
        raise ValueError("the node has been destroyed")

    link._problem = closed_meanwhile  # type: ignore[method-assign]
    assert link.problem() == "it has been disconnected"


def test_what_is_measured_before_the_first_time_of_a_simulation_is_passed_over() -> None:
    own = settings(use_sim_time=True)
    place, turn = dict.fromkeys("xyz", 0.0), {"x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0}
    pose = SimpleNamespace(position=SimpleNamespace(**place), orientation=SimpleNamespace(**turn))
    message = SimpleNamespace(
        header=SimpleNamespace(stamp=SimpleNamespace(sec=1000, nanosec=0)),
        pose=SimpleNamespace(pose=pose),
    )
    kept = Arrivals("/cf1/measured", own.measured, "simulated")
    link = SimpleNamespace(_settings=own, arrivals=kept, now_s=lambda: 0.0)
    RosNode._received(link, message, {})  # type: ignore[arg-type]
    assert kept.newest() is None
    link.now_s = lambda: 1000.0
    RosNode._received(link, message, {})  # type: ignore[arg-type]
    newest = kept.newest()
    assert newest is not None
    assert newest.late_s == 0.0


def test_two_robots_that_take_the_same_set_points_have_one_address() -> None:
    first, second = settings(), settings(domain_id=3)
    other = settings(namespace="/cf2")
    assert DRIVER.address(first) == "/cf1/command in the ROS domain ROS_DOMAIN_ID"
    assert len({DRIVER.address(one) for one in (first, settings(), second, other)}) == 3


def test_the_driver_builds_robots_without_ros() -> None:
    own = settings()
    (robot,) = DRIVER.build({"cf-1": own}, np.random.default_rng(0)).values()
    assert robot.spec == own.spec()
    with pytest.raises(
        RobotError, match=r"ROS 2 cannot be imported \(.*\): run `source .*/setup.bash"
    ):
        robot.connect()
    with pytest.raises(RobotError, match="cf-1 is not connected"):
        robot.step(np.zeros(2))


def test_whether_a_robot_has_risen_is_told_by_a_measurement_of_afterwards() -> None:
    services = {**FLYING, "take_off_s": 0.4}
    lab = Lab(settings(services=services, idle_s=20.0))
    lab.robot.connect()
    tick = lab.link.tick

    def silence() -> None:
        lab.link.silent = len(lab.link.calls) == 2

    def heard_again() -> None:
        lab.link.silent = False
        tick()

    lab.link.at_call = silence
    lab.link.arrivals.tick = heard_again  # while the next measurement is waited for
    lab.robot.begin()
    assert lab.link.calls == [("arm", True), ("take_off", True)]
