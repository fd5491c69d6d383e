"""Real ROS 2 between the driver and a robot in another process; run by `make test-ros2`."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from benchmarks.ros2_plant import Loop, PlantSettings
from nufleet.robot_agent.driver_kit.check import check_robot
from nufleet.robot_agent.drivers.ros2.driver import DRIVER
from nufleet.robot_agent.drivers.ros2.settings import Ros2Settings
from nufleet.robot_agent.robot import Robot
from nufleet.shared.errors import RobotDownError, RobotError
from nufleet.shared.robots.health import Health

pytestmark = [
    pytest.mark.ros2,
    # ROS 2 itself, and a library that it uses.
    pytest.mark.filterwarnings("ignore:Deprecated in favor of:DeprecationWarning"),
    pytest.mark.filterwarnings("ignore:module .sre_:DeprecationWarning"),
]

AXIS = {
    "name": "x",
    "unit": "m",
    "amplitude_max": 0.3,
    "velocity_max": 0.6,
    "acceleration_max": 1.6,
}
FLYING = {
    "arm": "arm",
    "take_off": "take_off",
    "land": "land",
    "kill": "kill",
    "take_off_s": 1.5,
    "land_s": 0.1,
}
DRONE: dict[str, Any] = {
    "kind": "lab-drone",
    "namespace": "/cf1",
    "command": {"topic": "command", "type": "geometry_msgs/msg/PoseStamped"},
    "measurement": {"topic": "measured", "type": "nav_msgs/msg/Odometry"},
    "axes": [{**AXIS, "origin": 0.2}],
    "services": FLYING,
    "idle_s": 20.0,
    "sample_time_s": 0.02,
    "omega_min_rad_s": 0.3,
    "omega_max_rad_s": 8.0,
    "duration_max_s": 240.0,
    "settling_time_s": 2.0,
}
LINK = {"jitter_s": 0.008, "loss": 0.01}

Start = Callable[..., Any]
Build = Callable[..., Robot]


@pytest.fixture
def build(domain: int) -> Build:
    """A function that builds the drone with other settings, disconnected."""

    def built(**changes: Any) -> Robot:
        document = json.dumps({**DRONE, "domain_id": domain, **changes})
        settings = Ros2Settings.model_validate_json(document)
        return DRIVER.build({"drone-1": settings}, np.random.default_rng(0))["drone-1"]

    return built


KINDS: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "poses and odometry over a bad link": ({}, LINK),
    "trajectories and unstamped poses": (
        {
            "command": {"topic": "command", "type": "trajectory_msgs/msg/MultiDOFJointTrajectory"},
            "measurement": {
                "topic": "measured",
                "type": "geometry_msgs/msg/Pose",
                "stamps": "arrival",
            },
        },
        {
            "command": "trajectory_msgs/msg/MultiDOFJointTrajectory",
            "measurement": "geometry_msgs/msg/Pose",
        },
    ),
    "joints on a clock that is ahead, best effort": (
        {
            "command": {
                "topic": "command",
                "type": "trajectory_msgs/msg/JointTrajectory",
                "qos": {"reliability": "best_effort", "depth": 1},
            },
            "measurement": {"topic": "measured", "type": "sensor_msgs/msg/JointState"},
            "axes": [{**AXIS, "name": "elbow", "unit": "rad", "component": "Elbow"}],
            "hold": {"Wrist": 0.2},
            "services": {"kill": "kill"},
        },
        {
            "command": "trajectory_msgs/msg/JointTrajectory",
            "measurement": "sensor_msgs/msg/JointState",
            "components": ["Wrist", "Elbow"],
            "start": {"Elbow": 0.3},
            "clock_ahead_s": 100.0,
            "reliability": "best_effort",
        },
    ),
    "velocities and stamped poses": (
        {
            "command": {"topic": "command", "type": "geometry_msgs/msg/Twist", "gain_1_s": 1.5},
            "measurement": {
                "topic": "measured",
                "type": "geometry_msgs/msg/PoseStamped",
                "stamps": "synchronised",
            },
            "services": {"kill": "kill"},
        },
        {
            "command": "geometry_msgs/msg/Twist",
            "measurement": "geometry_msgs/msg/PoseStamped",
            "start": {"yaw": 1.0},
            "wall_clock": True,
        },
    ),
    "simulated time": ({"use_sim_time": True}, {"publishes_clock": True, "rate_hz": 200.0}),
}


@pytest.mark.parametrize("kind", KINDS)
def test_the_driver_keeps_the_contract(start_plant: Start, build: Build, kind: str) -> None:
    robot, plant = KINDS[kind]
    start_plant(**plant)
    report = check_robot(build(**robot), cuts=True)
    assert not report.failed, str(report)


@pytest.mark.parametrize("ahead_s", [0.0, 40.0])
def test_a_record_is_what_the_loop_answers_to_what_was_sent_when_it_was_sent(
    start_plant: Start, build: Build, ahead_s: float
) -> None:
    # So late that a process which waits for a processor has taken the set-points in time.
    start_plant(**LINK, clock_ahead_s=ahead_s, delay_s=0.3)
    robot = build()
    robot.connect()
    robot.begin()
    reference = 0.15 * np.sin(0.06 * np.arange(501))
    for value in reference:
        robot.step(np.array([value]))
    record = robot.record()
    robot.rest()
    robot.end()
    robot.disconnect()
    assert record is not None
    # The same loop, in this process, behind a link with the same mean delay.
    loop = Loop(PlantSettings(delay_s=0.3 + LINK["jitter_s"]), 0.0, record.sample_s[0])
    for sent_s, value in zip(record.sample_s, reference, strict=True):
        loop.command(value, sent_s)
    within = record.measured_s > record.sample_s[0]
    answered = np.array([loop.output(at_s) for at_s in record.measured_s[within]])
    slope = np.gradient(answered, record.measured_s[within])
    parts = np.stack([answered, slope], axis=1)
    (gain, ahead), *_ = np.linalg.lstsq(parts, record.outputs[within, 0])
    assert gain == pytest.approx(1.0, abs=0.02)
    # Twice the unknown delay that the driver states, and what remains of the jitter.
    assert abs(ahead) < 0.005


REFUSED: dict[str, tuple[dict[str, Any], dict[str, Any] | None, str]] = {
    "no robot": ({}, None, r"no node publishes /cf1/measured; .* \(ROS domain \d+\)"),
    "another type": (
        {"measurement": {"topic": "measured", "type": "geometry_msgs/msg/PoseStamped"}},
        {},
        "/cf1/measured is of type nav_msgs/msg/Odometry at ",
    ),
    "a topic that no node listens on": (
        {"command": {"topic": "cmd", "type": "geometry_msgs/msg/PoseStamped"}},
        {},
        "no node listens on /cf1/cmd; .*: /cf1/cmd, /cf1/command",
    ),
    "a missing service": (
        {"services": {"arm": "enable"}},
        {},
        "no service /cf1/enable; .*/cf1/arm",
    ),
    "no stamps": ({}, {"stamped": False}, 'no time stamp: .* stamps = "arrival"'),
    "stamps that go back": ({}, {"goes_back_every": 20}, "went back by"),
    "a publisher that is silent": ({}, {"falls_silent_after": 0}, "nothing came of x, y, z, yaw"),
    "best effort to a reliable reader": (
        {"measurement": {**DRONE["measurement"], "qos": {"reliability": "reliable"}}},
        {"reliability": "best_effort"},
        "nothing would arrive",
    ),
    "no position estimate": ({}, {"start": {"x": math.nan}}, "reported a x that is not finite"),
    "no clock of the simulation": ({"use_sim_time": True}, {}, "/clock has advanced 0 times"),
    "a slow clock of the simulation": (
        {"use_sim_time": True},
        {"publishes_clock": True, "rate_hz": 20.0},
        "/clock advances by 0.05",
    ),
}


def reach(robot: Robot) -> None:
    """Connect a robot, and measure for a while what is found late."""
    try:
        robot.connect()
        for _ in range(500):
            robot.measure_output()
    finally:
        robot.disconnect()


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_wrong_is_said_before_anything_moves(
    start_plant: Start, build: Build, case: str
) -> None:
    robot, plant, said = REFUSED[case]
    running = None if plant is None else start_plant(**plant)
    with pytest.raises(RobotError, match=said):
        reach(build(**robot))
    assert running is None or running.close() == ["ready"]


def test_two_robots_on_one_namespace_are_refused(start_plant: Start, build: Build) -> None:
    start_plant()
    start_plant()
    with pytest.raises(RobotError, match=r"two robots share a namespace|two programs publish"):
        reach(build())


def test_a_robot_that_another_program_commands_is_refused(start_plant: Start, build: Build) -> None:
    start_plant()
    first, second = build(), build()
    first.connect()
    with pytest.raises(RobotError, match=r"another program sends set-points on /cf1/command"):
        begin_late(second)
    first.disconnect()
    second.disconnect()


def begin_late(robot: Robot) -> None:
    """Begin with a robot that is not ready; on a busy machine, this may not be known at once."""
    robot.connect()
    health_of(robot, ready=False)
    robot.begin()


def health_of(robot: Robot, *, ready: bool) -> Health:
    """Wait until a robot is ready, or is not."""
    while True:
        health = robot.health()
        assert health is not None
        if health.ready is ready:
            return health
        robot.measure_output()


def test_a_refused_take_off_says_why(start_plant: Start, build: Build) -> None:
    plant = start_plant(refuses=["take_off"])
    robot = build()
    robot.connect()
    with pytest.raises(RobotError, match="/cf1/take_off refused: no take_off today"):
        robot.begin()
    robot.end()
    robot.disconnect()
    assert plant.close() == ["ready", "arm True", "take_off", "land", "arm False"]


def test_silence_in_flight_ends_the_motion_and_the_robot_is_landed_and_stays_armed(
    start_plant: Start, build: Build
) -> None:
    plant = start_plant(falls_silent_after=2000)
    robot = build()
    robot.connect()
    robot.begin()
    with pytest.raises(RobotError, match=r"nothing came on /cf1/measured for"):
        robot.run(np.zeros((3000, 1)))
    with pytest.raises(RobotError, match="drone-1 was not disarmed, since it has not been seen"):
        robot.end()
    robot.disconnect()
    assert plant.close()[-1] == "land"


def test_the_battery_is_reported_and_an_empty_one_is_not_ready(
    start_plant: Start, build: Build
) -> None:
    start_plant(battery=0.1)
    robot = build(battery={"topic": "battery", "motion_s": 300.0})
    robot.connect()
    health = health_of(robot, ready=False)
    robot.disconnect()
    assert (health.ready, health.battery, health.endurance_s) == (False, pytest.approx(0.1), 0.0)


def test_cut_motors_stay_cut(start_plant: Start, build: Build) -> None:
    plant = start_plant()
    robot = build()
    robot.connect()
    robot.begin()
    robot.kill()
    with pytest.raises(RobotDownError):
        robot.step(np.zeros(1))
    robot.disconnect()
    assert plant.close()[-1] == "kill"
