"""A port whose other side goes away, and what the two threads of a line survive."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from typing import Any

import pytest
from polling import wait_until
from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.robot_agent.drivers.mavlink import link as link_module
from nufleet.robot_agent.drivers.mavlink.link import Link, LinkLine


class Port:
    """A transport that receives what a test gives it."""

    def __init__(self) -> None:
        self.arrives: queue.SimpleQueue[Any] = queue.SimpleQueue()
        self.closed = False

    def receive(self) -> tuple[Any, Any]:
        try:
            data = self.arrives.get(timeout=0.01)
        except queue.Empty:
            return b"", None
        if isinstance(data, Exception):
            raise data
        return data, "vehicle"

    def send(self, data: bytes, to: Any) -> None: ...

    def close(self) -> None:
        self.closed = True


class Ear:
    """Counts what a line asks of it; its beats fail while it `fails`."""

    def __init__(self) -> None:
        self.beats = 0
        self.fails = False

    def receive(self, message: Any, source: object, arrived_s: float) -> None: ...

    def beat(self, now_s: float) -> float:
        self.beats += 1
        if self.fails:
            raise ValueError("no set-point")
        return now_s + 0.001


@pytest.fixture
def ports(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Port]]:
    opened: list[Port] = []

    def open_port(*_: object) -> Port:
        opened.append(Port())
        return opened[-1]

    monkeypatch.setattr(link_module, "opened", open_port)
    yield opened
    assert all(port.closed for port in opened)


def test_a_port_that_closes_is_said_and_opened_again_though_another_vehicle_uses_it(
    ports: list[Port],
) -> None:
    link = Link("tcpout://10.0.0.7:5760")
    one, other, again = (LinkLine(link, system, 1, 245) for system in (1, 2, 1))
    one.open(Ear())
    other.open(Ear())
    ports[0].arrives.put(OSError("the other side closed the connection"))
    wait_until(lambda: one.failure)
    assert "tcpout://10.0.0.7:5760: nothing arrives any more: the other side cl" in one.failure
    one.close()
    again.open(Ear())
    assert (len(ports), ports[0].closed, other.failure) == (2, True, "")
    again.close()
    other.close()


def test_a_packet_that_cannot_be_read_does_not_end_the_reading(ports: list[Port]) -> None:
    line = LinkLine(Link("udpin://0.0.0.0:14540"), 1, 1, 245)
    line.open(Ear())
    ports[0].arrives.put(object())
    heartbeat = dialect.MAVLink_heartbeat_message(2, 12, 0, 0, 3, 3)
    ports[0].arrives.put(heartbeat.pack(dialect.MAVLink(None, srcSystem=7, srcComponent=1)))
    wait_until(lambda: line.heard_systems() == (7,))
    line.close()


def test_set_points_that_cannot_be_sent_are_said_and_tried_again(ports: list[Port]) -> None:
    line, ear = LinkLine(Link("udpin://0.0.0.0:14540"), 1, 1, 245), Ear()
    ear.fails = True
    line.open(ear)
    wait_until(lambda: "cannot be sent: ValueError('no set-point')" in line.failure)
    ear.fails = False
    wait_until(lambda: not line.failure)
    line.close()
    assert len(ports) == 1
