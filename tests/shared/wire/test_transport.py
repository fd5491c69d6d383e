"""The network: real routers and clients over Unix sockets in a directory of the test's own."""

from __future__ import annotations

import logging
import queue
import signal
import subprocess
import sys
import threading
import time
import tracemalloc
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress
from pathlib import Path

import pytest
import zenoh
from polling import PATIENCE_S, wait_until

from nufleet.shared.errors import (
    EndpointInUseError,
    InvalidInputError,
    NoRouterError,
    NufleetError,
    TransportError,
)
from nufleet.shared.wire import requests, transport
from nufleet.shared.wire.requests import Request
from nufleet.shared.wire.session import Session
from nufleet.shared.wire.transport import open_client, open_router


@pytest.fixture(autouse=True)
def _no_thread_is_left() -> Iterator[None]:
    before = set(threading.enumerate())
    yield
    wait_until(lambda: set(threading.enumerate()) <= before)


@pytest.fixture
def endpoint(tmp_path: Path) -> str:
    return f"unixsock-stream/{tmp_path}/r.sock"


@pytest.fixture
def router(endpoint: str) -> Iterator[Session]:
    with open_router([endpoint]) as session:
        yield session


@pytest.fixture
def clients(router: Session, endpoint: str) -> Iterator[Callable[[], Session]]:
    with ExitStack() as stack:
        yield lambda: stack.enter_context(open_client(endpoint, timeout_s=PATIENCE_S))


def echo(request: Request) -> None:
    request.answer(request.key.encode() + b":" + request.payload)


def served(asker: Session, key: str) -> None:
    """Wait until a key is served: its declaration has to pass through the router."""
    wait_until(lambda: bool(asker.ask_all(key, b"", timeout_s=1.0)))


# Asking.


def test_a_question_gets_its_answer(clients: Callable[[], Session]) -> None:
    server, asker = clients(), clients()
    server.serve("lab/robot/a/**", echo)
    served(asker, "lab/robot/a/goal")
    for payload in (b"", b"hello", bytes(range(256)) * 4000):
        said = asker.ask_all("lab/robot/a/goal", payload, timeout_s=PATIENCE_S)
        assert said == [b"lab/robot/a/goal:" + payload]


def test_an_answer_may_come_later_and_from_another_thread(clients: Callable[[], Session]) -> None:
    server, asker = clients(), clients()
    waiting: queue.Queue[Request] = queue.Queue()
    server.serve("later", waiting.put)

    def answer_two() -> None:
        first, second = waiting.get(timeout=PATIENCE_S), waiting.get(timeout=PATIENCE_S)
        second.answer(b"second" + second.payload)
        first.answer(b"first" + first.payload)

    worker = threading.Thread(target=answer_two)
    worker.start()
    said: dict[bytes, bytes] = {}

    def ask(payload: bytes) -> None:
        (said[payload],) = asker.ask_all("later", payload, timeout_s=PATIENCE_S)

    # What is declared after a queryable is seen after it: a link keeps the order.
    server.declare_alive("ready")
    wait_until(lambda: bool(asker.alive("ready", timeout_s=PATIENCE_S)))
    askers = [threading.Thread(target=ask, args=(payload,)) for payload in (b"1", b"2")]
    for thread in askers:
        thread.start()
    for thread in [*askers, worker]:
        thread.join(PATIENCE_S)
    assert sorted(reply[-1:] for reply in said.values()) == [b"1", b"2"]
    assert all(reply.endswith(payload) for payload, reply in said.items())


def test_nobody_there_gives_no_reply_at_once(clients: Callable[[], Session]) -> None:
    began_s = time.monotonic()
    assert clients().ask_all("lab/nobody", b"", timeout_s=PATIENCE_S) == []
    assert time.monotonic() - began_s < PATIENCE_S / 2


def test_no_answer_in_time_is_no_reply(clients: Callable[[], Session]) -> None:
    server, asker = clients(), clients()
    held: list[Request] = []
    server.serve("silent", held.append)
    while len(held) < 5:
        assert asker.ask_all("silent", b"", timeout_s=0.05) == []


def test_a_handler_that_fails_ends_its_query_and_serves_on(
    clients: Callable[[], Session], caplog: pytest.LogCaptureFixture
) -> None:
    server, asker = clients(), clients()

    def handler(request: Request) -> None:
        if request.payload == b"bad":
            raise RuntimeError("a mistake")
        echo(request)

    server.serve("fragile", handler)
    served(asker, "fragile")
    began_s = time.monotonic()
    with caplog.at_level(logging.ERROR):
        assert asker.ask_all("fragile", b"bad", timeout_s=PATIENCE_S) == []
    assert time.monotonic() - began_s < PATIENCE_S / 2
    assert "a query on 'fragile' could not be answered" in caplog.text
    assert asker.ask_all("fragile", b"good", timeout_s=PATIENCE_S) == [b"fragile:good"]


def test_a_query_is_answered_once(clients: Callable[[], Session]) -> None:
    server, asker = clients(), clients()
    second: queue.Queue[Exception | None] = queue.Queue()

    def handler(request: Request) -> None:
        request.answer(b"one")
        try:
            request.answer(b"two")
        except TransportError as error:
            second.put(error)
        else:
            second.put(None)

    server.serve("once", handler)
    served(asker, "once")
    assert asker.ask_all("once", b"", timeout_s=PATIENCE_S) == [b"one"]
    assert isinstance(second.get(timeout=PATIENCE_S), TransportError)


def test_everyone_who_serves_a_key_is_heard(clients: Callable[[], Session]) -> None:
    asker = clients()
    for name in (b"a", b"b", b"c"):
        clients().serve("twin", lambda request, name=name: request.answer(name))  # type: ignore[misc]
    wait_until(lambda: len(asker.ask_all("twin", b"", timeout_s=PATIENCE_S)) == 3)
    assert sorted(asker.ask_all("twin", b"", timeout_s=PATIENCE_S)) == [b"a", b"b", b"c"]


def test_a_question_to_many_keys_is_known_as_one_and_every_answer_arrives(
    clients: Callable[[], Session],
) -> None:
    asker = clients()

    def handler(request: Request) -> None:
        request.answer(f"{request.is_wildcard} {request.size_bytes}".encode())

    for robot in range(8):
        clients().serve(f"lab/{robot}/**", handler)
    for robot in range(8):
        served(asker, f"lab/{robot}/goal")
    assert asker.ask_all("lab/*/goal", b"xyz", timeout_s=PATIENCE_S) == [b"True 3"] * 8
    assert asker.ask_all("lab/3/goal", b"xyz", timeout_s=PATIENCE_S) == [b"False 3"]


def test_a_closed_session_says_so(clients: Callable[[], Session]) -> None:
    session = clients()
    publisher = session.telemetry_publisher("lab/telemetry")
    session.close()
    session.close()
    for use in (
        lambda: session.ask_all("lab/x", b"", timeout_s=1.0),
        lambda: session.put_urgent("lab/x", b""),
        lambda: session.serve("lab/x", echo),
        lambda: session.alive("lab/*", timeout_s=1.0),
        lambda: session.declare_alive("lab/x"),
        lambda: session.state_publisher("lab/x"),
        lambda: publisher.put(b""),
    ):
        with pytest.raises(TransportError):
            use()


def test_a_key_that_is_none_says_so(clients: Callable[[], Session]) -> None:
    with pytest.raises(TransportError, match="Invalid Key Expr"):
        clients().ask_all("lab//x", b"", timeout_s=1.0)


# Publishing and being alive.


def test_a_late_joiner_gets_the_last_state_and_then_every_new_one(
    clients: Callable[[], Session],
) -> None:
    robot = clients()
    publisher = robot.state_publisher("lab/robot/a/state")
    for k in range(5):
        publisher.put(b"old %d" % k)
    robot.alive("lab/**", timeout_s=PATIENCE_S)  # the router answers what came before first
    late = clients()
    heard: queue.Queue[tuple[str, bytes]] = queue.Queue()
    late.subscribe_state("lab/robot/*/state", lambda key, payload: heard.put((key, payload)))
    assert heard.get(timeout=PATIENCE_S) == ("lab/robot/a/state", b"old 4")
    publisher.put(b"new")
    assert heard.get(timeout=PATIENCE_S) == ("lab/robot/a/state", b"new")
    assert heard.empty()


def test_serving_everything_below_a_key_leaves_its_states_history_alone(
    clients: Callable[[], Session],
) -> None:
    robot, late = clients(), clients()
    asked: list[str] = []

    def handler(request: Request) -> None:
        asked.append(request.key)
        request.answer(b"not a state")

    robot.serve("lab/robot/a/**", handler)
    robot.state_publisher("lab/robot/a/state").put(b"idle")
    heard: queue.Queue[bytes] = queue.Queue()
    late.subscribe_state("lab/robot/*/state", lambda _key, payload: heard.put(payload))
    assert heard.get(timeout=PATIENCE_S) == b"idle"
    served(late, "lab/robot/a/goal")
    assert asked
    assert set(asked) == {"lab/robot/a/goal"}


LISTENER = """
import sys
from nufleet.shared.wire.limits import MAX_STATES_BYTES
from nufleet.shared.wire.transport import open_client

with open_client(sys.argv[1], timeout_s=60.0) as session:
    def listen(key, payload):
        print(payload[0], flush=True)
    session.subscribe("states", listen, max_bytes=MAX_STATES_BYTES)
    sys.stdin.read()
"""


def test_a_program_that_does_not_get_the_processor_misses_no_states_of_many_robots(
    clients: Callable[[], Session], endpoint: str
) -> None:
    states = clients().states_publisher("states")
    with subprocess.Popen(
        [sys.executable, "-c", LISTENER, endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as listener:
        assert listener.stdin is not None
        assert listener.stdout is not None
        wait_until(lambda: states.heard)
        listener.send_signal(signal.SIGSTOP)
        for number in range(8):  # as much as 500 robots say in two seconds
            states.put(bytes([number]) * 100_000)
            time.sleep(0.05)  # so that it is the router that waits, not this session
        listener.send_signal(signal.SIGCONT)
        states.put(bytes([8]))
        heard = []
        while heard[-1:] != [8]:
            heard.append(int(listener.stdout.readline()))
        listener.stdin.close()
    assert heard == list(range(9))


def test_a_publisher_that_appears_later_is_heard_too(clients: Callable[[], Session]) -> None:
    heard: queue.Queue[bytes] = queue.Queue()
    clients().subscribe_state("lab/robot/*/state", lambda _key, payload: heard.put(payload))
    clients().state_publisher("lab/robot/b/state").put(b"hello")
    assert heard.get(timeout=PATIENCE_S) == b"hello"


def test_what_is_too_long_is_told_of_without_a_copy_of_it(
    clients: Callable[[], Session], caplog: pytest.LogCaptureFixture
) -> None:
    heard: queue.Queue[bytes] = queue.Queue()
    listener, sender = clients(), clients()
    listener.subscribe("lab/stop", lambda _key, payload: heard.put(payload), max_bytes=64)
    listener.subscribe_state("lab/state", lambda _key, payload: heard.put(payload))
    sender.declare_alive("ready")
    wait_until(lambda: bool(listener.alive("ready", timeout_s=PATIENCE_S)))
    long, most = bytes(8 * 2**20), bytes(64)
    tracemalloc.start()
    try:
        for key in ("lab/stop", "lab/state"):
            for _ in range(6):
                sender.put_urgent(key, long)
                assert heard.get(timeout=PATIENCE_S) == b""
            sender.put_urgent(key, most)
            assert heard.get(timeout=PATIENCE_S) == most
        assert tracemalloc.get_traced_memory()[1] < 2**20
    finally:
        tracemalloc.stop()
    assert "8388608 bytes were put on 'lab/stop'; at most 64 are accepted" in caplog.text


def test_no_thread_waits_for_the_replies_to_a_question_that_is_asked_for_later(
    clients: Callable[[], Session],
) -> None:
    server, asker = clients(), clients()
    waiting: queue.Queue[Request] = queue.Queue()
    ready = threading.Event()
    server.serve("soon", lambda one: waiting.put(one) if ready.is_set() else one.answer(b"yes"))
    served(asker, "soon")
    ready.set()
    threads = threading.active_count()
    questions = [asker.ask("soon", b"", timeout_s=PATIENCE_S) for _ in range(20)]
    heard = [waiting.get(timeout=PATIENCE_S) for _ in questions]
    assert threading.active_count() == threads
    assert not any(question.over() for question in questions)
    for request in heard:
        request.answer(b"now")
    wait_until(lambda: all(question.over() for question in questions))
    assert [question.all() for question in questions] == [[b"now"]] * 20


def test_an_answer_that_is_too_long_is_not_copied(
    clients: Callable[[], Session], monkeypatch: pytest.MonkeyPatch
) -> None:
    server, asker = clients(), clients()
    server.serve("long", lambda request: request.answer(bytes(4 * 2**20)))
    served(asker, "long")
    monkeypatch.setattr(requests, "MAX_MESSAGE_BYTES", 2**20)
    assert asker.ask_all("long", b"", timeout_s=PATIENCE_S) == [b""]


def test_a_token_is_seen_to_appear_and_to_disappear(clients: Callable[[], Session]) -> None:
    early, other = clients(), clients()
    seen: queue.Queue[tuple[str, bool]] = queue.Queue()
    other.declare_alive("lab/robot/a/alive")
    early.watch_alive("lab/robot/*/alive", lambda key, alive: seen.put((key, alive)))
    assert seen.get(timeout=PATIENCE_S) == ("lab/robot/a/alive", True)
    assert clients().alive("lab/robot/*/alive", timeout_s=PATIENCE_S) == ["lab/robot/a/alive"]
    token = other.declare_alive("lab/robot/b/alive")
    assert seen.get(timeout=PATIENCE_S) == ("lab/robot/b/alive", True)
    token.withdraw()
    token.withdraw()
    assert seen.get(timeout=PATIENCE_S) == ("lab/robot/b/alive", False)
    other.close()
    assert seen.get(timeout=PATIENCE_S) == ("lab/robot/a/alive", False)
    assert clients().alive("lab/robot/*/alive", timeout_s=PATIENCE_S) == []


def test_who_is_there_is_reported_before_watching_returns(clients: Callable[[], Session]) -> None:
    present = clients()
    keys = {f"lab/robot/{name}/alive" for name in ("a", "b", "c")}
    for key in keys:
        present.declare_alive(key)
    # Their link keeps the order: the router knows them when it has answered.
    assert set(present.alive("lab/robot/*/alive", timeout_s=PATIENCE_S)) == keys
    for _ in range(20):
        seen: list[str] = []
        clients().watch_alive("lab/robot/*/alive", lambda key, _alive, seen=seen: seen.append(key))
        assert set(seen) == keys


def test_all_who_watch_on_one_session_are_told_until_each_leaves(
    clients: Callable[[], Session],
) -> None:
    present, session = clients(), clients()
    present.declare_alive("lab/robot/a/alive")
    assert present.alive("lab/robot/*/alive", timeout_s=PATIENCE_S)  # the router knows it
    first: queue.Queue[tuple[str, bool]] = queue.Queue()
    second: queue.Queue[tuple[str, bool]] = queue.Queue()
    one = session.watch_alive("lab/robot/*/alive", lambda key, alive: first.put((key, alive)))
    session.watch_alive("lab/robot/*/alive", lambda key, alive: second.put((key, alive)))
    assert first.get_nowait() == second.get_nowait() == ("lab/robot/a/alive", True)
    one.withdraw()
    one.withdraw()
    token = present.declare_alive("lab/robot/b/alive")
    assert second.get(timeout=PATIENCE_S) == ("lab/robot/b/alive", True)
    token.withdraw()
    assert second.get(timeout=PATIENCE_S) == ("lab/robot/b/alive", False)
    assert first.empty()


def test_a_withdrawn_handler_hears_no_more(clients: Callable[[], Session]) -> None:
    server, asker = clients(), clients()
    declaration = server.serve("gone", echo)
    served(asker, "gone")
    declaration.withdraw()
    wait_until(lambda: not asker.ask_all("gone", b"", timeout_s=PATIENCE_S))


def test_a_session_need_not_hear_what_it_puts_itself(clients: Callable[[], Session]) -> None:
    one, other = clients(), clients()
    heard: queue.Queue[bytes] = queue.Queue()
    one.subscribe("k", lambda _key, payload: heard.put(payload), max_bytes=9, own=False)
    publisher = one.state_publisher("k")
    publisher.put(b"own")
    others = other.state_publisher("k")
    wait_until(lambda: (others.put(b"other"), not heard.empty())[1])
    assert heard.get() == b"other"


def test_an_urgent_message_arrives(clients: Callable[[], Session]) -> None:
    listener, sender = clients(), clients()
    heard: queue.Queue[tuple[str, bytes]] = queue.Queue()
    listener.subscribe("lab/stop", lambda key, payload: heard.put((key, payload)), max_bytes=100)

    def sent() -> bool:
        sender.put_urgent("lab/stop", b"now")
        return not heard.empty()

    wait_until(sent)
    assert heard.get() == ("lab/stop", b"now")


# Opening and closing.


def test_closing_while_a_handler_runs_neither_waits_nor_hangs(
    clients: Callable[[], Session],
) -> None:
    server, asker = clients(), clients()
    lock = threading.Lock()  # held by the one who closes: the classic way to hang
    heard, asked = threading.Event(), threading.Event()
    ended: queue.Queue[str] = queue.Queue()

    def on_sample(_key: str, _payload: bytes) -> None:
        heard.set()
        with lock:
            ended.put("sample")

    def on_query(request: Request) -> None:
        asked.set()
        with lock:
            pass
        with suppress(TransportError):  # too late: the session is closed
            request.answer(b"late")
        ended.put("query")

    server.subscribe("slow", on_sample, max_bytes=100)
    server.serve("slow", on_query)

    def ask() -> None:
        while not asked.is_set():
            asker.ask_all("slow", b"", timeout_s=PATIENCE_S)

    asking = threading.Thread(target=ask)
    with lock:
        asking.start()

        def both_run() -> bool:
            asker.put_urgent("slow", b"")
            return heard.is_set() and asked.is_set()

        wait_until(both_run)
        server.close()
        assert ended.empty()
    wait_until(lambda: {"sample", "query"} <= set(ended.queue))
    asking.join(PATIENCE_S)
    assert not asking.is_alive()


def test_no_router_is_an_error_that_says_what_to_do(endpoint: str) -> None:
    with pytest.raises(NoRouterError, match="nufleet router"), open_client(endpoint, timeout_s=0.2):
        pass


def test_a_client_without_a_time_limit_waits_for_its_router(
    endpoint: str, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(transport, "LONGEST_TRY_S", 0.2)  # it says so after some tries
    opened: queue.Queue[list[str]] = queue.Queue()

    def join() -> None:
        with open_client(endpoint, timeout_s=None) as session:
            session.declare_alive("patient")
            opened.put(session.alive("patient", timeout_s=PATIENCE_S))

    waiting = threading.Thread(target=join)
    waiting.start()
    assert opened.empty()
    wait_until(lambda: f"no router answers at {endpoint}" in caplog.text)
    with open_router([endpoint]):
        assert opened.get(timeout=PATIENCE_S) == ["patient"]
        waiting.join(PATIENCE_S)


def test_waiting_for_a_router_can_be_given_up(endpoint: str) -> None:
    given_up = threading.Event()
    errors: queue.Queue[Exception] = queue.Queue()

    def join() -> None:
        try:
            with open_client(endpoint, timeout_s=None, given_up=given_up):
                pass
        except NoRouterError as error:
            errors.put(error)

    waiting = threading.Thread(target=join)
    waiting.start()
    given_up.set()
    assert isinstance(errors.get(timeout=PATIENCE_S), NoRouterError)
    waiting.join(PATIENCE_S)


def test_waiting_for_a_router_ends_with_ctrl_c(
    endpoint: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    main = threading.main_thread().ident
    assert main is not None
    waits, reach = threading.Event(), zenoh.open

    def waiting(config: zenoh.Config) -> zenoh.Session:
        waits.set()
        return reach(config)

    def press_ctrl_c() -> None:
        assert waits.wait(PATIENCE_S)
        signal.pthread_kill(main, signal.SIGINT)

    monkeypatch.setattr(zenoh, "open", waiting)
    ctrl_c = threading.Thread(target=press_ctrl_c)
    ctrl_c.start()
    with pytest.raises(KeyboardInterrupt), open_client(endpoint, timeout_s=None):
        pass
    ctrl_c.join()


def test_an_endpoint_in_use_is_named(router: Session, endpoint: str) -> None:
    with pytest.raises(EndpointInUseError, match=endpoint), open_router([endpoint]):
        pass


def test_a_port_that_cannot_be_is_no_reason_to_look_for_another_router() -> None:
    with (
        pytest.raises(EndpointInUseError, match=r"99999: invalid port value\. Choose another"),
        open_router(["tcp/127.0.0.1:99999"]),
    ):
        pass


def test_a_router_says_which_port_it_was_given() -> None:
    with open_router(["tcp/127.0.0.1:0"]) as router:
        (endpoint,) = router.listening_on()
        assert int(endpoint.rpartition(":")[2]) > 0
        with open_client(endpoint, timeout_s=PATIENCE_S) as session:
            session.declare_alive("by-tcp")
            assert session.alive("by-tcp", timeout_s=PATIENCE_S) == ["by-tcp"]


@pytest.mark.parametrize("wrong", ["", "tcp", "tcp/", "localhost:7447", "tpc/127.0.0.1:1"])
def test_what_is_no_endpoint_is_refused(wrong: str) -> None:
    with pytest.raises(InvalidInputError, match="is not an endpoint"), open_router([wrong]):
        pass
    with (
        pytest.raises(InvalidInputError, match="is not an endpoint"),
        open_client(wrong, timeout_s=None),
    ):
        pass


@pytest.mark.parametrize("protocol", ["tls/127.0.0.1:1", "tls/127.0.0.1:x", "http/127.0.0.1:1"])
def test_no_error_shows_the_key_in_an_endpoint(protocol: str) -> None:
    keyed = f"{protocol}#connect_private_key_base64=c2VjcmV0;listen_private_key_base64=c2VjcmV0"
    for opening in (lambda: open_client(keyed, timeout_s=0.1), lambda: open_router([keyed])):
        with pytest.raises(NufleetError) as refused, opening():
            pass
        assert protocol in str(refused.value)
        assert "c2VjcmV0" not in str(refused.value)


def test_clients_find_each_other_again_after_a_restart_of_the_router(endpoint: str) -> None:
    with ExitStack() as stack:
        with open_router([endpoint]):
            server, asker = (
                stack.enter_context(open_client(endpoint, timeout_s=PATIENCE_S)) for _ in range(2)
            )
            seen: queue.Queue[bool] = queue.Queue()
            server.serve("lab/a", echo)
            server.declare_alive("lab/a")
            asker.watch_alive("lab/a", lambda _key, alive: seen.put(alive))
            served(asker, "lab/a")
            assert seen.get(timeout=PATIENCE_S) is True
        assert seen.get(timeout=PATIENCE_S) is False
        with open_router([endpoint]):
            assert seen.get(timeout=PATIENCE_S) is True
            served(asker, "lab/a")
            stack.close()


def test_sessions_that_come_and_go_leave_nothing(router: Session, endpoint: str) -> None:
    def come_and_go() -> None:
        with open_client(endpoint, timeout_s=PATIENCE_S) as session:
            session.serve("k/**", echo)
            session.subscribe("k", lambda _key, _payload: None, max_bytes=100)
            session.subscribe_state("s", lambda _key, _payload: None)
            session.watch_alive("a", lambda _key, _alive: None)
            session.state_publisher("p").put(b"")
            session.declare_alive("a")

    def used() -> tuple[int, int]:
        return (
            len(list(Path("/proc/self/task").iterdir())),
            len(list(Path("/proc/self/fd").iterdir())),
        )

    for _ in range(3):  # Zenoh's pool of threads grows to its size
        come_and_go()
    before = used()
    for _ in range(10):
        come_and_go()
    wait_until(lambda: all(now <= then + 4 for now, then in zip(used(), before, strict=True)))
