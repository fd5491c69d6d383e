"""Heartbeats of the robots of a session: what is new at once, all else in common messages."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import cast

import pytest
from polling import wait_until

from nufleet.robot_agent.network import heartbeat as heartbeat_module
from nufleet.robot_agent.network.heartbeat import Heartbeat, OnState
from nufleet.robot_agent.network.rivals import SILENCE_S, Rivals
from nufleet.shared.errors import TransportError
from nufleet.shared.wire.bundle import bundled, unbundled
from nufleet.shared.wire.codec import decode, encode
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import RobotState, RobotStatus
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
class Machine:
    """A robot that counts its states."""

    name: str
    progress: float = 0.0
    sequence: int = 0
    status: RobotStatus = RobotStatus.IDLE

    def state(self) -> RobotState:
        self.sequence += 1
        said = a_state(self.name, self.sequence, self.progress)
        return said.model_copy(update={"status": self.status})


@dataclass
class Wire:
    """Stands in for a session and its publishers; notes all messages in the order of sending."""

    identity: object | None = None
    sent: list[tuple[str, bytes]] = field(default_factory=list)
    handlers: dict[str, OnState] = field(default_factory=dict)
    broken: bool = False
    takes_s: float = 0.0

    def states_publisher(self, key: str) -> WirePublisher:
        return WirePublisher(self, key)

    def state_publisher(self, key: str) -> WirePublisher:
        return WirePublisher(self, key)

    def subscribe(self, key: str, handler: OnState, *, max_bytes: int, own: bool) -> WirePublisher:
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

    @property
    def states(self) -> list[RobotState]:
        """All states, in the order of sending."""
        return [
            decode(one, RobotState)
            for key, payload in list(self.sent)
            for one in ([f for _, f in unbundled(payload)] if key == KEYS.states else [payload])
        ]


@dataclass
class WirePublisher:
    wire: Wire
    key: str

    def put(self, payload: bytes) -> None:
        if self.wire.broken:
            raise TransportError("the link is gone")
        time.sleep(self.wire.takes_s)
        self.wire.sent.append((self.key, payload))

    def withdraw(self) -> None:
        """Nothing is declared."""


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(heartbeat_module, "HEARTBEAT_S", 0.02)
    monkeypatch.setattr(heartbeat_module, "TELLING_S", 0.05)


@pytest.fixture
def wire() -> Wire:
    return Wire()


@pytest.fixture
def heartbeat(wire: Wire, quick: None) -> Iterator[Heartbeat]:
    opened = Heartbeat(cast(Session, wire), KEYS)
    yield opened
    opened.close()


def unheard(key: str, state: bytes) -> None:
    raise AssertionError(f"{key}: {state!r} is for another robot")


def joined(heartbeat: Heartbeat, *machines: Machine) -> list[Callable[[], None]]:
    return [heartbeat.join(one.name, one.state, unheard) for one in machines]


def test_robots_that_rest_share_a_message(wire: Wire, heartbeat: Heartbeat) -> None:
    machines = [Machine(f"r{k}") for k in range(64)]
    joined(heartbeat, *machines)
    wait_until(lambda: len(wire.together) >= 3)
    first, second, third = (
        {name: one.sequence for name, one in m.items()} for m in wire.together[-3:]
    )
    assert set(first) == set(second) == set(third) == {one.name for one in machines}
    assert all(third[name] == second[name] + 1 == first[name] + 2 for name in first)
    # Each said by itself that it is there.
    assert sorted(one.robot for one in wire.alone) == sorted(one.name for one in machines)


def test_how_far_robots_have_come_is_said_in_common_messages(
    wire: Wire, heartbeat: Heartbeat
) -> None:
    machines = [Machine(f"r{k}") for k in range(16)]
    joined(heartbeat, *machines)
    for progress in (0.2, 0.4):
        for machine in machines:
            machine.progress = progress
        wait_until(
            lambda: any(
                len(many) == len(machines)
                and all(one.progress == machines[0].progress for one in many.values())
                for many in wire.together
            )
        )
    assert len(wire.alone) == len(machines), "each said by itself that it is there, and no more"


def test_what_is_longer_than_a_message_is_sent_in_several(
    wire: Wire, heartbeat: Heartbeat, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(heartbeat_module, "MAX_STATES_BYTES", 3000)
    names = {f"r{k}" for k in range(64)}
    joined(heartbeat, *map(Machine, sorted(names)))
    wait_until(lambda: {name for many in wire.together for name in many} == names)
    assert all(len(payload) <= 3000 for _, payload in wire.sent)


def test_all_robots_are_heard_of_while_many_have_news(wire: Wire, heartbeat: Heartbeat) -> None:
    machines = [Machine(f"r{k}") for k in range(64)]
    joined(heartbeat, *machines)
    wait_until(lambda: len(wire.alone) == len(machines))
    before = len(wire.sent)
    wire.takes_s = 0.005  # so that the news take as long as many heartbeats
    for machine in machines:
        machine.status = RobotStatus.RUNNING
        heartbeat.change(machine.name).set()
    wait_until(lambda: len(wire.alone) == 2 * len(machines))
    news = [key != KEYS.states for key, _ in wire.sent[before:]]
    while not news[-1]:
        news.pop()
    assert news.count(False) >= 3, news


def test_a_robot_alone_on_its_session_sends_its_states_by_themselves(
    wire: Wire, heartbeat: Heartbeat
) -> None:
    joined(heartbeat, Machine("a"))
    wait_until(lambda: len(wire.alone) >= 5)
    assert wire.together == []


def test_only_a_state_that_says_something_new_is_sent_by_itself(
    wire: Wire, heartbeat: Heartbeat
) -> None:
    moving, resting = Machine("a"), Machine("b")
    changed = heartbeat.change("a")
    leave, _ = joined(heartbeat, moving, resting)

    def beats_together() -> int:
        return len([m for m in wire.together if "a" in m and m["a"].progress == moving.progress])

    wait_until(lambda: beats_together() >= 3)
    moving.progress = 0.5
    changed.set()
    wait_until(lambda: beats_together() >= 3)
    leave()
    first, moved, last = (one for one in wire.alone if one.robot == "a")
    assert (first.sequence, first.progress) == (1, 0.0)
    assert moved.progress == last.progress == 0.5
    assert last.sequence == moving.sequence


def test_a_change_is_not_kept_until_the_next_heartbeat(wire: Wire) -> None:
    heartbeat = Heartbeat(cast(Session, wire), KEYS)
    moving, resting = Machine("a"), Machine("b")
    changed = heartbeat.change("a")
    leaves = joined(heartbeat, moving, resting)
    for progress in (0.1, 0.2, 0.3):
        moving.progress = progress
        changed.set()
        wait_until(lambda: any(one.progress == moving.progress for one in wire.alone))
    for leave in leaves:
        leave()
    heartbeat.close()
    # The other robot, of which there is nothing new, is not asked for each change of the first.
    assert resting.sequence < moving.sequence


def test_no_state_follows_a_later_one_of_its_robot(wire: Wire, heartbeat: Heartbeat) -> None:
    machines = [Machine("a"), Machine("b")]
    changes = [heartbeat.change(one.name) for one in machines]
    leaves = joined(heartbeat, *machines)
    while len(wire.sent) < 100:
        for machine, changed in zip(machines, changes, strict=True):
            machine.progress = 0.5 - machine.progress
            changed.set()
    for leave in leaves:
        leave()
    for machine in machines:
        sequences = [one.sequence for one in wire.states if one.robot == machine.name]
        assert sequences == sorted(sequences)
        assert sequences[-1] == machine.sequence


def test_a_link_that_is_gone_for_a_while_ends_no_heartbeat(
    wire: Wire, heartbeat: Heartbeat, caplog: pytest.LogCaptureFixture
) -> None:
    wire.broken = True
    with caplog.at_level(logging.WARNING):
        joined(heartbeat, Machine("a"), Machine("b"))
        wait_until(lambda: "the link is gone" in caplog.text)
    wire.broken = False
    wait_until(lambda: any(set(many) == {"a", "b"} for many in wire.together))


def test_a_robot_that_cannot_tell_its_state_silences_no_other(
    wire: Wire, heartbeat: Heartbeat, caplog: pytest.LogCaptureFixture
) -> None:
    def state() -> RobotState:
        raise ZeroDivisionError

    heartbeat.join("broken", state, unheard)
    joined(heartbeat, Machine("a"), Machine("b"))
    wait_until(lambda: len(wire.together) >= 3)
    assert "broken cannot tell its state" in caplog.text


def test_each_robot_of_a_closed_fleet_speaks_for_itself(quick: None) -> None:
    wire = Wire(identity="that of the robots")
    heartbeat = Heartbeat(cast(Session, wire), KEYS)
    joined(heartbeat, Machine("a"), Machine("b"))
    wait_until(lambda: min(sum(one.robot == name for one in wire.alone) for name in "ab") >= 5)
    heartbeat.close()
    assert wire.together == []
    assert wire.handlers == {}


def test_each_robot_hears_what_others_publish_under_its_name_alone(
    wire: Wire, heartbeat: Heartbeat, caplog: pytest.LogCaptureFixture
) -> None:
    heard = list[bytes]()
    machine = Machine("a")
    leave = heartbeat.join("a", machine.state, lambda key, state: heard.append(state))
    frames = {robot: robot.encode() for robot in ("a", "b")}
    (message,) = bundled(frames, most_bytes=1000)
    wire.handlers[KEYS.states](KEYS.states, message)
    assert heard == [b"a"]
    wire.handlers[KEYS.states](KEYS.states, message[:-1])
    assert "malformed states" in caplog.text
    leave()
    wire.handlers[KEYS.states](KEYS.states, message)
    assert heard == [b"a", b"a"]


def test_an_agent_hears_a_rival_that_sends_its_heartbeats_with_those_of_others(
    wire: Wire, heartbeat: Heartbeat
) -> None:
    now_s = 10.0
    rivals = Rivals("a", "boot", lambda: now_s)
    heartbeat.join("a", Machine("a").state, rivals.heard)

    def hear(boot: str) -> None:
        frames = {robot: encode(a_state(robot, boot=boot)) for robot in ("b", "a")}
        for message in bundled(frames, most_bytes=1000):
            wire.handlers[KEYS.states](KEYS.states, message)

    hear("boot")
    assert rivals.refusal() is None
    for _ in range(4):
        hear("another")
        now_s += 0.9 * SILENCE_S
        assert rivals.refusal() is not None
    now_s += 0.2 * SILENCE_S
    assert rivals.refusal() is None


def test_a_heartbeat_that_fails_is_not_the_last_one(
    wire: Wire, heartbeat: Heartbeat, caplog: pytest.LogCaptureFixture
) -> None:
    def fail(publisher: WirePublisher, payload: bytes) -> None:
        assert publisher.key == KEYS.states
        raise MemoryError

    joined(heartbeat, Machine("a"), Machine("b"))
    wait_until(lambda: any(set(many) == {"a", "b"} for many in wire.together))
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(WirePublisher, "put", fail)
        wait_until(lambda: "a heartbeat failed" in caplog.text)
    sent = len(wire.together)
    wait_until(lambda: len(wire.together) > sent)


def test_a_robot_that_cannot_tell_its_last_state_leaves_all_the_same(
    wire: Wire, heartbeat: Heartbeat, caplog: pytest.LogCaptureFixture
) -> None:
    def state() -> RobotState:
        raise ZeroDivisionError

    heartbeat.join("broken", state, unheard)()
    assert "broken cannot tell its state" in caplog.text
