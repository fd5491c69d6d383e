"""The simulated vehicle on a UDP port, in real time."""

from __future__ import annotations

import socket
import threading
import time
from contextlib import suppress
from types import TracebackType
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.sims.mavlink_vehicle.vehicle import SimulatedVehicle

DATAGRAM_BYTES = 4096
STEP_MAX_S = 0.05
"""Longest time that counts between two looks at the clock: a vehicle's own computer would not have
stopped for longer because ours is busy."""


class UdpVehicle:
    """Serves one vehicle on a thread of its own, from `with` to its end."""

    def __init__(self, vehicle: SimulatedVehicle, to: tuple[str, int] | None) -> None:
        """Open a port.

        Args:
            vehicle: The vehicle, built for `time.monotonic()`.
            to: Host and port that it sends to, as PX4 does; None for a vehicle that sends to
                whichever program has sent to it last.
        """
        self.vehicle = vehicle
        """The vehicle; only its faults may be set from other threads."""
        self._to = to
        self._now_s = self._looked_s = time.monotonic()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind(("127.0.0.1", 0))
        self._packer = dialect.MAVLink(None, srcSystem=vehicle.system_id, srcComponent=1)
        self._parser = dialect.MAVLink(None)
        self._parser.robust_parsing = True
        self._ended = threading.Event()
        name = f"mavlink-vehicle-{vehicle.system_id}"
        self._thread = threading.Thread(target=self._serve, name=name, daemon=True)

    @property
    def port(self) -> int:
        """Port on which it receives."""
        port: int = self._socket.getsockname()[1]
        return port

    def __enter__(self) -> UdpVehicle:
        self._thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self._ended.set()
        self._thread.join()
        self._socket.close()

    def _passed(self) -> float:
        """Return the vehicle's present time, on the clock with which it was built."""
        looked_s, self._looked_s = self._looked_s, time.monotonic()
        self._now_s += min(self._looked_s - looked_s, STEP_MAX_S)
        return self._now_s

    def _serve(self) -> None:
        while not self._ended.is_set():
            now_s = self._passed()
            self._send(self.vehicle.advance(now_s))
            self._socket.settimeout(max(1e-4, self.vehicle.next_s - now_s))
            with suppress(TimeoutError):
                data, source = self._socket.recvfrom(DATAGRAM_BYTES)
                self._to = source
                for message in self._parser.parse_buffer(data) or ():
                    if message.get_type() != "BAD_DATA":
                        self._send(self.vehicle.receive(message, self._passed()))

    def _send(self, messages: list[Any]) -> None:
        for message in messages:
            data = message.pack(self._packer)
            self._packer.seq = (self._packer.seq + 1) % 256
            if self._to is not None:
                with suppress(OSError):  # no program waits on the other port yet
                    self._socket.sendto(data, self._to)
