"""The real line to a vehicle: a port that several vehicles may share, and two threads."""

from __future__ import annotations

import itertools
import logging
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.robot_agent.drivers.mavlink.address import Address
from nufleet.robot_agent.drivers.mavlink.line import OWN_COMPONENT, Ear
from nufleet.robot_agent.drivers.mavlink.transport import Transport, opened

POLL_S = 0.05
"""Time after which a condition is looked at again without a message."""

_log = logging.getLogger(__name__)


class Link:
    """One port; it is open as long as a line uses it."""

    def __init__(self, url: str) -> None:
        self._url, self._address = url, Address.parsed(url)
        self._lock = threading.Lock()
        self._lines: dict[tuple[int, int], LinkLine] = {}
        self._transport: Transport | None = None
        self._reader: threading.Thread | None = None
        self._sources: dict[int, Any] = {}
        self.heard: set[int] = set()
        """System ids of the autopilots that were heard."""
        self.failure = ""
        """Why nothing arrives any more; empty as long as the port can be read."""

    def add(self, line: LinkLine) -> None:
        """Open the port for a line.

        Raises:
            RobotError: It cannot be opened.
        """
        with self._lock:
            if self._transport is None:
                if self._reader is not None:
                    self._reader.join()  # it closes the port that failed
                self.failure = ""
                self._transport = opened(self._address, self._url)
                self._reader = threading.Thread(
                    target=self._read, args=(self._transport,), name=f"mavlink-{self._url}"
                )
                self._reader.daemon = True
                self._reader.start()
            self._lines[line.vehicle] = line

    def remove(self, line: LinkLine) -> None:
        """Close the port after its last line."""
        with self._lock:
            self._lines.pop(line.vehicle, None)
            if self._lines:
                return
            transport, self._transport = self._transport, None
            reader, self._reader = self._reader, None
            self._sources.clear()
            self.heard.clear()
        if reader is not None and reader is not threading.current_thread():
            reader.join()
        if transport is not None:
            transport.close()

    def send(self, data: bytes, system: int) -> None:
        """Send a packet to a system; it is lost if that was never heard on a port that waits."""
        transport = self._transport
        if transport is not None:
            with suppress(OSError):
                transport.send(data, self._sources.get(system))

    def _read(self, transport: Transport) -> None:
        parsers: dict[Any, Any] = {}
        while self._transport is transport:
            try:
                data, source = transport.receive()
            except Exception as error:  # noqa: BLE001 - serial ports raise errors of their own
                self._fail(transport, error)
                return
            try:
                if data:
                    self._parse(data, source, parsers)
            except Exception:  # noqa: BLE001 - one bad packet must not end the thread
                _log.exception("%s: a packet from %s could not be read", self._url, source)

    def _fail(self, transport: Transport, error: Exception) -> None:
        """Close a port that cannot be read, so that the next line opens it again."""
        with self._lock:
            if self._transport is not transport:
                return  # the last line was closed meanwhile, and the port with it
            self._transport = None
            self.failure = (
                f"{self._url}: nothing arrives any more: {error}; check the cable or the network, "
                "and release the robot to connect it again"
            )
        _log.warning("%s", self.failure)
        with suppress(OSError):
            transport.close()

    def _parse(self, data: bytes, source: Any, parsers: dict[Any, Any]) -> None:
        parser = parsers.get(source)
        if parser is None:
            parser = parsers[source] = dialect.MAVLink(None)
            parser.robust_parsing = True
        now_s = time.monotonic()
        for message in parser.parse_buffer(data) or ():
            if message.get_type() != "BAD_DATA":
                self._deliver(message, source, now_s)

    def _deliver(self, message: Any, source: Any, now_s: float) -> None:
        system, component = message.get_srcSystem(), message.get_srcComponent()
        if message.get_type() == "HEARTBEAT" and message.autopilot != 8:
            self.heard.add(system)
        line = self._lines.get((system, component))
        if line is not None:
            self._sources[system] = source
            line.deliver(message, source, now_s)


class LinkLine:
    """The line to one vehicle of a link."""

    def __init__(self, link: Link, system: int, component: int, own_system: int) -> None:
        self._link = link
        self.vehicle = (system, component)
        """System and component of the vehicle's autopilot."""
        self._packer = dialect.MAVLink(None, srcSystem=own_system, srcComponent=OWN_COMPONENT)
        self._numbers = itertools.count()
        self._changed = threading.Condition()
        self._closed = threading.Event()
        self._beating: threading.Thread | None = None
        self._ear: Ear | None = None
        self._failure = ""

    def open(self, ear: Ear) -> None:
        """Open the port, and begin to beat."""
        self._ear = ear
        self._link.add(self)
        name = f"mavlink-system-{self.vehicle[0]}"
        self._beating = threading.Thread(target=self._beat, args=(ear,), name=name, daemon=True)
        self._beating.start()

    def close(self) -> None:
        """End both threads, and close the port if no other vehicle uses it."""
        self._closed.set()
        if self._beating is not None:
            self._beating.join()
            self._beating = None
            self._link.remove(self)

    def now_s(self) -> float:
        """Return the time since some moment, on a clock that is never set."""
        return time.monotonic()

    def send(self, message: Any) -> None:
        """Pack a message and send it."""
        # Two threads may use one number; that only blurs the vehicle's count of lost packets.
        self._packer.seq = next(self._numbers) % 256
        self._link.send(message.pack(self._packer), self.vehicle[0])

    def wait(self, until_s: float, condition: Callable[[], bool] | None = None) -> bool:
        """Wait until a time, or until a condition holds; return whether it does."""
        if condition is None:
            time.sleep(max(0.0, until_s - time.monotonic()))
            return False
        with self._changed:
            while not condition():
                left_s = until_s - time.monotonic()
                if left_s <= 0:
                    return False
                self._changed.wait(min(left_s, POLL_S))
        return True

    @property
    def failure(self) -> str:
        """Why the port cannot be read, or set-points cannot be sent; empty if all is well."""
        return self._failure or self._link.failure

    def heard_systems(self) -> tuple[int, ...]:
        """Return the system ids of all autopilots on the port."""
        return tuple(sorted(self._link.heard))

    def deliver(self, message: Any, source: object, now_s: float) -> None:
        """Take a message of the vehicle; called by the thread that reads."""
        if self._ear is None:
            return
        try:
            self._ear.receive(message, source, now_s)
        except Exception:  # noqa: BLE001 - one bad message must not end the thread
            _log.exception("a MAVLink message could not be taken")
        with self._changed:
            self._changed.notify_all()

    def _beat(self, ear: Ear) -> None:
        while not self._closed.is_set():
            try:
                due_s = ear.beat(time.monotonic())
                self._failure = ""
            except Exception as error:  # noqa: BLE001 - one failure must not end the thread
                if not self._failure:
                    _log.exception("set-points and heartbeats could not be sent")
                self._failure = f"set-points and heartbeats cannot be sent: {error!r}"
                due_s = time.monotonic() + POLL_S
            self._closed.wait(max(0.0, due_s - time.monotonic()))
