"""Bytes to and from vehicles: UDP, TCP, or a serial port."""

from __future__ import annotations

import socket
import threading
from contextlib import suppress
from typing import Any, Protocol

from nufleet.robot_agent.drivers.mavlink.address import Address
from nufleet.shared.errors import RobotError

LOOK_S = 0.1
"""Time after which `receive` returns with nothing."""

CONNECT_S = 5.0
"""Time in which a TCP connection has to open."""

DATAGRAM_BYTES = 4096
STREAM = "stream"
"""Source of everything that arrives on a stream, which tells no addresses."""


class Transport(Protocol):
    """An open port."""

    def receive(self) -> tuple[bytes, Any]:
        """Return what has arrived and its source; no bytes after `LOOK_S` without any.

        Raises:
            OSError: The port can be used no more.
        """

    def send(self, data: bytes, to: Any) -> None:
        """Send a packet to a source, or to where the port leads if `to` is None."""

    def close(self) -> None:
        """Close the port."""


class Udp:
    """A UDP port that waits for vehicles, or reaches out to one."""

    def __init__(self, address: Address) -> None:
        """Open the port.

        Raises:
            OSError: The address cannot be used.
        """
        found = socket.getaddrinfo(address.place, address.number, type=socket.SOCK_DGRAM)
        family, self._there = found[0][0], found[0][4]
        self._socket = socket.socket(family, socket.SOCK_DGRAM)
        self._waits = address.way == "udpin"
        if self._waits:
            try:
                self._socket.bind(self._there)
            except OSError:
                self._socket.close()
                raise
        self._socket.settimeout(LOOK_S)

    def receive(self) -> tuple[bytes, Any]:
        """Return a datagram and its address."""
        with suppress(TimeoutError):
            return self._socket.recvfrom(DATAGRAM_BYTES)
        return b"", None

    def send(self, data: bytes, to: Any) -> None:
        """Send a datagram."""
        there = self._there if to is None and not self._waits else to
        if there is not None:
            self._socket.sendto(data, there)

    def close(self) -> None:
        """Close the socket."""
        self._socket.close()


class Stream:
    """A TCP connection or a serial port."""

    def __init__(self, address: Address) -> None:
        """Open it.

        Raises:
            OSError: It cannot be opened.
        """
        self._writing = threading.Lock()
        self._socket: socket.socket | None = None
        self._serial: Any = None
        if address.way == "tcpout":
            place = (address.place, address.number)
            self._socket = socket.create_connection(place, timeout=CONNECT_S)
            self._socket.settimeout(LOOK_S)
            self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        else:
            import serial

            self._serial = serial.Serial(
                address.place, address.number, timeout=LOOK_S, write_timeout=LOOK_S
            )

    def receive(self) -> tuple[bytes, Any]:
        """Return what has arrived."""
        if self._socket is None:
            return self._serial.read(max(1, self._serial.in_waiting)), STREAM
        with suppress(TimeoutError):
            data = self._socket.recv(DATAGRAM_BYTES)
            if not data:
                raise ConnectionResetError("the other side closed the connection")
            return data, STREAM
        return b"", STREAM

    def send(self, data: bytes, to: Any) -> None:
        """Send bytes; a stream that another thread blocks does not block this one for long."""
        del to
        if not self._writing.acquire(timeout=LOOK_S):
            return
        try:
            if self._socket is not None:
                self._socket.sendall(data)
            else:
                self._serial.write(data)
        finally:
            self._writing.release()

    def close(self) -> None:
        """Close it."""
        (self._socket or self._serial).close()


def opened(address: Address, url: str) -> Transport:
    """Open the port at an address.

    Args:
        address: Address of the port.
        url: The same, as in the fleet file, for errors.

    Raises:
        RobotError: It cannot be opened.
    """
    try:
        return Udp(address) if address.way.startswith("udp") else Stream(address)
    except ImportError as error:
        raise RobotError(f"{url}: a serial port needs pyserial: pip install pyserial") from error
    except OSError as error:
        advice = {
            "udpin": "another program may wait on this port, or the address is not this machine's",
            "udpout": "check the host name",
            "tcpout": "check that the vehicle or its router listens there",
            "serial": "check the cable, and that this user may open the port (group dialout)",
        }[address.way]
        raise RobotError(f"{url} cannot be opened: {error.strerror or error}; {advice}") from error
