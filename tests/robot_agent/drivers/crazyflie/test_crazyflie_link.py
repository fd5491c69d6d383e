"""What the driver makes of cflib's link: a packet that fails blocks none that follows."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from types import SimpleNamespace
from typing import Any

import pytest

from nufleet.robot_agent.drivers.crazyflie.link import guard_sending

pytest.importorskip("cflib")


@pytest.fixture
def flown() -> Iterator[Any]:
    from cflib.crazyflie import Crazyflie

    cf = Crazyflie()
    guard_sending(cf)
    sent: list[int] = []
    cf.link = SimpleNamespace(send_packet=lambda pk: sent.append(pk.port), needs_resending=True)
    cf.sent = sent
    yield cf
    cf.link = None


def packet(size: int = 0) -> Any:
    from cflib.crtp.crtpstack import CRTPPacket

    made = CRTPPacket()
    made.set_header(7, 0)
    made.data = bytes(size)
    return made


def may_be_sent_by_another_thread(cf: Any) -> bool:
    """cflib's lock is free, so that another thread need not wait for it."""
    with ThreadPoolExecutor(1) as other:

        def free() -> bool:
            taken: bool = cf._send_lock.acquire(blocking=False)
            if taken:
                cf._send_lock.release()
            return taken

        return other.submit(free).result()


def test_a_packet_that_cannot_be_sent_blocks_none_that_follows(flown: Any) -> None:
    send, flown.link.send_packet = flown.link.send_packet, None
    for refused, error in ((packet(), TypeError), (packet(99), Exception)):
        with pytest.raises(error):
            flown.send_packet(refused)
        assert may_be_sent_by_another_thread(flown)
    flown.link.send_packet = send
    flown.send_packet(packet())
    assert flown.sent == [7]


def test_a_packet_that_is_answered_as_it_is_repeated_blocks_none_that_follows(flown: Any) -> None:
    class JustAnswered(dict[Any, Any]):
        def __contains__(self, pattern: object) -> bool:
            return True

    flown._answer_patterns = JustAnswered()
    flown._no_answer_do_retry(packet(), (1, 2))
    assert may_be_sent_by_another_thread(flown)


def test_a_link_that_fails_as_it_sends_may_be_closed_by_what_is_told_of_it(flown: Any) -> None:
    flown.link.send_packet = lambda _: flown._link_error_cb("the cable is out")
    told: list[str] = []
    flown.connection_lost.add_callback(lambda _, why: told.append(why))
    flown.disconnected_link_error.add_callback(lambda *_: flown.send_packet(packet()))
    flown.link.close = lambda: None
    flown.send_packet(packet())
    assert may_be_sent_by_another_thread(flown)
    assert flown.link is None


def test_a_packet_goes_nowhere_if_another_thread_closes_the_link_as_it_is_sent(flown: Any) -> None:
    class Closing:
        @property
        def needs_resending(self) -> bool:
            flown.link = None
            return False

    flown.link = Closing()
    flown.send_packet(packet(), expected_reply=(1, 2))
    assert flown.sent == []
    assert may_be_sent_by_another_thread(flown)


def test_an_error_of_a_link_that_is_open_is_not_taken_for_its_end(flown: Any) -> None:
    def send_packet(_packet: Any) -> None:
        raise AttributeError("a mistake")

    flown.link.link_error_callback = flown._link_error_cb
    flown.link.send_packet = send_packet
    with pytest.raises(AttributeError, match="a mistake"):
        flown.send_packet(packet())
    assert may_be_sent_by_another_thread(flown)
