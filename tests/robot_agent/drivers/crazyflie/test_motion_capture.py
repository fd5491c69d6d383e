"""A motion capture system tells the drones that it sees where they are."""

from __future__ import annotations

import queue
import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from polling import wait_until

from nufleet.robot_agent.drivers.crazyflie.motion_capture import (
    MotionCapture,
    Sighting,
    connect_to,
)
from nufleet.robot_agent.drivers.crazyflie.ros2_poses import POSE, Ros2Poses
from nufleet.robot_agent.drivers.crazyflie.settings import MotionCaptureSettings
from nufleet.shared.errors import RobotError


class FakeSystem:
    """Delivers the frames that a test puts into it; None breaks it."""

    def __init__(self) -> None:
        self.frames: queue.SimpleQueue[dict[str, Any] | None] = queue.SimpleQueue()
        self.rigidBodies: dict[str, Any] = {}

    def waitForNextFrame(self) -> None:  # noqa: N802 - as above
        frame = self.frames.get()
        if frame is None:
            raise OSError("the server is gone")
        self.rigidBodies = frame


def body(x: float) -> SimpleNamespace:
    turned = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    return SimpleNamespace(position=[x, 0.0, 0.0], rotation=turned)


def sighting(capture: MotionCapture, name: str, **settings: Any) -> Sighting:
    return Sighting(
        MotionCaptureSettings(system="vicon", hostname="mocap", body=name, **settings), capture
    )


def test_each_drone_is_told_its_own_pose_and_one_connection_serves_all() -> None:
    systems: list[FakeSystem] = []

    def connect(system: str, hostname: str) -> FakeSystem:
        assert (system, hostname) == ("vicon", "mocap")
        systems.append(FakeSystem())
        return systems[-1]

    capture = MotionCapture("vicon", "mocap", connect)
    one, two = sighting(capture, "one"), sighting(capture, "two", attitude=True)
    told: list[tuple[str, float]] = []
    one.begin(lambda position: told.append(("one", position[0])), lambda *_: None)
    two.begin(
        lambda _: None, lambda position, turned: told.append(("two", position[0] + turned[3]))
    )
    assert "does not see body 'one'; it sees none" in str(one.hindrance(1e9))
    (system,) = systems
    system.frames.put({"one": body(1.0), "two": body(2.0), "three": body(np.nan)})
    wait_until(lambda: len(told) == 2)
    assert told == [("one", 1.0), ("two", 3.0)]
    assert one.hindrance(1e9) is None
    assert "it sees one, three, two" in str(one.hindrance(0.0))
    one.end()
    two.end()
    system.frames.put({})
    wait_until(lambda: "motion capture at mocap" not in {t.name for t in threading.enumerate()})


def test_a_body_that_is_named_but_not_seen_is_not_told(monkeypatch: pytest.MonkeyPatch) -> None:
    system = FakeSystem()
    capture = MotionCapture("vicon", "mocap", lambda *_: system)
    one = sighting(capture, "one")
    told: list[float] = []
    one.begin(lambda position: told.append(position[0]), lambda *_: None)
    for x in (np.nan, 4.0):
        system.frames.put({"one": body(x)})
    wait_until(lambda: bool(told))
    assert told == [4.0]
    system.frames.put(None)
    wait_until(lambda: capture.failure is not None)
    assert "the server is gone" in str(one.hindrance(1e9))


def test_a_drone_whose_link_fails_does_not_keep_the_others_from_knowing_where_they_are() -> None:
    system = FakeSystem()
    capture = MotionCapture("vicon", "mocap", lambda *_: system)
    one, two = sighting(capture, "one"), sighting(capture, "two")
    told: list[float] = []

    def fail(*_: object) -> None:
        raise OSError("the link is closed")

    one.begin(fail, fail)
    two.begin(lambda position: told.append(position[0]), lambda *_: None)
    system.frames.put({"one": body(1.0), "two": body(2.0)})
    system.frames.put({"one": body(1.0), "two": body(3.0)})
    wait_until(lambda: told[:1] == [2.0])
    assert "does not see body 'one'" in str(one.hindrance(1e9))
    assert two.hindrance(1e9) is None
    two.end()
    one.end()
    system.frames.put({})
    wait_until(lambda: "motion capture at mocap" not in {t.name for t in threading.enumerate()})


def test_a_system_that_is_not_reached_says_which() -> None:
    pytest.importorskip("motioncapture")
    capture = MotionCapture("no such kind", "mocap", connect_to)
    with pytest.raises(RobotError, match="the no such kind system at mocap was not reached"):
        capture.watch("one", lambda *_: None)


def test_poses_on_ros_2_are_bodies_by_the_names_of_their_topics() -> None:
    poses = Ros2Poses.__new__(Ros2Poses)  # without ROS 2
    listened: list[tuple[str, Any]] = []
    kinds = {
        "/mocap/cf1/pose": [POSE],
        "/mocap/cf1/twist": [POSE],
        "/mocap/cf2/pose": ["geometry_msgs/msg/Pose"],
        "/other/cf3/pose": [POSE],
    }
    poses._before, poses._stamps, poses._coming = "/mocap/", {}, {}
    poses._listen = lambda topic, take: listened.append((topic, take))  # type: ignore[method-assign]
    poses._node = SimpleNamespace(get_topic_names_and_types=lambda: list(kinds.items()))
    poses._look()
    poses._look()
    assert [topic for topic, _ in listened] == ["/mocap/cf1/pose"]

    def message(nanosec: int) -> SimpleNamespace:
        place = SimpleNamespace(x=1.0, y=2.0, z=3.0)
        header = SimpleNamespace(stamp=SimpleNamespace(sec=7, nanosec=nanosec))
        turned = body(0.0).rotation
        return SimpleNamespace(
            header=header, pose=SimpleNamespace(position=place, orientation=turned)
        )

    take = listened[0][1]
    take(message(1))
    assert poses._coming.pop("cf1").position == [1.0, 2.0, 3.0]
    take(message(1))  # a body that is lost may be repeated
    assert poses._coming == {}
    take(message(2))
    assert [*poses._coming] == ["cf1"]


def test_without_ros_2_its_poses_cannot_be_read() -> None:
    with pytest.raises(RobotError, match="over ROS 2 needs rclpy and geometry_msgs"):
        connect_to("ros2", "/mocap")
