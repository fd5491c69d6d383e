"""Routers that are linked: what one serves is reached from the other, whatever happens to links."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest
from polling import PATIENCE_S, wait_until
from routers_lab import kept_router

from benchmarks.faults import link
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


class Deaf:
    """A session that is linked to one router of which it never hears, and says who looked."""

    def __init__(self, looked: list[str]) -> None:
        self._looked = looked

    def listening_on(self) -> list[str]:
        return ["tcp/127.0.0.1:7447"]

    def linked_to(self) -> list[str]:
        return ["other"]

    def hears(self, router: str) -> bool:
        self._looked.append(router)
        return False


def test_a_router_opens_again_only_once_for_another_that_never_answers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(routing, "LOOK_EVERY_S", 0.001)
    monkeypatch.setattr(routing, "TREE_PAUSE_S", 0.0)
    monkeypatch.setattr(routing, "DEAF_WHEN_LINKING_S", 0.01)
    ended, looked, opened = threading.Event(), list[str](), list[list[str]]()

    @contextmanager
    def opening(listen: list[str]) -> Iterator[Deaf]:
        opened.append(listen)
        looked.clear()
        yield Deaf(looked)

    def say(_endpoints: list[str]) -> None:
        pass

    watcher = threading.Thread(
        target=lambda: wait_until(lambda: len(opened) == 2 and len(looked) > 50) or ended.set()
    )
    watcher.start()
    routing.route(opening, ["tcp/127.0.0.1:0"], ended, say, links=True)  # type: ignore[arg-type]
    watcher.join()
    # An endpoint without a port keeps the port that it was given.
    assert opened == [["tcp/127.0.0.1:0"], ["tcp/127.0.0.1:7447"]]
