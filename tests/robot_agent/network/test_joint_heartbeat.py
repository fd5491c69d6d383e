"""Heartbeats of robots that share a session: what is new at once, all else in common messages."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import cast

import pytest
from polling import wait_until

from nufleet.robot_agent.network import heartbeat as heartbeat_module
from nufleet.robot_agent.network.heartbeat import Heartbeat
from nufleet.robot_agent.network.joint_heartbeat import JointHeartbeat, hear_among
from nufleet.robot_agent.network.rivals import SILENCE_S, Rivals
from nufleet.shared.errors import TransportError
from nufleet.shared.wire.bundle import bundled, unbundled
from nufleet.shared.wire.codec import decode, encode
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import RobotState, RobotStatus
from nufleet.shared.wire.requests import Publisher
from nufleet.shared.wire.session import Session

KEYS = FleetKeys("lab")


def a_state(robot: str, sequence: int = 1, progress: float = 0.0, boot: str = "boot") -> RobotState:
    return RobotState(
        robot=robot,
        boot_id=boot,
        sequence=sequence,
        status=RobotStatus.IDLE,
        goal_id=None,
        progress=progress,
        reason="",
        last_goal_id=None,
        robot_time_s=0.1 * sequence,
    )


@dataclass
class Wire:
    """Stands in for a session and its publishers; notes all messages in the order of sending."""

    sent: list[tuple[str, bytes]] = field(default_factory=list)
    handlers: dict[str, Callable[[str, bytes], None]] = field(default_factory=dict)
    broken: bool = False

    def states_publisher(self, key: str) -> WirePublisher:
        return WirePublisher(self, key)

    def subscribe(
        self, key: str, handler: Callable[[str, bytes], None], *, max_bytes: int, own: bool
    ) -> WirePublisher:
        assert not own, "a robot decodes its own heartbeats"
        self.handlers[key] = handler
        return WirePublisher(self, key)

    @property
    def together(self) -> list[dict[str, RobotState]]:
        """The states of each common message."""
        return [
            {robot: decode(frame, RobotState) for robot, frame in unbundled(payload)}
            for key, payload in list(self.sent)
            if key == KEYS.states
        ]

    @property
    def alone(self) -> list[RobotState]:
        """The states that were sent by themselves."""
        return [decode(one, RobotState) for key, one in list(self.sent) if key != KEYS.states]


@dataclass
class WirePublisher:
    wire: Wire
    key: str

    def put(self, payload: bytes) -> None:
        if self.wire.broken:
            raise TransportError("the link is gone")
        self.wire.sent.append((self.key, payload))

    def withdraw(self) -> None:
        """Nothing is declared."""


@pytest.fixture
def wire() -> Wire:
    return Wire()


@pytest.fixture
def joint(wire: Wire) -> Iterator[JointHeartbeat]:
    opened = JointHeartbeat(cast(Session, wire), KEYS)
    yield opened
    opened.close()


def publisher(wire: Wire, robot: str) -> Publisher:
    return cast(Publisher, WirePublisher(wire, KEYS.robot(robot, "state")))


def test_what_robots_hand_in_leaves_in_few_messages(wire: Wire, joint: JointHeartbeat) -> None:
    states = {f"r{k}": a_state(f"r{k}") for k in range(64)}
    for robot, state in states.items():
        joint.hand_in(robot, encode(state))
    wait_until(lambda: sum(map(len, wire.together)) == len(states))
    assert {robot: one for many in wire.together for robot, one in many.items()} == states
    assert len(wire.together) <= 8


def test_no_state_follows_a_later_one_of_its_robot(wire: Wire, joint: JointHeartbeat) -> None:
    own = publisher(wire, "a")
    for sequence in range(1, 200, 2):
        joint.hand_in("a", encode(a_state("a", sequence)))
        joint.overtake("a", own, encode(a_state("a", sequence + 1)))
    joint.hand_in("a", encode(a_state("a", 201)))
    wait_until(lambda: any(many["a"].sequence == 201 for many in wire.together))
    states = [
        one
        for key, payload in wire.sent
        for one in ([f for _, f in unbundled(payload)] if key == KEYS.states else [payload])
    ]
    sequences = [decode(state, RobotState).sequence for state in states]
    assert sequences == sorted(sequences)


def test_a_link_that_is_gone_for_a_while_ends_no_heartbeat(
    wire: Wire, joint: JointHeartbeat, caplog: pytest.LogCaptureFixture
) -> None:
    wire.broken = True
    with caplog.at_level(logging.WARNING):
        joint.hand_in("a", encode(a_state("a", 1)))
        wait_until(lambda: "the link is gone" in caplog.text)
    wire.broken = False
    joint.hand_in("a", encode(a_state("a", 2)))
    wait_until(lambda: wire.together == [{"a": a_state("a", 2)}])


def test_each_robot_hears_what_others_publish_under_its_name_alone(
    wire: Wire, joint: JointHeartbeat, caplog: pytest.LogCaptureFixture
) -> None:
    heard = list[bytes]()
    end = joint.listen("a", lambda key, state: heard.append(state))
    frames = {robot: robot.encode() for robot in ("a", "b")}
    (message,) = bundled(frames, most_bytes=1000)
    wire.handlers[KEYS.states](KEYS.states, message)
    assert heard == [b"a"]
    wire.handlers[KEYS.states](KEYS.states, message[:-1])
    assert "malformed states" in caplog.text
    end()
    wire.handlers[KEYS.states](KEYS.states, message)
    assert heard == [b"a", b"a"]


def test_an_agent_hears_a_rival_that_sends_its_heartbeats_with_those_of_others() -> None:
    now_s = 10.0
    rivals = Rivals("a", "boot", lambda: now_s)

    def hear(boot: str) -> None:
        frames = {robot: encode(a_state(robot, boot=boot)) for robot in ("b", "a")}
        for message in bundled(frames, most_bytes=1000):
            hear_among({"a": rivals.heard}, KEYS.states, message)

    hear("boot")
    assert rivals.refusal() is None
    for _ in range(4):
        hear("another")
        now_s += 0.9 * SILENCE_S
        assert rivals.refusal() is not None
    now_s += 0.2 * SILENCE_S
    assert rivals.refusal() is None


def test_only_a_state_that_says_something_new_is_sent_by_itself(
    wire: Wire, joint: JointHeartbeat, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(heartbeat_module, "HEARTBEAT_S", 0.02)
    progress, sequence, changed = [0.0], [0], threading.Event()

    def state() -> RobotState:
        sequence[0] += 1
        return a_state("a", sequence[0], progress[0])

    def beats_together() -> int:
        return len([many for many in wire.together if many["a"].progress == progress[0]])

    beat = Heartbeat("a", publisher(wire, "a"), state, changed, joint)
    wait_until(lambda: beats_together() >= 3)
    progress[0] = 0.5
    changed.set()
    wait_until(lambda: beats_together() >= 3)
    beat.close()
    first, moved, last = wire.alone
    assert (first.sequence, first.progress) == (1, 0.0)
    assert moved.progress == last.progress == 0.5
    assert last.sequence == sequence[0]
