"""A cable through this process that can be cut, blocked or delayed in each direction.

Clients reach it by TCP at a port that it holds as long as it exists; the server behind it listens
on a Unix socket, which no other process can take while a router is being restarted.
"""

from __future__ import annotations

import selectors
import socket
import threading
import time
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

CHUNK_BYTES = 64 * 1024
_TICK_S = 0.005
_IDLE_S = 0.05
"""Interval between checks whether to end; new connections and bytes are noticed at once."""


Direction = Literal["up", "down"]
"""Up is from who connects to the server, down is back."""


@dataclass(eq=False)
class _Pipe:
    """One direction of one connection: what was read and waits to be written."""

    reader: socket.socket
    writer: socket.socket
    direction: Direction
    waiting: deque[tuple[float, bytes]] = field(default_factory=deque)


class Link:
    """Passes bytes on between clients and a server until told otherwise; used from any thread.

    What is held is not lost: TCP delivers all or nothing. So a lost message is a held one whose
    connection is then cut.
    """

    def __init__(self, server: Path) -> None:
        """Prepare; see `opened`."""
        self._server = server
        self._listener = socket.create_server(("127.0.0.1", 0))
        self._lock = threading.Lock()
        self._pipes: list[_Pipe] = []
        self._held: set[Direction] = set()
        self._refusing = False
        self._delay_s = 0.0
        self._closing = False
        self._passed = {"up": 0, "down": 0}

    @property
    def endpoint(self) -> str:
        """Where clients connect to."""
        return f"tcp/127.0.0.1:{self._listener.getsockname()[1]}"

    def passed_bytes(self, direction: Direction) -> int:
        """Return how much went through."""
        return self._passed[direction]

    def hold(self, *directions: Direction) -> None:
        """Let nothing through in these directions; what comes is kept."""
        with self._lock:
            self._held.update(directions)

    def let_through(self) -> None:
        """Pass on what was held and all that comes; accept connections again."""
        with self._lock:
            self._held.clear()
            self._refusing = False

    def delay(self, seconds: float) -> None:
        """Delay everything by a time in seconds."""
        with self._lock:
            self._delay_s = seconds

    def cut(self, *, refuse: bool = False) -> None:
        """End every connection, with what it holds; refuse new ones until `let_through`."""
        with self._lock:
            self._refusing = refuse
            pipes, self._pipes = self._pipes, []
        for pipe in pipes:
            _close(pipe.reader)
            _close(pipe.writer)

    def work(self) -> None:
        """Pass bytes on until closed."""
        while not self._closing:
            with selectors.DefaultSelector() as selector:
                selector.register(self._listener, selectors.EVENT_READ, None)
                with self._lock:
                    pipes = list(self._pipes)
                for pipe in pipes:
                    with suppress(ValueError, KeyError):  # it was cut just now
                        selector.register(pipe.reader, selectors.EVENT_READ, pipe)
                waits = any(pipe.waiting for pipe in pipes)
                for key, _ in selector.select(_TICK_S if waits else _IDLE_S):
                    if key.data is None:
                        self._accept()
                    else:
                        self._read(key.data)
            for pipe in pipes:
                self._write(pipe)
        self.cut()
        self._listener.close()

    def close(self) -> None:
        """End `work`."""
        self._closing = True

    def _accept(self) -> None:
        client, _ = self._listener.accept()
        if self._refusing:
            return _close(client)
        server = socket.socket(socket.AF_UNIX)
        try:
            server.connect(str(self._server))
        except OSError:
            _close(server)
            return _close(client)
        client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        with self._lock:
            self._pipes += [_Pipe(client, server, "up"), _Pipe(server, client, "down")]
        return None

    def _read(self, pipe: _Pipe) -> None:
        try:
            data = pipe.reader.recv(CHUNK_BYTES)
        except OSError:
            data = b""
        if data:
            pipe.waiting.append((time.monotonic() + self._delay_s, data))
        elif pipe.direction in self._held:
            # A blocked direction does not report that its other end is gone, either.
            time.sleep(_TICK_S)
        else:
            self._end(pipe)

    def _write(self, pipe: _Pipe) -> None:
        while pipe.waiting and pipe.direction not in self._held:
            due_s, data = pipe.waiting[0]
            if due_s > time.monotonic():
                return None
            pipe.waiting.popleft()
            try:
                pipe.writer.sendall(data)
            except OSError:
                return self._end(pipe)
            self._passed[pipe.direction] += len(data)
        return None

    def _end(self, pipe: _Pipe) -> None:
        both = {pipe.reader, pipe.writer}
        with self._lock:
            self._pipes = [other for other in self._pipes if other.reader not in both]
        for end in both:
            _close(end)


@contextmanager
def opened(server: Path) -> Iterator[Link]:
    """Open a cable to a server that listens at a Unix socket."""
    link = Link(server)
    thread = threading.Thread(target=link.work, name="link")
    thread.start()
    try:
        yield link
    finally:
        link.close()
        thread.join()


def _close(end: socket.socket) -> None:
    with suppress(OSError):
        end.shutdown(socket.SHUT_RDWR)
    end.close()
