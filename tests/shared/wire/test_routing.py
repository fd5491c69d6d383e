"""Routers that are linked: what one serves is reached from the other, whatever happens to links."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any, NoReturn

import pytest
from polling import PATIENCE_S, wait_until
from routers_lab import kept_router

from benchmarks.faults import link
from nufleet.shared.errors import EndpointInUseError, NufleetError
from nufleet.shared.wire import routing
from nufleet.shared.wire.requests import Request
from nufleet.shared.wire.session import Session
from nufleet.shared.wire.transport import open_client


def echo(request: Request) -> None:
    request.answer(request.payload)


def reaches(asker: Session, key: str) -> bool:
    return bool(asker.ask_all(key, b"", timeout_s=1.0))


@pytest.fixture
def soon_deaf(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(routing, "DEAF_WHEN_LINKING_S", 1.0)
    monkeypatch.setattr(routing, "DEAF_WHEN_LINKED_S", 4.0)


@pytest.mark.usefixtures("soon_deaf")
def test_one_fleet_is_served_also_after_the_router_in_the_middle_came_back(tmp_path: Path) -> None:
    at = {name: f"unixsock-stream/{tmp_path}/{name}.sock" for name in ("left", "middle", "right")}
    with ExitStack() as stack:
        for end in ("left", "right"):  # both before the router that they link with
            stack.enter_context(kept_router(at[end], connect=at["middle"]))
        robot = stack.enter_context(open_client(at["left"], timeout_s=PATIENCE_S))
        asker = stack.enter_context(open_client(at["right"], timeout_s=PATIENCE_S))
        robot.serve("robot", echo)
        for _ in range(2):
            with kept_router(at["middle"]):
                wait_until(lambda: reaches(asker, "robot"))
            wait_until(lambda: not asker.ask_all("robot", b"", timeout_s=0.1))


@pytest.mark.usefixtures("soon_deaf")
def test_each_side_is_reached_from_the_other_after_their_link_broke_and_was_back_at_once(
    tmp_path: Path,
) -> None:
    hall, dock = f"unixsock-stream/{tmp_path}/hall.sock", f"unixsock-stream/{tmp_path}/dock.sock"
    with ExitStack() as stack:
        stack.enter_context(kept_router(hall))
        cable = stack.enter_context(link.opened(tmp_path / "hall.sock"))
        stack.enter_context(kept_router(dock, connect=cable.endpoint))
        robot = stack.enter_context(open_client(dock, timeout_s=PATIENCE_S))
        asker = stack.enter_context(open_client(hall, timeout_s=PATIENCE_S))
        robot.serve("robot", echo)
        asker.serve("asker", echo)
        for _ in range(2):
            wait_until(lambda: reaches(asker, "robot") and reaches(robot, "asker"))
            cable.cut()
        wait_until(lambda: reaches(asker, "robot") and reaches(robot, "asker"))


class Site:
    """Stands in for the routers that `route` opens, beside others of which it may hear nothing.

    A second passes with each look; when all is said that a test wants to hear, the router is ended.
    """

    def __init__(self, *said: dict[str, bool], locators: tuple[str, ...] = ()) -> None:
        self.said = iter(said)
        self.locators = list(locators)
        self.refusals: list[NufleetError] = []
        self.ended = threading.Event()
        self.listened: list[list[str]] = []
        self.looks: list[int] = []
        self._now_s = 0.0

    def monotonic(self) -> float:
        self._now_s += 1.0
        return self._now_s

    @contextmanager
    def opening(self, listen: list[str]) -> Iterator[Site]:
        self.listened.append(listen)
        if len(self.listened) > 1 and self.refusals:
            raise self.refusals.pop()
        self.looks.append(0)
        yield self

    def listening_on(self) -> list[str]:
        return self.locators

    def linked_to(self) -> list[str]:
        self.looks[-1] += 1
        self.heard = next(self.said, {})
        if not self.heard:
            self.ended.set()
        return list(self.heard)

    def hears(self, router: str) -> bool:
        return self.heard[router]

    def route(self, monkeypatch: pytest.MonkeyPatch, *listen: str) -> None:
        for name in ("LOOK_EVERY_S", "RETRY_S", "TREE_PAUSE_S"):
            monkeypatch.setattr(routing, name, 0.0)
        monkeypatch.setattr(routing, "time", self)
        opening: Any = self.opening
        routing.route(opening, list(listen), self.ended, lambda _: None, links=True)


DEAF = {"other": False}
HEARS = {"other": True}


def test_a_router_waits_longer_each_time_for_another_that_never_answers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Also if a third one answers at once.
    site = Site(*[DEAF | {"third": True}] * 150)
    site.route(monkeypatch)
    assert site.looks[:3] == [6, 21, 81]


def test_a_router_that_was_heard_again_is_soon_missed_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    site = Site(*[DEAF] * 6, *[DEAF] * 3, HEARS, *[DEAF] * 6, HEARS)
    site.route(monkeypatch)
    assert site.looks == [6, 10, 2]


def test_a_freeze_is_not_taken_for_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    site = Site(DEAF, DEAF, HEARS)
    monkeypatch.setattr(site, "monotonic", iter((0.0, 1.0, 100.0, 101.0, 102.0)).__next__)
    site.route(monkeypatch)
    assert site.looks == [4]


def test_a_router_that_cannot_open_again_at_first_tries_until_it_can(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    site = Site(*[DEAF] * 6, HEARS)
    site.refusals = [EndpointInUseError("tcp/127.0.0.1:7447 is in use") for _ in range(3)]
    site.route(monkeypatch)
    assert len(site.listened) == 5
    assert site.looks == [6, 2]
    assert caplog.text.count("is in use") == 1


def test_a_router_that_cannot_open_at_first_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def opening(listen: list[str]) -> NoReturn:
        raise EndpointInUseError(f"{listen[0]} is in use")

    site = Site()
    monkeypatch.setattr(site, "opening", opening)
    with pytest.raises(EndpointInUseError, match="tcp/here:1 is in use"):
        site.route(monkeypatch, "tcp/here:1")


def test_a_router_that_ends_while_it_is_closed_does_not_open_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    site = Site(*[DEAF] * 6, HEARS)
    opening = site.opening

    @contextmanager
    def ending(listen: list[str]) -> Iterator[Site]:
        with opening(listen) as opened:
            yield opened
        site.ended.set()

    monkeypatch.setattr(site, "opening", ending)
    site.route(monkeypatch)
    assert site.looks == [6]


def test_a_router_keeps_the_ports_that_it_was_given(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = ("tcp/0.0.0.0:0", "tcp/127.0.0.1:0", "udp/[::]:0#iface=lo", "tcp/localhost:7")
    locators = ("tcp/192.0.2.2:91", "tcp/127.0.0.1:92", "udp/[fe80::1]:93", "tcp/127.0.0.1:7")
    site = Site(*[DEAF] * 6, HEARS, locators=locators)
    site.route(monkeypatch, *asked)
    ports = ["tcp/0.0.0.0:91", "tcp/127.0.0.1:92", "udp/[::]:93#iface=lo", "tcp/localhost:7"]
    assert site.listened == [list(asked), ports]
