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
