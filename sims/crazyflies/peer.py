"""Serves a simulated Crazyflie over UDP, through a link that delays, loses and falls silent."""

from __future__ import annotations

import heapq
import itertools
import select
import socket
import struct
import threading
import time
from typing import Annotated

import numpy as np
from pydantic import Field

from nufleet.shared.strict import NonNegative, Strict
from nufleet.sims.crazyflies.firmware import TICK_S, Firmware

ARRIVAL = 35
"""Linux's SO_TIMESTAMPNS: the kernel dates datagrams as they arrive."""

READ_AT_ONCE_S = 20e-6
"""Longest time between two readings of clocks that count as taken at once."""


class Air(Strict):
    """What the link does to packets."""

    jitter_s: NonNegative = 0.0
    """Mean time that a packet takes: on the way up evenly distributed, so that set-points keep
    their order at 50 Hz up to 10 ms; on the way down exponentially."""
    loss: Annotated[float, Field(ge=0, lt=1)] = 0.0
    """Share of the packets that are lost, either way."""


class Peer:
    """One drone at `udp://127.0.0.1:PORT`, for the duration of a `with` block.

    The kernel says when packets arrived, so that the drone flies as it should even when this
    thread is late; only what it sends is late, too.
    """

    def __init__(
        self, firmware: Firmware, rng: np.random.Generator, air: Air | None = None, port: int = 0
    ) -> None:
        """Listen.

        Args:
            firmware: The drone; its clock is `time.monotonic`.
            rng: Generator of the link's delays and losses.
            air: What the link does to packets.
            port: Port to listen on; 0 for a free one.
        """
        self.firmware, self.air = firmware, air or Air()
        self._rng = rng
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setsockopt(socket.SOL_SOCKET, ARRIVAL, 1)
        self._socket.setblocking(False)
        self._socket.bind(("127.0.0.1", port))
        self._client: tuple[str, int] | None = None
        self._silent_until_s = 0.0
        # Packets under way, by the time at which they arrive; the counter keeps equal times apart.
        self._up: list[tuple[float, int, bytes]] = []
        self._down: list[tuple[float, int, bytes]] = []
        self._count = itertools.count()
        self._reached_s = [0.0] * 16  # packets to one port keep their order
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._serve, name="simulated crazyflie", daemon=True)

    @property
    def uri(self) -> str:
        """Where it is reached."""
        return f"udp://127.0.0.1:{self._socket.getsockname()[1]}"

    def fall_silent(self, lasts_s: float) -> None:
        """Let no packet pass for some time, either way."""
        self._silent_until_s = time.monotonic() + lasts_s

    def __enter__(self) -> Peer:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._over.set()
        self._thread.join()
        self._socket.close()

    def _serve(self) -> None:
        while not self._over.is_set():
            next_s = min((entry[0] for entry in self._down[:1]), default=np.inf)
            wait_s = min(TICK_S, next_s - time.monotonic())
            select.select([self._socket], [], [], max(0.0, wait_s))
            # What arrives after this moment is read in the next turn, with its time of arrival.
            now_s = time.monotonic()
            self._receive()
            while self._up and self._up[0][0] <= now_s:
                arrived_s, _, packet = heapq.heappop(self._up)
                self._send(self.firmware.take(packet, arrived_s))
            self._send(self.firmware.advance(now_s))
            self._deliver()

    def _receive(self) -> None:
        offset_s = _clock_offset_s()
        while True:
            try:
                packet, ancillary, _, self._client = self._socket.recvmsg(64, 64)
            except (BlockingIOError, ConnectionRefusedError):
                return
            at_s = time.monotonic()
            for _, kind, data in ancillary:
                if kind == ARRIVAL:
                    seconds, nanoseconds = struct.unpack("qq", data)
                    at_s = seconds + 1e-9 * nanoseconds + offset_s
            delay_s = 2 * self.air.jitter_s * self._rng.random()
            if packet != b"\xff" and not self._is_lost(at_s):
                port = packet[0] >> 4
                self._reached_s[port] = max(self._reached_s[port], at_s + delay_s)
                heapq.heappush(self._up, (self._reached_s[port], next(self._count), packet))

    def _send(self, packets: list[tuple[float, bytes]]) -> None:
        for sent_s, packet in packets:
            delay_s = self.air.jitter_s * self._rng.exponential()
            if not self._is_lost(sent_s):
                heapq.heappush(self._down, (sent_s + delay_s, next(self._count), packet))

    def _deliver(self) -> None:
        now_s = time.monotonic()
        while self._down and self._down[0][0] <= now_s:
            packet = heapq.heappop(self._down)[2]
            if self._client is not None:
                try:
                    self._socket.sendto(packet, self._client)
                except ConnectionRefusedError:
                    self._client = None

    def _is_lost(self, now_s: float) -> bool:
        return now_s < self._silent_until_s or self._rng.random() < self.air.loss


def _clock_offset_s() -> float:
    """Return what the monotonic clock shows more than the wall clock, read between two ticks."""
    while True:
        before_s = time.monotonic()
        wall_s = time.time()
        after_s = time.monotonic()
        if after_s - before_s < READ_AT_ONCE_S:
            return (before_s + after_s) / 2 - wall_s
