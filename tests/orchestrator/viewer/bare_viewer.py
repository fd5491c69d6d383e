"""A viewer that reads as much or as little as it is told to: gRPC over a bare socket."""

from __future__ import annotations

import socket

from polling import PATIENCE_S

READ_MESSAGES = "/rerun.sdk_comms.v1alpha1.MessageProxyService/ReadMessages"

DEFAULT_WINDOW = 65_535
"""What an HTTP/2 server may send unasked (RFC 9113, section 6.9.2)."""


class BareViewer:
    """Subscribes to a live server; a context manager."""

    def __init__(self, port: int) -> None:
        self._socket = socket.socket()
        # What is not read must back up into the server, not into the kernel.
        self._socket.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        self._socket.settimeout(PATIENCE_S)
        self._socket.connect(("127.0.0.1", port))

    def subscribe(self, *, more: int = 0) -> bytes:
        """Ask for all messages; returns the beginning of the answer.

        Args:
            more: how many bytes the server may send beyond the default window.
        """
        headers = b"".join(
            b"\x00" + bytes([len(name)]) + name.encode() + bytes([len(value)]) + value.encode()
            for name, value in (
                (":method", "POST"),
                (":scheme", "http"),
                (":path", READ_MESSAGES),
                (":authority", "127.0.0.1"),
                ("content-type", "application/grpc"),
                ("te", "trailers"),
            )
        )
        window = (4).to_bytes(2, "big") + (DEFAULT_WINDOW + more).to_bytes(4, "big")
        request = (
            b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"
            + _frame(0x4, 0x0, 0, window)  # our settings: the stream's window
            + _frame(0x4, 0x1, 0, b"")  # yours are fine
            + _frame(0x1, 0x4, 1, headers)
            + _frame(0x0, 0x1, 1, bytes(5))  # one empty message, and that was all
        )
        if more:
            request += _frame(0x8, 0x0, 0, more.to_bytes(4, "big"))  # the connection's window
        self._socket.sendall(request)
        return self._socket.recv(1000)

    def read_until(self, text: bytes) -> bytes:
        """Read on until a text comes; raises TimeoutError when it does not."""
        answer = b""
        while text not in answer:
            part = self._socket.recv(2**16)
            if not part:
                raise ConnectionError(f"the server ended before {text!r}")
            answer += part
        return answer

    def __enter__(self) -> BareViewer:
        return self

    def __exit__(self, *_: object) -> None:
        self._socket.close()


def _frame(kind: int, flags: int, stream: int, payload: bytes) -> bytes:
    """An HTTP/2 frame (RFC 9113, section 4.1)."""
    head = len(payload).to_bytes(3, "big") + bytes([kind, flags]) + stream.to_bytes(4, "big")
    return head + payload
